"""Probabilistic relaxation: labels gain where neighbours move alike and where both images agree.

Fuse & Shimizu, eq. 15-24, with these readings of what is printed: a vehicle does not support itself (j != i); all
consistent labels of a neighbour count; the no-match label keeps its value and then all labels are normalised; P and Q
are renewed from old values at once (Jacobi), so that swapping the images swaps P and Q.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.matching.candidates import Array, Edges, Index, pairs_within
from vtrack_batch.matching.params import RelaxationParams


@dataclass(frozen=True)
class Labels:
    """Label probabilities on the edges, seen from both images.

    ``p`` (e,) is P_i(λ_k) and ``q`` (e,) is Q_k(λ'_i) of the same edges; ``p_none`` (n,), ``q_none`` (m,) no match.
    """

    p: Array
    q: Array
    p_none: Array
    q_none: Array
    iterations: int = 0


@dataclass(frozen=True)
class Support:
    """Who supports whom: the edges ``by[start[e]:start[e + 1]]`` are consistent with edge e and near it."""

    start: Index
    by: NDArray[np.int32]


def relax(
    edges: Edges,
    labels: Labels,
    earlier_xy: Array,
    later_xy: Array,
    *,
    tolerance: float,
    params: RelaxationParams,
    two_way: bool = True,
) -> Labels:
    """Improve label probabilities by the support of neighbours and, if *two_way*, of the opposite labels.

    Points (n, 2), (m, 2) and *tolerance* (T of eq. 17) share one unit. One-way methods (a), (b) leave Q as it is.
    """
    from_p = support(edges.i, edges.displacement, earlier_xy, tolerance, params)
    from_q = support(edges.k, edges.displacement, later_xy, tolerance, params) if two_way else None
    p, q, p_none, q_none = labels.p, labels.q, labels.p_none, labels.q_none
    a, b, c = params.a_delay, params.b_neighbours, params.c_opposite if two_way else 0.0
    done, change = 0, np.inf
    while done < params.iterations and change >= params.stop_change:
        done += 1
        new_p = p * (a + b * _supported(from_p.start, from_p.by, p) + c * q)
        new_p, new_p_none = _normalised(new_p, p_none, edges.i)
        change = _largest_change(new_p, p)
        if from_q is not None:
            new_q = q * (a + b * _supported(from_q.start, from_q.by, q) + c * p)
            new_q, q_none = _normalised(new_q, q_none, edges.k)
            change = max(change, _largest_change(new_q, q))
            q = new_q
        p, p_none = new_p, new_p_none
    return Labels(p, q, p_none, q_none, done)


def support(owner: Index, displacement: Array, xy: Array, tolerance: float, params: RelaxationParams) -> Support:
    """Find, once, which edges support which: owners within R (eq. 18) and displacements within T (eq. 17)."""
    near_a, near_b = pairs_within(xy, xy, params.neighbourhood_m, p=2, limit=50_000_000) if len(xy) else (owner, owner)
    others = near_a != near_b
    near_a, near_b = near_a[others], near_b[others]
    near_start = np.searchsorted(near_a, np.arange(len(xy) + 1))
    # by owner and then by dx, so that the search along a neighbour's edges can stop early
    order = np.lexsort((displacement[:, 1], displacement[:, 0], owner))
    sorted_owner, d = owner[order], np.ascontiguousarray(displacement[order])
    first = np.searchsorted(sorted_owner, np.arange(len(xy) + 1))
    start = np.zeros(len(owner) + 1, np.int64)
    start[1:] = np.cumsum(_count(sorted_owner, d, first, near_start, near_b, tolerance))
    by = _fill(sorted_owner, d, first, near_start, near_b, tolerance, start)
    return _renumbered(order, Support(start, by))


def _renumbered(order: Index, found: Support) -> Support:
    """Give support found among the edges ``order`` the edges' own numbers back."""
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    counts = np.diff(found.start)[rank]
    start = np.zeros(len(order) + 1, np.int64)
    start[1:] = np.cumsum(counts)
    take = np.repeat(found.start[:-1][rank] - start[:-1], counts) + np.arange(start[-1])
    return Support(start, order[found.by[take]].astype(np.int32))


@njit(cache=True, nogil=True)
def _count(owner, d, first, near_start, near, tolerance):  # type: ignore[no-untyped-def]
    counts = np.zeros(len(owner), np.int64)
    for e in range(len(owner)):
        i = owner[e]
        for s in range(near_start[i], near_start[i + 1]):
            j = near[s]
            lo = first[j] + np.searchsorted(d[first[j] : first[j + 1], 0], d[e, 0] - tolerance)
            for f in range(lo, first[j + 1]):
                dx = d[f, 0] - d[e, 0]
                if dx > tolerance:
                    break
                dy = d[f, 1] - d[e, 1]
                if dx * dx + dy * dy <= tolerance * tolerance:
                    counts[e] += 1
    return counts


@njit(cache=True, nogil=True)
def _fill(owner, d, first, near_start, near, tolerance, start):  # type: ignore[no-untyped-def]
    by = np.empty(start[-1], np.int32)
    for e in range(len(owner)):
        i, at = owner[e], start[e]
        for s in range(near_start[i], near_start[i + 1]):
            j = near[s]
            lo = first[j] + np.searchsorted(d[first[j] : first[j + 1], 0], d[e, 0] - tolerance)
            for f in range(lo, first[j + 1]):
                dx = d[f, 0] - d[e, 0]
                if dx > tolerance:
                    break
                dy = d[f, 1] - d[e, 1]
                if dx * dx + dy * dy <= tolerance * tolerance:
                    by[at] = f
                    at += 1
    return by


@njit(cache=True, nogil=True)
def _supported(start, by, p):  # type: ignore[no-untyped-def]
    total = np.zeros(len(p))
    for e in range(len(p)):
        for s in range(start[e], start[e + 1]):
            total[e] += p[by[s]]
    return total


def _normalised(p: Array, none: Array, owner: Index) -> tuple[Array, Array]:
    """Scale the labels of every vehicle to sum 1 (eq. 19, 22); without candidates no match is certain."""
    total = np.bincount(owner, weights=p, minlength=len(none)) + none
    return p / total[owner], none / total


def _largest_change(new: Array, old: Array) -> float:
    return float(np.abs(new - old).max(initial=0.0))
