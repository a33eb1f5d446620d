"""A drawing board in scene metres: polygons and masks on the image of the ground, whole or strip by strip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation.paint import SHADOW_RATIO
from vtrack_batch.simulation.stage import Stage

Float32 = NDArray[np.float32]
_SHIFT = 4
_FURTHEST_PX = 100_000.0
"""OpenCV's fixed-point coordinates end not far beyond; what lies further out is not seen anyway."""


@dataclass(frozen=True)
class Canvas:
    """``shape`` (height, width) of the image; ``px_per_frame_px`` is how much finer it is than the frames.

    ``first_row`` is where a strip begins in the whole canvas.
    """

    shape: tuple[int, int]
    px_per_frame_px: float
    px_per_m: float
    to_reference: Array
    scene_to_px: Array
    scene_to_ground: Array
    first_row: int = 0

    def rows(self, first: int, last: int) -> Canvas:
        """Return the strip of the rows *first* to *last*, the latter not included."""
        up = np.array([[1, 0, 0], [0, 1, -float(first)], [0, 0, 1]])
        return replace(
            self,
            shape=(last - first, self.shape[1]),
            to_reference=self.to_reference @ np.linalg.inv(up),
            scene_to_px=up @ self.scene_to_px,
            first_row=self.first_row + first,
        )

    def coarser(self, px_per_m: float) -> Canvas:
        """Return a canvas over the same ground with about *px_per_m* pixels a metre, at most its own."""
        factor = max(1, round(self.px_per_m / px_per_m))
        middle = (factor - 1) / 2
        to_own = np.array([[factor, 0, middle], [0, factor, middle], [0, 0, 1.0]])
        return replace(
            self,
            shape=(self.shape[0] // factor + 1, self.shape[1] // factor + 1),
            px_per_frame_px=self.px_per_frame_px / factor,
            px_per_m=self.px_per_m / factor,
            to_reference=self.to_reference @ to_own,
            scene_to_px=np.linalg.inv(to_own) @ self.scene_to_px,
        )

    def mask(self, polygons: Sequence[Array]) -> NDArray[np.uint8]:
        """Return (H, W) uint8, 255 inside the *polygons* (k, 2) of scene metres, with smooth borders."""
        mask = np.zeros(self.shape, np.uint8)
        for polygon in polygons:
            self.add(mask, polygon)
        return mask

    def add(self, mask: NDArray[np.uint8], polygon: Array, level: int = 255) -> None:
        """Set *mask* (H, W) to *level* inside one polygon of scene metres, if that is in view at all."""
        px = apply(self.scene_to_px, polygon)
        height, width = self.shape
        if len(px) < 3 or (px.max(axis=0) < -2).any() or (px.min(axis=0) > (width + 2, height + 2)).any():
            return
        fixed = np.round(np.clip(px, -_FURTHEST_PX, _FURTHEST_PX) * (1 << _SHIFT)).astype(np.int32)
        cv2.fillPoly(mask, [fixed], level, cv2.LINE_AA, _SHIFT)

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
        view = image[low[1] : high[1], low[0] : high[0]]
        view += (patch.astype(np.float32) / 255)[..., None] * (np.asarray(rgb, np.float32) - view)

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


def oblong(middle: Array, half: Array, direction: Array) -> Array:
    """Return the corners (4, 2) of a rectangle about *middle* whose first half size lies along *direction*."""
    across = np.array([-direction[1], direction[0]])
    return np.asarray(middle + rectangle((-half[0], half[0]), (-half[1], half[1])) @ np.stack([direction, across]))


def shaded(image: Float32, shade: Float32) -> None:
    """Darken *image* (H, W, 3) where *shade* (H, W), 0-1, says that it lies in shadow."""
    for c in range(3):
        image[..., c] *= 1 - np.float32(1 - SHADOW_RATIO[c]) * shade


@njit(cache=True, nogil=True)
def lay(image, mask, colour):  # type: ignore[no-untyped-def]
    """Lay a flat *colour* (3,) over ``image`` (H, W, 3) float32 as far as *mask* (H, W) uint8 says."""
    for row in range(image.shape[0]):
        for col in range(image.shape[1]):
            if mask[row, col]:
                part = np.float32(mask[row, col]) / np.float32(255.0)
                for c in range(3):
                    image[row, col, c] += part * (colour[c] - image[row, col, c])
