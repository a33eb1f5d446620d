"""What vehicles look like from above, learned from the block's own moving ones: no labels, no outside data.

A window of 8 x 4.5 m along the vehicle's axis is described by cells of half a metre: edges along and across the axis,
corners, and how far luminance and colour are from what is usual around; edges and luminance are levelled, so that cars
in shade look like cars in the sun. One linear discriminant (Fisher 1936) tells windows on vehicles from windows
anywhere; histograms of gradients with one covariance for all (Hariharan et al. 2012) do with few examples.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.detection.medians import REACH, medians

Floats = NDArray[np.float32]

STEP_M = 0.25
"""Distance of the pixels that windows are drawn on; a cell is two of them wide."""
CELL = 2
LONG, WIDE, CHANNELS = 16, 9, 6
"""Cells of a window along and across, and what is told of each."""
REACH_PX = 14
"""Pixels around a window that tell what is usual there."""

_USUAL_CELLS = 2 * REACH + 1
_LEVEL, _LEAST = 4.0, 4.0
_SHRINKAGE = 0.05
_AT_ONCE = 400


@dataclass(frozen=True, eq=False)
class Appearance:
    """A linear score of windows: about 1 on vehicles, -1 elsewhere; ``weights`` (channels, WIDE, LONG) float32."""

    weights: Floats
    offset: float

    def score(self, described: Floats) -> NDArray[np.float64]:
        """Return the score of windows (n, channels, WIDE, LONG)."""
        return np.asarray(described.reshape(len(described), -1).astype(np.float64) @ self.weights.ravel() + self.offset)


def learn_appearance(vehicles: Floats, others: Floats) -> Appearance:
    """Learn from described windows (n, channels, WIDE, LONG) on vehicles, whichever way they point, and elsewhere."""
    turned = [vehicles, vehicles[..., ::-1], vehicles[..., ::-1, :], vehicles[..., ::-1, ::-1]]
    inside = np.concatenate(turned).reshape(4 * len(vehicles), -1).astype(np.float64)
    outside = others.reshape(len(others), -1).astype(np.float64)
    apart = inside.mean(axis=0) - outside.mean(axis=0)
    spread = (np.cov(inside.T) + np.cov(outside.T)) / 2
    spread += _SHRINKAGE * np.trace(spread) / len(spread) * np.eye(len(spread))
    weights = np.linalg.solve(spread, apart)
    weights *= 2 / (weights @ apart)
    middle = (inside.mean(axis=0) + outside.mean(axis=0)) / 2
    return Appearance(weights.reshape(vehicles.shape[1:]).astype(np.float32), -float(weights @ middle))


def describe(
    picture: NDArray[np.uint8],
    centres_px: NDArray[np.float64],
    axes_m: NDArray[np.float64],
    px_per_m: tuple[float, float],
) -> Floats:
    """Describe windows of *picture* (h, w, 3) uint8 at *centres_px* (n, 2) along *axes_m* (n, 2).

    Axes are vectors on the ground, *px_per_m* is along columns and rows. Returns (n, channels, WIDE, LONG) float32.
    """
    width, height = LONG * CELL + 2 * REACH_PX, WIDE * CELL + 2 * REACH_PX
    margin = REACH_PX // CELL
    inner = np.zeros((height // CELL, width // CELL), np.uint8)
    inner[margin : margin + WIDE, margin : margin + LONG] = 1
    found = [np.zeros((0, CHANNELS, WIDE, LONG), np.float32)]
    unit = axes_m / np.maximum(np.linalg.norm(axes_m, axis=1), 1e-9)[:, None]
    for first in range(0, len(centres_px), _AT_ONCE):
        centre = centres_px[first : first + _AT_ONCE]
        x, y = _sheet(centre, unit[first : first + _AT_ONCE], px_per_m, height, width)
        drawn = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        wanted = np.tile(inner, (len(centre), 1))
        cells = channels_of(np.asarray(drawn, np.uint8), wanted).reshape(-1, len(centre), *inner.shape)
        found.append(cells[:, :, margin : margin + WIDE, margin : margin + LONG].transpose(1, 0, 2, 3))
    return np.concatenate(found)


@njit(cache=True, nogil=True)
def _sheet(centres, axes, px_per_m, height, width):  # type: ignore[no-untyped-def]
    """Return where (x, y), in px, the pixels lie of windows of *height* x *width*, one below the other."""
    x = np.empty((len(centres) * height, width), np.float32)
    y = np.empty_like(x)
    for n in range(len(centres)):
        along, down = axes[n, 0], axes[n, 1]
        for r in range(height):
            v = (r - (height - 1) / 2) * STEP_M
            for c in range(width):
                u = (c - (width - 1) / 2) * STEP_M
                x[n * height + r, c] = centres[n, 0] + px_per_m[0] * (u * along - v * down)
                y[n * height + r, c] = centres[n, 1] + px_per_m[1] * (u * down + v * along)
    return x, y


def channels_of(picture: NDArray[np.uint8], wanted: NDArray[np.uint8]) -> Floats:
    """Return what the cells (channels, h / 2, w / 2) of a *picture* (h, w, 3) uint8 with STEP_M to a pixel show.

    What is told of others than the *wanted* ones (h / 2, w / 2), 1, else 0, is not to be relied on.
    """
    height, width = picture.shape[0] // CELL, picture.shape[1] // CELL
    lab = cv2.cvtColor(picture[: height * CELL, : width * CELL], cv2.COLOR_RGB2LAB)
    light = cv2.GaussianBlur(lab[:, :, 0].astype(np.float32), (3, 3), 0)
    along = np.abs(cv2.Sobel(light, cv2.CV_32F, 1, 0, ksize=1))
    across = np.abs(cv2.Sobel(light, cv2.CV_32F, 0, 1, ksize=1))
    edges = [_in_cells(np.sqrt(one)) for one in (along, across, np.minimum(along, across))]
    coarse = cv2.resize(lab, (width, height), interpolation=cv2.INTER_AREA)
    # Luminance is levelled by what is around.
    lit = np.asarray(cv2.dilate(wanted, np.ones((_USUAL_CELLS, _USUAL_CELLS), np.uint8)), np.uint8)
    usual = [medians(np.ascontiguousarray(coarse[:, :, k]), (lit, wanted, wanted)[k]) for k in range(3)]
    off = coarse.astype(np.float32) - np.dstack(usual).astype(np.float32)
    bright = np.abs(off[:, :, 0])
    busy, even = _levelled(edges[0] ** 2 + edges[1] ** 2), _levelled(bright)
    darker = np.sqrt(np.maximum(-off[:, :, 0], 0))
    colour = np.sqrt(np.hypot(off[:, :, 1], off[:, :, 2]))
    told = *(edge * busy for edge in edges), np.sqrt(bright) * even, darker * even, colour
    return np.stack(told).astype(np.float32)


def _in_cells(image: Floats) -> Floats:
    size = (image.shape[1] // CELL, image.shape[0] // CELL)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def _levelled(strength: Floats) -> Floats:
    """Return what brings square roots of *strength* to one level everywhere."""
    around = cv2.blur(strength, (_USUAL_CELLS, _USUAL_CELLS))
    return np.asarray(_LEVEL / np.sqrt(around + _LEAST), np.float32)
