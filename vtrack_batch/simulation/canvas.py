"""A drawing board in scene metres: polygons, masks and textures on the image of the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation.paint import SHADOW_RATIO
from vtrack_batch.simulation.stage import Stage

Float32 = NDArray[np.float32]
_SHIFT = 4


@dataclass(frozen=True)
class Canvas:
    """``shape`` (height, width) of the image; ``px_per_frame_px`` is how much finer it is than the frames."""

    shape: tuple[int, int]
    px_per_frame_px: int
    px_per_m: float
    to_reference: Array
    scene_to_px: Array
    scene_to_ground: Array

    def mask(self, polygons: Sequence[Array]) -> NDArray[np.uint8]:
        """Return (H, W) uint8, 255 inside the *polygons* (k, 2) of scene metres, with smooth borders."""
        mask = np.zeros(self.shape, np.uint8)
        for polygon in polygons:
            cv2.fillPoly(mask, [self.fixed(polygon)], 255, cv2.LINE_AA, _SHIFT)
        return mask

    def fixed(self, polygon: Array) -> NDArray[np.int32]:
        """Return scene points as the fixed-point pixels that OpenCV draws with ``shift=4``."""
        return np.asarray(np.round(apply(self.scene_to_px, polygon) * (1 << _SHIFT)).astype(np.int32))

    def fill(self, image: Float32, polygon: Array, rgb: ArrayLike) -> None:
        """Fill one polygon of scene metres with a flat colour, anti-aliased."""
        px = apply(self.scene_to_px, polygon)
        height, width = self.shape
        low = np.maximum(np.floor(px.min(axis=0)).astype(int) - 2, 0)
        high = np.minimum(np.ceil(px.max(axis=0)).astype(int) + 3, (width, height))
        if (low >= high).any():
            return
        patch = np.zeros((high[1] - low[1], high[0] - low[0]), np.uint8)
        corners = np.round((px - low) * (1 << _SHIFT)).astype(np.int32)
        cv2.fillPoly(patch, [corners], 255, cv2.LINE_AA, _SHIFT)
        part = (patch.astype(np.float32) / 255)[..., None]
        view = image[low[1] : high[1], low[0] : high[0]]
        view += part * (np.asarray(rgb, np.float32) - view)

    def inside(self, scene: Array, *, margin_m: float) -> NDArray[np.bool_]:
        """Return which scene points lie on the canvas, or at most *margin_m* outside it."""
        px = apply(self.scene_to_px, scene)
        more = margin_m * self.px_per_m
        height, width = self.shape
        return np.asarray(
            (px[:, 0] > -more) & (px[:, 0] < width + more) & (px[:, 1] > -more) & (px[:, 1] < height + more)
        )

    def extent_m(self) -> Array:
        """Return the least and greatest scene coordinates (2, 2) on the canvas."""
        height, width = self.shape
        corners: Array = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float64)
        scene = apply(np.asarray(np.linalg.inv(self.scene_to_px), np.float64), corners)
        return np.stack([scene.min(axis=0), scene.max(axis=0)])


def new_canvas(stage: Stage, *, fine: int, margin_px: int) -> Canvas:
    """Return a canvas *fine* times finer than the frames that reaches *margin_px* frame pixels beyond the reference."""
    shape = ((stage.height_px + 2 * margin_px) * fine, (stage.width_px + 2 * margin_px) * fine)
    to_reference = np.array(
        [[1 / fine, 0, 0.5 / fine - 0.5 - margin_px], [0, 1 / fine, 0.5 / fine - 0.5 - margin_px], [0, 0, 1]]
    )
    to_px = np.linalg.inv(to_reference) @ stage.ground_to_reference @ stage.scene_to_ground
    return Canvas(shape, fine, fine / stage.gsd_m, to_reference, to_px, stage.scene_to_ground)


def rectangle(x: tuple[float, float], y: tuple[float, float]) -> Array:
    """Return the corners (4, 2) of an upright rectangle."""
    return np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]], float)


def multiscale(canvas: Canvas, cells_m: Sequence[float], rng: np.random.Generator) -> Float32:
    """Return smooth noise (H, W) of about unit spread, summed over grids of the given cell sizes in metres."""
    height, width = canvas.shape
    total = np.zeros(canvas.shape, np.float32)
    for cell in cells_m:
        step = max(1.0, cell * canvas.px_per_m)
        grid = rng.standard_normal((int(height / step) + 4, int(width / step) + 4)).astype(np.float32)
        total += cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(total / np.float32(np.sqrt(len(cells_m)) * 0.75), np.float32)


def shaded(image: Float32, shade: Float32) -> None:
    """Darken *image* (H, W, 3) where *shade* (H, W), 0-1, says that it lies in shadow."""
    for c in range(3):
        image[..., c] *= 1 - np.float32(1 - SHADOW_RATIO[c]) * shade
