"""How close vehicles stand to each other: the gap between the bodies of neighbours."""

from __future__ import annotations

import numpy as np

from vtrack_batch.evaluation.assignment import Array, Index, near_pairs


def nearest_gap(frame: Index, centre: Array, size: Array, heading_deg: Array, *, reach: float) -> Array:
    """Return for each vehicle the gap (n,) to the nearest other body of its frame; inf where none is within *reach*.

    *centre* (n, 2), *size* (n, 2) length and width, all in one unit. *heading_deg* (n,) turns from the first axis
    towards the second. Bodies are rectangles; the least distance of two that do not overlap is from a corner of one to
    a side of the other.
    """
    gap = np.full(len(frame), np.inf)
    known = np.flatnonzero(np.isfinite(np.c_[centre, size, heading_deg]).all(axis=1))
    if not len(known):
        return gap
    here = frame[known], centre[known]
    i, j, _ = near_pairs(here, here, float(np.hypot(*size[known].T).max()) + reach)
    i, j = known[i[i != j]], known[j[i != j]]
    angle = np.radians(heading_deg)
    forward = np.c_[np.cos(angle), np.sin(angle)]
    distance = np.minimum(*(_corner_gap(a, b, centre, size / 2, forward) for a, b in ((i, j), (j, i))))
    np.minimum.at(gap, i, distance)
    return np.where(gap <= reach, gap, np.inf)


def _corner_gap(a: Index, b: Index, centre: Array, half: Array, forward: Array) -> Array:
    """Return the least distance of the corners of bodies *a* from bodies *b*; 0 inside."""
    left = np.c_[-forward[:, 1], forward[:, 0]]
    least = np.full(len(a), np.inf)
    for along, across in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        corner = centre[a] + along * half[a, :1] * forward[a] + across * half[a, 1:] * left[a] - centre[b]
        outside = [
            np.maximum(np.abs((corner * axis[b]).sum(axis=1)) - half[b, k], 0) for k, axis in enumerate((forward, left))
        ]
        least = np.minimum(least, np.hypot(*outside))
    return least
