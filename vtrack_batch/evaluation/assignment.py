"""The best one-to-one pairing of two sets, given which pairs are possible and what each is worth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_FRAME_STEP_PX = 1e6
"""Frames lie this far apart along a third axis, so that one search serves all of them."""


def near_pairs(a: tuple[Index, Array], b: tuple[Index, Array], reach_px: float) -> tuple[Index, Index, Array]:
    """Return all pairs (row of a, row of b, distance) of the same frame within *reach_px*.

    *a* and *b* are (frame (n,), centres (n, 2) in pixels).
    """
    if not len(a[0]) or not len(b[0]):
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    trees = [KDTree(np.c_[xy, frame * _FRAME_STEP_PX]) for frame, xy in (a, b)]
    near = trees[0].sparse_distance_matrix(trees[1], reach_px * 1.001 + 1e-6, output_type="ndarray")
    i, j = near["i"].astype(np.int64), near["j"].astype(np.int64)
    distance = np.hypot(*(a[1][i] - b[1][j]).T)
    keep = np.flatnonzero(distance <= reach_px)
    keep = keep[np.lexsort((j[keep], i[keep]))]
    return i[keep], j[keep], distance[keep]


def best_pairs(i: Index, j: Index, gain: Array) -> Index:
    """Return the positions, in order, of those pairs that form the one-to-one pairing of largest total *gain* (> 0).

    ``i``, ``j``, ``gain`` (n,) list the possible pairs, each once; all others are worth nothing. Exact: the pairs fall
    into independent groups, and each group is solved by the Hungarian method (Kuhn 1955; Crouse 2016).
    """
    if not len(i):
        return np.empty(0, np.int64)
    _, i = np.unique(i, return_inverse=True)
    _, j = np.unique(j, return_inverse=True)
    left, nodes = int(i.max()) + 1, int(i.max()) + int(j.max()) + 2
    _, label = connected_components(coo_array((np.ones(len(i)), (i, left + j)), shape=(nodes, nodes)), directed=False)
    group = label[i]
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.r_[True, np.diff(group[order]) != 0, True])
    alone = np.diff(starts) == 1
    kept = [order[starts[:-1][alone]]]
    for start, stop in zip(starts[:-1][~alone], starts[1:][~alone], strict=True):
        kept.append(_solve(order[start:stop], i, j, gain))
    return np.sort(np.concatenate(kept)).astype(np.int64)


def _solve(pairs: Index, i: Index, j: Index, gain: Array) -> Index:
    """Solve one group densely; impossible pairs are worth nothing and dropped."""
    rows, row = np.unique(i[pairs], return_inverse=True)
    columns, column = np.unique(j[pairs], return_inverse=True)
    worth = np.zeros((len(rows), len(columns)))
    place = np.full(worth.shape, -1, np.int64)
    worth[row, column], place[row, column] = gain[pairs], pairs
    chosen = place[linear_sum_assignment(-worth)]
    return np.asarray(chosen[chosen >= 0])
