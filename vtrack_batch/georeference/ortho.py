"""Laying a picture on the ground: for looking at and for other programs, never for measuring."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model import homography
from vtrack_batch.model.ground_grid import GroundGrid

_STRIP_ROWS = 1024


def orthorectify(
    pixels: NDArray[np.uint8],
    pixel_to_ground: NDArray[np.float64],
    grid: GroundGrid,
    *,
    seen: NDArray[np.bool_] | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Resample *pixels* (H, W, 3) uint8, which *pixel_to_ground* (3, 3) places, to *grid*.

    Returns pixels (rows, columns, 3) uint8, and where they are valid (rows, columns) bool: inside the picture and,
    if *seen* (H, W) bool is given, where that holds; elsewhere they are black. Bilinear; where the grid is coarser
    than the picture, pixels are averaged first, so that nothing flickers.
    """
    known = np.full(pixels.shape[:2], 255, np.uint8) if seen is None else seen.astype(np.uint8) * np.uint8(255)
    factor = _reduction(pixel_to_ground, grid, pixels.shape[:2])
    source, grid_to_source = _reduced(pixels, factor), np.linalg.inv(pixel_to_ground) @ grid.to_ground
    shift = (1 - factor) / (2 * factor)
    grid_to_reduced = np.array([[1 / factor, 0, shift], [0, 1 / factor, shift], [0, 0, 1]]) @ grid_to_source
    rows, columns = grid.shape
    out, valid = np.zeros((rows, columns, 3), np.uint8), np.zeros((rows, columns), bool)
    for top in range(0, rows, _STRIP_ROWS):
        strip = slice(top, min(rows, top + _STRIP_ROWS))
        down = np.array([[1, 0, 0], [0, 1, top], [0, 0, 1.0]])
        size = (columns, strip.stop - strip.start)
        out[strip] = _warp(source, grid_to_reduced @ down, size, cv2.INTER_LINEAR, cv2.BORDER_REPLICATE)
        valid[strip] = _warp(known, grid_to_source @ down, size, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT) > 0
        out[strip][~valid[strip]] = 0
    return out, valid


def _reduction(pixel_to_ground: NDArray[np.float64], grid: GroundGrid, shape: tuple[int, ...]) -> int:
    """Return by how much the picture is finer than the grid at its centre, in whole numbers."""
    centre = np.array([[(shape[1] - 1) / 2, (shape[0] - 1) / 2]])
    area_m2 = abs(float(np.linalg.det(homography.jacobian(pixel_to_ground, centre)[0])))
    return max(1, min(int(grid.gsd_m / area_m2**0.5 + 1e-6), *shape))


def _reduced(pixels: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    if factor == 1:
        return pixels
    height, width = (-(-side // factor) for side in pixels.shape[:2])
    missing = (height * factor - pixels.shape[0], width * factor - pixels.shape[1])
    whole = cv2.copyMakeBorder(pixels, 0, missing[0], 0, missing[1], cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _warp(
    source: NDArray[np.uint8], to_source: NDArray[np.float64], size: tuple[int, int], interpolation: int, border: int
) -> NDArray[np.uint8]:
    flags = interpolation | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(source, to_source, size, flags=flags, borderMode=border), np.uint8)
