"""Vehicles do not overlap: of two boxes that do, the worse one is made of what the better one left over.

A box takes its pixels when it is found. Where it did not fit well - a cab of another colour, a turned box over a lorry,
the edge of a shadow - enough is left for another box across it. Long vehicles leave more, and fit their pixels better.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_MOST_COVERED = 0.2
_MOST_COVERED_BY_LONG = 0.05
_LONG_M = 6.3
_POINTS = 12, 6


def stand_alone(
    boxes: NDArray[np.float64], score: NDArray[np.float64], px_per_m: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return which *boxes* (n, 6) no box of higher *score* (n,) covers, but for a small part.

    Boxes are column, row, and the half axes along (x, y) and across (x, y) in px; *px_per_m* along columns and rows.
    Boxes that are themselves left over count, too: where several lie on each other, the best remains.
    """
    scale = np.tile(np.array(px_per_m), 3)
    best_first = np.argsort(-score, kind="stable")
    alone = np.empty(len(boxes), np.bool_)
    alone[best_first] = _alone(np.ascontiguousarray(boxes[best_first] / scale))
    return alone


@njit(cache=True, nogil=True)
def _alone(boxes):  # type: ignore[no-untyped-def]
    alone = np.ones(len(boxes), np.bool_)
    reach = np.empty(len(boxes))
    for k in range(len(boxes)):
        reach[k] = np.hypot(boxes[k, 2], boxes[k, 3]) + np.hypot(boxes[k, 4], boxes[k, 5])
        for m in range(k):
            if np.hypot(boxes[k, 0] - boxes[m, 0], boxes[k, 1] - boxes[m, 1]) > reach[k] + reach[m]:
                continue
            is_long = 2 * np.hypot(boxes[m, 2], boxes[m, 3]) > _LONG_M
            if _covered(boxes[k], boxes[m]) > (_MOST_COVERED_BY_LONG if is_long else _MOST_COVERED):
                alone[k] = False
                break
    return alone


@njit(cache=True, nogil=True)
def _covered(box, other):  # type: ignore[no-untyped-def]
    """Share of *box* that lies within *other*, by points spread over it."""
    determinant = abs(other[2] * other[5] - other[3] * other[4])
    inside = 0
    for i in range(_POINTS[0]):
        along = (2 * i + 1) / _POINTS[0] - 1
        for j in range(_POINTS[1]):
            across = (2 * j + 1) / _POINTS[1] - 1
            x = box[0] + along * box[2] + across * box[4] - other[0]
            y = box[1] + along * box[3] + across * box[5] - other[1]
            inside += abs(x * other[5] - y * other[4]) < determinant and abs(y * other[2] - x * other[3]) < determinant
    return inside / (_POINTS[0] * _POINTS[1])
