"""Which vehicles of the later image can be which of the earlier one: a sparse list of edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from vtrack_batch.errors import UnusableData

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Edges:
    """Possible links between ``n`` earlier and ``m`` later vehicles, sorted by (i, k).

    ``i``, ``k`` (e,) int64 are row numbers in the two images, ``displacement`` (e, 2) float64 the vectors between them.
    """

    n: int
    m: int
    i: Index
    k: Index
    displacement: Array

    def __len__(self) -> int:
        return len(self.i)

    @property
    def first(self) -> Index:
        """First edge of every earlier vehicle, (n + 1,): edges of i are first[i] ... first[i + 1] - 1."""
        return np.searchsorted(self.i, np.arange(self.n + 1))

    def select(self, keep: NDArray[np.bool_] | Index) -> Edges:
        """Return the edges picked by a mask, or by ascending row numbers."""
        return Edges(self.n, self.m, self.i[keep], self.k[keep], self.displacement[keep])


def candidates(earlier_xy: Array, later_xy: Array, reach: float, *, limit: int = 20_000_000) -> Edges:
    """List the pairs of points whose displacement lies in the box +-*reach* (Fuse & Shimizu, eq. 3).

    Points are (n, 2) and (m, 2) float64, *reach* (D) in the same unit. More than *limit* pairs raise ``UnusableData``.
    """
    n, m = len(earlier_xy), len(later_xy)
    if n == 0 or m == 0:
        none = np.zeros(0, np.int64)
        return Edges(n, m, none, none, np.zeros((0, 2)))
    i, k = pairs_within(earlier_xy, later_xy, reach, p=np.inf, limit=limit)
    return Edges(n, m, i, k, later_xy[k] - earlier_xy[i])


def pairs_within(a_xy: Array, b_xy: Array, radius: float, *, p: float, limit: int) -> tuple[Index, Index]:
    """Return row numbers of all pairs of points within *radius* in the p-norm, sorted by (row of a, row of b)."""
    tree_a, tree_b = KDTree(a_xy), KDTree(b_xy)
    found = int(tree_a.count_neighbors(tree_b, radius, p=p))
    if found > limit:
        raise UnusableData(
            f"{found} pairs of {len(a_xy)} and {len(b_xy)} points lie within {radius:.1f} of one another, more than "
            f"{limit}: is the unit of the coordinates metres, and is the interval right?"
        )
    pairs = tree_a.sparse_distance_matrix(tree_b, radius, p=p, output_type="ndarray")
    order = np.lexsort((pairs["j"], pairs["i"]))
    return pairs["i"][order].astype(np.int64), pairs["j"][order].astype(np.int64)
