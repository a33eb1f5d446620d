"""Which vehicles of the later image can be which of the earlier one: a sparse list of edges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
    """Return row numbers of all pairs of points within *radius* in the 2- or the infinity-norm, sorted by both."""
    if not (len(a_xy) and len(b_xy)):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    given = (np.ascontiguousarray(a_xy, float), in_bands(b_xy, radius), radius, p == np.inf)
    nothing = np.zeros(0, np.int64)
    count = _near(*given, nothing, nothing)
    if int(count.sum()) > limit:
        raise UnusableData(
            f"{count.sum()} pairs of {len(a_xy)} and {len(b_xy)} points lie within {radius:.1f} of one another, more "
            f"than {limit}: is the unit of the coordinates metres, and is the interval right?"
        )
    near = np.empty(int(count.sum()), np.int64)
    _near(*given, np.cumsum(count) - count, near)
    return np.repeat(np.arange(len(a_xy)), count), near


class Bands(NamedTuple):
    """Points in horizontal bands as high as a radius, by x in each (a named tuple, because compiled code reads it).

    ``order`` (m,) are their rows, ``xy`` (m, 2) and ``band`` (m,) sorted by it; ``origin`` is y and height of band 0.
    """

    order: Index
    xy: Array
    band: Index
    origin: Array


def in_bands(xy: Array, radius: float) -> Bands:
    """Sort points (m, 2), m > 0, so that those within *radius* of a place are found in three bands."""
    low, side = xy[:, 1].min(), max(radius, 1e-9)
    band = np.floor((xy[:, 1] - low) / side).astype(np.int64)
    order = np.lexsort((xy[:, 0], band))
    return Bands(order, np.ascontiguousarray(xy[order]), band[order], np.array([low, side]))


@njit(cache=True, nogil=True)
def span_from(bands, band, low_x):  # type: ignore[no-untyped-def]
    """First point of *band* that is not left of *low_x*."""
    lo, hi = 0, len(bands.band)
    while lo < hi:
        middle = (lo + hi) // 2
        if bands.band[middle] < band or (bands.band[middle] == band and bands.xy[middle, 0] < low_x):
            lo = middle + 1
        else:
            hi = middle
    return lo


@njit(cache=True, nogil=True)
def others_near(i, xy, bands, other, rx, ry):  # type: ignore[no-untyped-def]
    """Write which points but *i* are within the radius of the *bands* of all of *xy*, and where from *i*.

    Returns how many there are; *other*, *rx* and *ry* have room for all.
    """
    count, far = 0, bands.origin[1]
    middle = int(np.floor((xy[i, 1] - bands.origin[0]) / far))
    for band in range(middle - 1, middle + 2):
        for s in range(span_from(bands, band, xy[i, 0] - far), len(bands.band)):
            x, y = bands.xy[s, 0] - xy[i, 0], bands.xy[s, 1] - xy[i, 1]
            if bands.band[s] != band or x > far:
                break
            if x * x + y * y <= far * far and bands.order[s] != i:
                other[count], rx[count], ry[count] = bands.order[s], x, y
                count += 1
    return count


@njit(cache=True, nogil=True)
def bell(z):  # type: ignore[no-untyped-def]
    """exp(-z / 2) for 0 <= z <= 50, as (exp(-z / 2048))^1024: nothing but products, which go side by side."""
    u = z / 2048
    y = 1 - u * (1 - u * (1 / 2 - u * (1 / 6 - u / 24)))
    for _ in range(10):
        y *= y
    return y


@njit(cache=True, nogil=True)
def _near(a, bands, radius, box, start, near):  # type: ignore[no-untyped-def]
    """Count the points near each of *a*; write their rows into *near* from ``start[i]`` on, unless it is empty."""
    count = np.zeros(len(a), np.int64)
    for i in range(len(a)):
        middle = int(np.floor((a[i, 1] - bands.origin[0]) / bands.origin[1]))
        for band in range(middle - 1, middle + 2):
            for s in range(span_from(bands, band, a[i, 0] - radius), len(bands.band)):
                dx, dy = bands.xy[s, 0] - a[i, 0], bands.xy[s, 1] - a[i, 1]
                if bands.band[s] != band or dx > radius:
                    break
                if abs(dx) <= radius and abs(dy) <= radius and (box or dx * dx + dy * dy <= radius * radius):
                    if len(near):
                        near[start[i] + count[i]] = bands.order[s]
                    count[i] += 1
        if len(near):
            near[start[i] : start[i] + count[i]].sort()
    return count
