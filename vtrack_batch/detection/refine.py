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


@njit(cache=True, nogil=True)
def refine(evidence, classes, boxes, px_per_m, shadow_evidence):  # type: ignore[no-untyped-def]
    """Return *boxes* (n, 6) - column, row, half axes along (x, y) and across (x, y), in px - adjusted.

    *px_per_m* (2,) along columns and rows. Places move by at most 1 m, directions by 10 degrees, sizes by a fifth.
    """
    adjusted = boxes.copy()
    steps = np.array([0.25, 0.15, np.radians(4.0), 0.08, 0.08])
    limits = np.array([1.0, 0.6, np.radians(10.0), 0.2, 0.2])
    for n in range(len(boxes)):
        values = np.zeros(5)
        for _ in range(_ROUNDS):
            here = _fit(evidence, classes, _moved(boxes[n], values, px_per_m), px_per_m, shadow_evidence)
            for p in range(5):
                start = values[p]
                values[p] = start - steps[p]
                before = _fit(evidence, classes, _moved(boxes[n], values, px_per_m), px_per_m, shadow_evidence)
                values[p] = start + steps[p]
                after = _fit(evidence, classes, _moved(boxes[n], values, px_per_m), px_per_m, shadow_evidence)
                values[p] = min(max(start + steps[p] * _to_top(before, here, after), -limits[p]), limits[p])
                there = _fit(evidence, classes, _moved(boxes[n], values, px_per_m), px_per_m, shadow_evidence)
                if there > here:
                    here = there
                else:
                    values[p] = start
        adjusted[n] = _moved(boxes[n], values, px_per_m)
    return adjusted


@njit(cache=True, nogil=True)
def _to_top(before, here, after):  # type: ignore[no-untyped-def]
    """Way to the top of the parabola through three sums one step apart, in steps; at most one step."""
    bend = before - 2 * here + after
    if bend >= -1e-9:
        return 1.0 if after > before else -1.0
    return min(max(0.5 * (before - after) / bend, -1.0), 1.0)


@njit(cache=True, nogil=True)
def _moved(box, values, px_per_m):  # type: ignore[no-untyped-def]
    """Move *box* by *values*: metres along and across, radians, relative growth of length and width."""
    lx, ly, wx, wy = box[2] / px_per_m[0], box[3] / px_per_m[1], box[4] / px_per_m[0], box[5] / px_per_m[1]
    length, width = np.hypot(lx, ly), np.hypot(wx, wy)
    x = values[0] * lx / length + values[1] * wx / width
    y = values[0] * ly / length + values[1] * wy / width
    cos, sin = np.cos(values[2]), np.sin(values[2])
    longer, wider = 1 + values[3], 1 + values[4]
    return np.array(
        [
            box[0] + x * px_per_m[0],
            box[1] + y * px_per_m[1],
            (lx * cos - ly * sin) * longer * px_per_m[0],
            (lx * sin + ly * cos) * longer * px_per_m[1],
            (wx * cos - wy * sin) * wider * px_per_m[0],
            (wx * sin + wy * cos) * wider * px_per_m[1],
        ]
    )


@njit(cache=True, nogil=True)
def _fit(evidence, classes, box, px_per_m, shadow_evidence):  # type: ignore[no-untyped-def]
    """Sum of (evidence - 1/2) over the box, whose edge is one pixel soft."""
    column, row, lx, ly, wx, wy = box
    height, width = evidence.shape
    determinant = lx * wy - ly * wx
    # How many pixels the half axes are long, for the softness of the edge.
    half_length, half_width = np.hypot(lx, ly), np.hypot(wx, wy)
    reach_r, reach_c = abs(ly) + abs(wy) + 1, abs(lx) + abs(wx) + 1
    total = 0.0
    for i in range(max(0, int(np.floor(row - reach_r))), min(height - 1, int(np.ceil(row + reach_r))) + 1):
        for j in range(max(0, int(np.floor(column - reach_c))), min(width - 1, int(np.ceil(column + reach_c))) + 1):
            x, y = j - column, i - row
            along = (1.0 - abs((x * wy - y * wx) / determinant)) * half_length + 0.5
            across = (1.0 - abs((y * lx - x * ly) / determinant)) * half_width + 0.5
            if along <= 0.0 or across <= 0.0 or classes[i, j] == UNSEEN:
                continue
            value = evidence[i, j] / FULL
            if classes[i, j] == SHADOW:
                value *= shadow_evidence
            total += min(along, 1.0) * min(across, 1.0) * (value - _HALF)
    return total
