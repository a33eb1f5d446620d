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
    lab = np.asarray(cv2.cvtColor(picture[: height * CELL, : width * CELL], cv2.COLOR_RGB2LAB), np.uint8)
    edges = _edges(lab)
    coarse = np.asarray(cv2.resize(lab, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    # Luminance is levelled by what is around.
    lit = np.asarray(cv2.dilate(wanted, np.ones((_USUAL_CELLS, _USUAL_CELLS), np.uint8)), np.uint8)
    light, red, blue = (np.ascontiguousarray(coarse[:, :, k]) for k in range(3))
    usual = medians(light, lit), medians(red, wanted), medians(blue, wanted)
    busy = _levelled(edges[0] ** 2 + edges[1] ** 2)
    even = _levelled(cv2.absdiff(light, usual[0]).astype(np.float32))
    return np.asarray(_told(edges, coarse, *usual, busy, even), np.float32)


@njit(cache=True, nogil=True)
def _edges(lab):  # type: ignore[no-untyped-def]
    """Return edges along, across, and corners (3, h / 2, w / 2) float32 of the first channel of *lab* (h, w, 3) uint8.

    The mean over a cell of the square root of the change per pixel, after a blur by 1 2 1 both ways; at the rim the
    picture is mirrored. Blurred levels are counted in sixteenths, so that up to the root all numbers are whole.
    """
    height, width = lab.shape[:2]
    smooth, column = np.empty((height, width), np.int32), np.empty(width, np.int32)
    for r in range(height):
        above, below = lab[abs(r - 1)], lab[min(r + 1, 2 * height - 3 - r)]
        for c in range(width):
            column[c] = above[c, 0] + 2 * lab[r, c, 0] + below[c, 0]
        for c in range(1, width - 1):
            smooth[r, c] = column[c - 1] + 2 * column[c] + column[c + 1]
        smooth[r, 0], smooth[r, -1] = 2 * (column[0] + column[1]), 2 * (column[-1] + column[-2])
    found = np.empty((3, height // CELL, width // CELL), np.float32)
    roots = np.zeros((CELL, 3, width), np.float32)
    for i in range(height // CELL):
        for part in range(CELL):
            r = CELL * i + part
            here, above, below = smooth[r], smooth[abs(r - 1)], smooth[min(r + 1, 2 * height - 3 - r)]
            _roots(here, above, below, roots[part])
        for k in range(3):
            upper, lower = roots[0, k], roots[1, k]
            for j in range(width // CELL):
                total = (upper[2 * j] + upper[2 * j + 1]) + (lower[2 * j] + lower[2 * j + 1])
                found[k, i, j] = total * np.float32(0.0625)
    return found


@njit(cache=True, nogil=True)
def _roots(here, above, below, roots):  # type: ignore[no-untyped-def]
    """Fill *roots* (3, w) with the roots of the changes along a row, across it, and of the lesser of both."""
    for c in range(len(here)):
        roots[1, c] = np.sqrt(np.float32(abs(below[c] - above[c])))
    roots[0, 0] = roots[0, -1] = 0.0
    for c in range(1, len(here) - 1):
        roots[0, c] = np.sqrt(np.float32(abs(here[c + 1] - here[c - 1])))
    for c in range(len(here)):
        roots[2, c] = roots[0, c] if roots[0, c] < roots[1, c] else roots[1, c]


@njit(cache=True, nogil=True)
def _told(edges, coarse, light, red, blue, busy, even):  # type: ignore[no-untyped-def]
    """Return the channels (6, h, w) float32: *edges*, and how far cells of *coarse* (h, w, 3) are from the usual.

    The usual is *light*, *red*, *blue* (h, w) uint8; *busy* and *even* level edges and luminance.
    """
    height, width = light.shape
    told = np.empty((CHANNELS, height, width), np.float32)
    for r in range(height):
        for k in range(3):
            for c in range(width):
                told[k, r, c] = edges[k, r, c] * busy[r, c]
        for c in range(width):
            off = np.int32(coarse[r, c, 0]) - np.int32(light[r, c])
            told[3, r, c] = np.sqrt(np.float32(abs(off))) * even[r, c]
            told[4, r, c] = np.sqrt(np.float32(-off if off < 0 else 0)) * even[r, c]
            first, second = (
                np.int32(coarse[r, c, 1]) - np.int32(red[r, c]),
                np.int32(coarse[r, c, 2]) - np.int32(blue[r, c]),
            )
            told[5, r, c] = np.sqrt(np.sqrt(np.float32(first * first + second * second)))
    return told


def _levelled(strength: Floats) -> Floats:
    """Return what brings square roots of *strength* to one level everywhere."""
    around = cv2.blur(strength, (_USUAL_CELLS, _USUAL_CELLS))
    return np.asarray(_LEVEL / np.sqrt(around + _LEAST), np.float32)
