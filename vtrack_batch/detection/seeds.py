"""What the pixels of a difference count for in boxes, and where boxes are tried."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.background.subtract import FULL, OBJECT, SHADOW, UNSEEN, Difference

HIDDEN = -30_000
"""What hidden pixels count for: so little that one of them makes the sum over any box negative."""

_REACH_M = 0.6
_CORE = 0.4
_BAND = 256


@dataclass(frozen=True, eq=False)
class Layers:
    """What each pixel counts for inside a box, on its rim and in its shadow.

    ``inner`` int16, ``rim`` and ``cast`` uint8, (H + 2 m, W + 2 m) with a hidden ``margin`` of m all around.
    """

    inner: NDArray[np.int16]
    rim: NDArray[np.uint8]
    cast: NDArray[np.uint8]
    margin: int


@dataclass(frozen=True, eq=False)
class Seeds:
    """Places to try: ``grid`` (n, 2) int64 row and column on a coarse grid of every ``step``-th (row, column) pixel.

    ``core`` (3,) int64: within so many rows and columns of each the sum of what counts inside a box is no less.
    """

    grid: NDArray[np.int64]
    step: tuple[int, int]
    core: NDArray[np.int64]


def make_layers(difference: Difference, margin: int, shadow_evidence: float) -> Layers:
    """Return what the pixels of *difference* count for; shadow-like ones count *shadow_evidence* inside a box."""
    inner, rim, cast = _layers(difference.evidence, difference.classes, margin, shadow_evidence)
    return Layers(inner, rim, cast, margin)


def find_seeds(layers: Layers, px_per_m: tuple[float, float], step_m: float) -> Seeds:
    """Return places on a grid of *step_m* around which most pixels count."""
    step = (max(1, round(step_m * px_per_m[1])), max(1, round(step_m * px_per_m[0])))
    reach = (round(_REACH_M * px_per_m[1]), round(_REACH_M * px_per_m[0]))
    window = (2 * reach[0] + 1, 2 * reach[1] + 1)
    core = np.array([*reach, int(np.ceil(_CORE * FULL * window[0] * window[1]))])
    height, grid = layers.inner.shape[0] - 2 * layers.margin, [np.zeros((0, 2), np.int64)]
    # Some rows at a time: a frame may be large.
    for first in range(0, height, _BAND * step[0]):
        last = min(height, first + _BAND * step[0])
        top, bottom = max(0, first - reach[0]), min(height, last + reach[0])
        part = layers.inner[layers.margin :, layers.margin : -layers.margin][top:bottom]
        around = cv2.blur(_counted(part), (window[1], window[0]))
        found = _at_least(np.asarray(around[first - top : last - top]), step, round(_CORE * FULL))
        grid.append(found + np.array([first // step[0], 0]))
    return Seeds(np.concatenate(grid), step, core)


@njit(cache=True, nogil=True)
def _layers(evidence, classes, margin, shadow_evidence):  # type: ignore[no-untyped-def]
    height, width = evidence.shape
    inner = np.full((height + 2 * margin, width + 2 * margin), HIDDEN, np.int16)
    rim = np.zeros(inner.shape, np.uint8)
    cast = np.zeros(inner.shape, np.uint8)
    weight = int(shadow_evidence * 256 + 0.5)
    for r in range(height):
        kinds, values = classes[r], evidence[r]
        inner_row = inner[r + margin, margin : margin + width]
        rim_row, cast_row = rim[r + margin, margin : margin + width], cast[r + margin, margin : margin + width]
        # Selections in place of branches: compilers turn them into vector instructions.
        for c in range(width):
            kind, value = kinds[c], np.int32(values[c])
            inside = (value * weight) >> 8 if kind == SHADOW else value
            inner_row[c] = HIDDEN if kind == UNSEEN else inside
            rim_row[c] = values[c] if kind == OBJECT else 0
            cast_row[c] = 1 if kind == SHADOW else 0
    return inner, rim, cast


@njit(cache=True, nogil=True)
def _counted(inner):  # type: ignore[no-untyped-def]
    """Return what counts inside a box (h, w) uint8, 0 where hidden."""
    counted = np.empty(inner.shape, np.uint8)
    for r in range(inner.shape[0]):
        values, counts = inner[r], counted[r]
        for c in range(len(values)):
            value = values[c]
            counts[c] = np.uint8(value if value > 0 else np.int16(0))
    return counted


@njit(cache=True, nogil=True)
def _at_least(around, step, least):  # type: ignore[no-untyped-def]
    """Return row and column (n, 2), counted in steps, where every *step*-th pixel of *around* is *least* or more."""
    rows, columns = -(-around.shape[0] // step[0]), -(-around.shape[1] // step[1])
    found, count = np.empty((rows * columns, 2), np.int64), 0
    for i in range(rows):
        row = around[i * step[0]]
        for j in range(columns):
            if row[j * step[1]] >= least:
                found[count, 0], found[count, 1] = i, j
                count += 1
    return found[:count].copy()
