"""The difference of one frame from the background, as evidence and a class for every pixel.

The frame itself is never resampled: the background is looked up at the pixel to which the frame's pixel maps. Most of
a frame shows empty ground: one pixel of nine is looked at first, and all of them only where those differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.background.exposure import GAIN_SHIFT, Exposure, fit_exposure

GROUND, OBJECT, SHADOW, UNSEEN = 0, 1, 2, 3
"""Classes of pixels: like the ground, different from it, darker like ground in cast shadow, no ground known there."""

FULL = 100
"""Evidence of a pixel that surely differs."""

_UNSEEN = 255
_POINT_STEP_PX = 3
_POINTS_PER_TILE_SIDE = 12
_POINTS = 50_000
_DARKEST_LEVEL = 24
_CELL = 3
_FEWEST_CELLS = 3
_WORTH_A_LOOK = 18
_CELLS_AROUND = 2


@dataclass(frozen=True, eq=False)
class Difference:
    """One frame against the background: everything (H, W) in the pixels of that frame.

    ``evidence`` uint8 0..100 that something lies on the ground; ``classes`` uint8, see ``GROUND`` ... ``UNSEEN``;
    ``exposure`` takes the frame's levels to the background's; ``ground`` (h, w, 3 or 4) uint8 is the background, and
    ``to_ground`` (3, 3) takes the frame's pixels to its.
    """

    evidence: NDArray[np.uint8]
    classes: NDArray[np.uint8]
    exposure: Exposure
    ground: NDArray[np.uint8]
    to_ground: NDArray[np.float64]


def subtract(
    frame: NDArray[np.uint8],
    ground: NDArray[np.uint8],
    frame_to_ground_px: NDArray[np.float64],
    *,
    threshold: float,
    shadow_band: NDArray[np.float64],
    tile_px: float,
) -> Difference:
    """Compare *frame* (H, W, 3) with *ground* (h, w, 4) uint8: colour and tolerance, tolerance 255 = unseen.

    *threshold* in grey levels gives half evidence; *shadow_band* (3, 2) = lowest and highest ratio of a cast
    shadow per channel; *tile_px* = distance of the nodes of the exposure's gain.
    """
    height, width = frame.shape[:2]
    matrix = np.ascontiguousarray(frame_to_ground_px, np.float64)
    step = _point_step(height * width, tile_px)
    points = _look_up(ground, matrix, height, width, step)
    picture, target = np.ascontiguousarray(frame[::step, ::step]), np.ascontiguousarray(points[:, :, :3])
    exposure = fit_exposure(picture, target, points[:, :, 3] < _UNSEEN, tile_px=tile_px / step)
    light = exposure.levels, exposure.gain_map(height, width)
    cells = _worth_a_look(_probe(frame, ground, matrix, *light, threshold))
    evidence, classes = np.zeros((height, width), np.uint8), np.zeros((height, width), np.uint8)
    _classify(frame, ground, matrix, *light, threshold, shadow_band, cells, evidence, classes)
    return Difference(evidence, classes, exposure, ground, matrix)


def _point_step(pixels: int, tile_px: float) -> int:
    """Return the distance of the points from which the exposure is told: many in all, and some in every tile."""
    return max(_POINT_STEP_PX, min(round(tile_px / _POINTS_PER_TILE_SIDE), int((pixels / _POINTS) ** 0.5)))


def _worth_a_look(probes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return for each cell whether it lies where *probes*, the evidence at the middle of every cell, add up."""
    if min(probes.shape) < _FEWEST_CELLS:
        return np.ones_like(probes)
    side = 2 * _CELLS_AROUND + 1
    found = cv2.threshold(cv2.blur(probes, (3, 3)), _WORTH_A_LOOK, 1, cv2.THRESH_BINARY)[1]
    return np.asarray(cv2.dilate(found, np.ones((side, side), np.uint8)), np.uint8)


@njit(cache=True, nogil=True, error_model="numpy")
def place_of(matrix, column, row):  # type: ignore[no-untyped-def]
    """Return the row and the column of the ground's pixel nearest to where a pixel of the frame lies."""
    shrink = 1.0 / (matrix[2, 0] * column + matrix[2, 1] * row + matrix[2, 2])
    x = (matrix[0, 0] * column + matrix[0, 1] * row + matrix[0, 2]) * shrink
    y = (matrix[1, 0] * column + matrix[1, 1] * row + matrix[1, 2]) * shrink
    return int(np.floor(y + 0.5)), int(np.floor(x + 0.5))


@njit(cache=True, nogil=True, error_model="numpy")
def _look_up(ground, matrix, height, width, step):  # type: ignore[no-untyped-def]
    """Return the ground (h, w, 4) at every *step*-th pixel of a frame of *height* x *width*."""
    points = np.zeros(((height + step - 1) // step, (width + step - 1) // step, 4), np.uint8)
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            r, c = place_of(matrix, j * step, i * step)
            if 0 <= r < ground.shape[0] and 0 <= c < ground.shape[1]:
                for k in range(4):
                    points[i, j, k] = ground[r, c, k]
            else:
                points[i, j, 3] = _UNSEEN
    return points


@njit(cache=True, nogil=True, error_model="numpy")
def _strength(frame, row, column, ground, r, c, levels, gain):  # type: ignore[no-untyped-def]
    """Return by how many levels a pixel of the frame differs from one of the ground beyond what chance allows."""
    red = abs(levels[0, frame[row, column, 0]] * gain - ground[r, c, 0])
    green = abs(levels[1, frame[row, column, 1]] * gain - ground[r, c, 1])
    blue = abs(levels[2, frame[row, column, 2]] * gain - ground[r, c, 2])
    return max(red, green, blue) - ground[r, c, 3]


@njit(cache=True, nogil=True, error_model="numpy")
def _places_of(matrix, columns, row, rows_there, columns_there):  # type: ignore[no-untyped-def]
    """Fill in what ``place_of`` tells of pixels of one row, all at once: it is mostly divisions."""
    for j in range(len(columns)):
        shrink = 1.0 / (matrix[2, 0] * columns[j] + matrix[2, 1] * row + matrix[2, 2])
        x = (matrix[0, 0] * columns[j] + matrix[0, 1] * row + matrix[0, 2]) * shrink
        y = (matrix[1, 0] * columns[j] + matrix[1, 1] * row + matrix[1, 2]) * shrink
        rows_there[j], columns_there[j] = np.floor(y + 0.5), np.floor(x + 0.5)


@njit(cache=True, nogil=True, error_model="numpy")
def _probe(frame, ground, matrix, levels, gain, threshold):  # type: ignore[no-untyped-def]
    """Return the evidence at the middle pixel of every cell of 3 x 3; full where no ground is known."""
    height, width = frame.shape[:2]
    probes = np.zeros(((height + _CELL - 1) // _CELL, (width + _CELL - 1) // _CELL), np.uint8)
    columns = np.minimum(_CELL * np.arange(probes.shape[1]) + 1, width - 1)
    rows_there, columns_there = np.empty(len(columns)), np.empty(len(columns))
    for i in range(probes.shape[0]):
        row = min(_CELL * i + 1, height - 1)
        _places_of(matrix, columns, row, rows_there, columns_there)
        for j in range(probes.shape[1]):
            column, r, c = columns[j], int(rows_there[j]), int(columns_there[j])
            if r < 0 or r >= ground.shape[0] or c < 0 or c >= ground.shape[1] or ground[r, c, 3] == _UNSEEN:
                probes[i, j] = 9 * (_WORTH_A_LOOK + 1)
                continue
            g = gain[row >> GAIN_SHIFT, column >> GAIN_SHIFT]
            strength = _strength(frame, row, column, ground, r, c, levels, g) / threshold - 0.5
            probes[i, j] = int(min(max(strength, 0.0), 1.0) * FULL)
    return probes


@njit(cache=True, nogil=True, error_model="numpy")
def _classify(frame, ground, matrix, levels, gain, threshold, shadow, cells, evidence, classes):  # type: ignore[no-untyped-def]
    """Fill *evidence* and *classes*, both zero before, where *cells* (rows, columns) of 3 x 3 pixels are not zero."""
    height, width = frame.shape[:2]
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            if not cells[i, j]:
                continue
            for row in range(_CELL * i, min(_CELL * i + _CELL, height)):
                for column in range(_CELL * j, min(_CELL * j + _CELL, width)):
                    r, c = place_of(matrix, column, row)
                    if r < 0 or r >= ground.shape[0] or c < 0 or c >= ground.shape[1] or ground[r, c, 3] == _UNSEEN:
                        classes[row, column] = UNSEEN
                        continue
                    g = gain[row >> GAIN_SHIFT, column >> GAIN_SHIFT]
                    strength = _strength(frame, row, column, ground, r, c, levels, g) / threshold - 0.5
                    if strength > 0.0:
                        evidence[row, column] = int(min(strength, 1.0) * FULL)
                        shaded = _is_shaded(frame, row, column, ground, r, c, levels, g, shadow)
                        classes[row, column] = SHADOW if shaded else OBJECT


@njit(cache=True, nogil=True, error_model="numpy")
def _is_shaded(frame, row, column, ground, r, c, levels, gain, shadow):  # type: ignore[no-untyped-def]
    """Whether the ratio to the ground is that of a cast shadow in all channels, on ground light enough to tell."""
    brightest = 0.0
    for k in range(3):
        level, expected = levels[k, frame[row, column, k]] * gain, float(ground[r, c, k])
        ratio = (level + 2.0) / (expected + 2.0)
        if not shadow[k, 0] <= ratio <= shadow[k, 1]:
            return False
        brightest = max(brightest, expected)
    return brightest >= _DARKEST_LEVEL
