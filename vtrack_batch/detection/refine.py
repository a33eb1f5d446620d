"""Fine adjustment of fitted boxes: place, direction and size between the steps of the templates.

A box fits best where its edge runs along half evidence: the sum over its pixels of (evidence - 1/2) is largest there.
The sum is climbed coordinate by coordinate, by parabolas; soft edges make it smooth in all of them.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vtrack_batch.background.subtract import FULL, SHADOW, UNSEEN

_ROUNDS = 2
_HALF = 0.5
_SHARE = 1.0 / FULL


@njit(cache=True, nogil=True)
def refine(evidence, classes, boxes, px_per_m, shadow_evidence):  # type: ignore[no-untyped-def]
    """Return *boxes* (n, 6) - column, row, half axes along (x, y) and across (x, y), in px - adjusted.

    *px_per_m* (2,) along columns and rows. Places move by at most 1 m, directions by 10 degrees, sizes by a fifth.
    """
    adjusted = boxes.copy()
    steps = np.array([0.25, 0.15, np.radians(4.0), 0.08, 0.08])
    limits = np.array([1.0, 0.6, np.radians(10.0), 0.2, 0.2])
    values, moved = np.zeros(5), np.zeros(6)
    for n in range(len(boxes)):
        values[:] = 0.0
        here = _fit_moved(evidence, classes, boxes, n, values, px_per_m, shadow_evidence, moved)
        for _ in range(_ROUNDS):
            for p in range(5):
                start = values[p]
                values[p] = start - steps[p]
                before = _fit_moved(evidence, classes, boxes, n, values, px_per_m, shadow_evidence, moved)
                values[p] = start + steps[p]
                after = _fit_moved(evidence, classes, boxes, n, values, px_per_m, shadow_evidence, moved)
                values[p] = min(max(start + steps[p] * _to_top(before, here, after), -limits[p]), limits[p])
                there = _fit_moved(evidence, classes, boxes, n, values, px_per_m, shadow_evidence, moved)
                if there > here:
                    here = there
                else:
                    values[p] = start
        _move(boxes, n, values, px_per_m, moved)
        adjusted[n] = moved
    return adjusted


@njit(cache=True, nogil=True)
def _to_top(before, here, after):  # type: ignore[no-untyped-def]
    """Way to the top of the parabola through three sums one step apart, in steps; at most one step."""
    bend = before - 2 * here + after
    if bend >= -1e-9:
        return 1.0 if after > before else -1.0
    return min(max(0.5 * (before - after) / bend, -1.0), 1.0)


@njit(cache=True, nogil=True)
def _move(boxes, n, values, px_per_m, moved):  # type: ignore[no-untyped-def]
    """Write to *moved* the *n*-th box moved by *values*: metres along and across, radians, growth along and across."""
    lx, ly = boxes[n, 2] / px_per_m[0], boxes[n, 3] / px_per_m[1]
    wx, wy = boxes[n, 4] / px_per_m[0], boxes[n, 5] / px_per_m[1]
    length, width = np.hypot(lx, ly), np.hypot(wx, wy)
    cos, sin = np.cos(values[2]), np.sin(values[2])
    longer, wider = 1 + values[3], 1 + values[4]
    moved[0] = boxes[n, 0] + (values[0] * lx / length + values[1] * wx / width) * px_per_m[0]
    moved[1] = boxes[n, 1] + (values[0] * ly / length + values[1] * wy / width) * px_per_m[1]
    moved[2] = (lx * cos - ly * sin) * longer * px_per_m[0]
    moved[3] = (lx * sin + ly * cos) * longer * px_per_m[1]
    moved[4] = (wx * cos - wy * sin) * wider * px_per_m[0]
    moved[5] = (wx * sin + wy * cos) * wider * px_per_m[1]


@njit(cache=True, nogil=True)
def _fit_moved(evidence, classes, boxes, n, values, px_per_m, shadow_evidence, moved):  # type: ignore[no-untyped-def]
    """Sum of (evidence - 1/2) over the *n*-th box moved by *values*; its edge is one pixel soft."""
    _move(boxes, n, values, px_per_m, moved)
    column, row, lx, ly, wx, wy = moved[0], moved[1], moved[2], moved[3], moved[4], moved[5]
    height, width = evidence.shape
    # From pixels to parts of the half axes.
    scale = 1.0 / (lx * wy - ly * wx)
    along_x, along_y, across_x, across_y = wy * scale, -wx * scale, -ly * scale, lx * scale
    # How many pixels the half axes are long, for the softness of the edge.
    half_length, half_width = np.hypot(lx, ly), np.hypot(wx, wy)
    reach_r, reach_c = abs(ly) + abs(wy) + 1, abs(lx) + abs(wx) + 1
    total = 0.0
    for i in range(max(0, int(np.floor(row - reach_r))), min(height - 1, int(np.ceil(row + reach_r))) + 1):
        y = i - row
        for j in range(max(0, int(np.floor(column - reach_c))), min(width - 1, int(np.ceil(column + reach_c))) + 1):
            x = j - column
            along = (1.0 - abs(x * along_x + y * along_y)) * half_length + 0.5
            across = (1.0 - abs(x * across_x + y * across_y)) * half_width + 0.5
            if along <= 0.0 or across <= 0.0 or classes[i, j] == UNSEEN:
                continue
            value = evidence[i, j] * _SHARE
            if classes[i, j] == SHADOW:
                value *= shadow_evidence
            total += min(along, 1.0) * min(across, 1.0) * (value - _HALF)
    return total
