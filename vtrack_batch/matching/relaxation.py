"""Probabilistic relaxation: labels gain where neighbours move alike and where both images agree.

Fuse & Shimizu, eq. 15-24, with these readings of what is printed: a vehicle does not support itself (j != i); all
consistent labels of a neighbour count; the no-match label keeps its value and then all labels are normalised; P and Q
are renewed from old values at once (Jacobi), so that swapping the images swaps P and Q.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.candidates import Array, Edges, Index, pairs_within
from vtrack_batch.matching.params import RelaxationParams

LANES = 64  # settings of a sweep that are computed beside one another
DEAD = np.float32(1e-9)  # labels of a sweep below this no longer count
LEAST_SUM = np.float32(1e-37)  # labels that have all vanished stay nothing, whatever they are scaled by
MOST_SUPPORT = 250_000_000


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


class Support(NamedTuple):
    """Who supports whom: the edges ``by[start[e]:start[e + 1]]`` are consistent with edge e and near it.

    A named tuple, because compiled code reads it.
    """

    start: Index
    by: NDArray[np.uint32]


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
    nobody = Support(np.zeros(len(edges) + 1, np.int64), np.zeros(0, np.uint32))
    from_p = support(edges.i, edges.displacement, earlier_xy, tolerance, params)
    from_q = support(edges.k, edges.displacement, later_xy, tolerance, params) if two_way else nobody
    limits = np.array([params.iterations, params.stop_change])
    weights = np.array([params.a_delay, params.b_neighbours, params.c_opposite if two_way else 0.0])
    given = (labels.p.copy(), labels.q.copy(), labels.p_none.copy(), labels.q_none.copy())
    done = _relaxed(edges.i, edges.k, from_p, from_q, *given, weights, limits, two_way)
    return Labels(*given, done)


def sweep(
    edges: Edges,
    labels: Labels,
    earlier_xy: Array,
    later_xy: Array,
    *,
    settings: Array,
    tolerance: float,
    params: RelaxationParams,
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Relax two-way by many *settings* (s, 3) of A, B, C at once; all else as ``relax``, of which it is the fast form.

    Returns the best labels of the earlier vehicles (s, n) and of the later ones (s, m): row of the partner, -1 = no
    match, ties with which go to it. Single precision: labels closer than 1e-6 may fall the other way.
    """
    from_p = support(edges.i, edges.displacement, earlier_xy, tolerance, params)
    from_q = support(edges.k, edges.displacement, later_xy, tolerance, params)
    start = [np.asarray(part, np.float32) for part in (labels.p, labels.q, labels.p_none, labels.q_none)]
    limits = np.array([params.iterations, params.stop_change])
    best_i = np.full((len(settings), edges.n), -1, np.int32)
    best_k = np.full((len(settings), edges.m), -1, np.int32)
    for at in range(0, len(settings), LANES):
        some = np.asarray(settings[at : at + LANES], np.float32)
        weights = np.zeros((3, LANES), np.float32)
        weights[:, : len(some)] = some.T
        weights[0, len(some) :] = 1.0
        p, q, p_none, q_none = (np.repeat(part[:, None], LANES, axis=1) for part in start)
        _relaxed_side_by_side(edges.i, edges.k, from_p, from_q, p, q, p_none, q_none, weights, limits)
        best_i[at : at + LANES] = _best_labels(p, p_none, edges.i, edges.k)[: len(some)]
        best_k[at : at + LANES] = _best_labels(q, q_none, edges.k, edges.i)[: len(some)]
    return best_i, best_k


def paper_grid() -> Array:
    """Return the settings of A, B, C that the paper tries (section 4.2.1): (28611, 3), A by 0.1, B and C by 0.2."""
    a, b, c = np.meshgrid(np.arange(11) / 10, np.arange(51) / 5, np.arange(51) / 5, indexing="ij")
    return np.column_stack([a.ravel(), b.ravel(), c.ravel()])


def support(owner: Index, displacement: Array, xy: Array, tolerance: float, params: RelaxationParams) -> Support:
    """Find, once, which edges support which: owners within R (eq. 18) and displacements within T (eq. 17)."""
    near_a, near_b = pairs_within(xy, xy, params.neighbourhood_m, p=2, limit=50_000_000) if len(xy) else (owner, owner)
    once = near_a < near_b  # support is mutual: every pair of owners is looked at once
    near = near_a[once], near_b[once]
    order, first = by_displacement(owner, displacement[:, 0], len(xy))
    d = np.ascontiguousarray(displacement[order])
    pairs, used, looked = np.empty((8 * len(owner) + 1024, 2), np.uint32), 0, 0
    while looked < len(near[0]):
        if len(pairs) > MOST_SUPPORT:
            raise UnusableData(
                f"more than {MOST_SUPPORT} pairs of possible links support one another among {len(xy)} vehicles: is "
                "the unit of the coordinates metres, and is the interval right?"
            )
        used, looked = _consistent(order, d, first, *near, tolerance, pairs, used, looked)
        if looked < len(near[0]):
            pairs = np.concatenate([pairs, np.empty_like(pairs)])
    return Support(*_both_ways(pairs[:used], len(owner)))


@njit(cache=True, nogil=True)
def by_displacement(owner, dx, size):  # type: ignore[no-untyped-def]
    """Return the edges by owner and then by *dx*, and the first of each of the *size* owners (size + 1,)."""
    first = np.zeros(size + 1, np.int64)
    for e in range(len(owner)):
        first[owner[e] + 1] += 1
    first = np.cumsum(first)
    order, end = np.empty(len(owner), np.int64), first[:-1].copy()
    for e in range(len(owner)):
        at = end[owner[e]]
        end[owner[e]] += 1
        while at > first[owner[e]] and dx[order[at - 1]] > dx[e]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = e
    return order, first


@njit(cache=True, nogil=True)
def _consistent(order, d, first, near_a, near_b, tolerance, pairs, used, looked):  # type: ignore[no-untyped-def]
    """Write every two edges of near owners that agree (eq. 17) into *pairs*, once each, from row *used* on.

    Begins at the near owners numbered *looked* and stops where room may be short; returns both numbers.
    """
    for near in range(looked, len(near_a)):
        i, j = near_a[near], near_b[near]
        lo, last = first[j], first[j + 1]
        if used + (first[i + 1] - first[i]) * (last - lo) > len(pairs):
            return used, near
        for e in range(first[i], first[i + 1]):
            while lo < last and d[lo, 0] < d[e, 0] - tolerance:
                lo += 1
            for f in range(lo, last):
                dx, dy = d[f, 0] - d[e, 0], d[f, 1] - d[e, 1]
                if dx > tolerance:
                    break
                if dx * dx + dy * dy <= tolerance * tolerance:
                    pairs[used, 0], pairs[used, 1] = order[e], order[f]
                    used += 1
    return used, len(near_a)


@njit(cache=True, nogil=True)
def _both_ways(pairs, size):  # type: ignore[no-untyped-def]
    """Turn a list of pairs (s, 2) into rows: start (size + 1,) and the partners of each."""
    start = np.zeros(size + 1, np.int64)
    for s in range(len(pairs)):
        start[pairs[s, 0] + 1] += 1
        start[pairs[s, 1] + 1] += 1
    start = np.cumsum(start)
    by, at = np.empty(2 * len(pairs), np.uint32), start[:-1].copy()
    for s in range(len(pairs)):
        e, f = pairs[s]
        by[at[e]], by[at[f]] = f, e
        at[e] += 1
        at[f] += 1
    return start, by


@njit(cache=True, nogil=True)
def _relaxed(i, k, from_p, from_q, p, q, p_none, q_none, weights, limits, two_way):  # type: ignore[no-untyped-def]
    """Iterate eq. 19-24 in place until nothing changes much; returns the number of rounds."""
    new_p, new_q = np.empty_like(p), np.empty_like(q)
    done, change = 0, np.inf
    while done < limits[0] and change >= limits[1]:
        done += 1
        _improved(from_p, p, q, weights, new_p)
        if two_way:
            _improved(from_q, q, p, weights, new_q)
        change = _normalise(i, new_p, p, p_none)
        if two_way:
            change = max(change, _normalise(k, new_q, q, q_none))
    return done


@njit(cache=True, nogil=True)
def _improved(support, own, opposite, weights, out):  # type: ignore[no-untyped-def]
    a, b, c = weights
    for e in range(len(own)):
        total = 0.0
        for s in range(support.start[e], support.start[e + 1]):
            total += own[support.by[s]]
        out[e] = own[e] * (a + b * total + c * opposite[e])


@njit(cache=True, nogil=True)
def _normalise(owner, new, own, none):  # type: ignore[no-untyped-def]
    """Scale the labels of every vehicle to sum 1 (eq. 19, 22) into *own*; returns the largest change."""
    total = np.zeros(len(none))
    for e in range(len(own)):
        total[owner[e]] += new[e]
    total += none
    total = np.maximum(total, LEAST_SUM)
    change = 0.0
    for e in range(len(own)):
        value = new[e] / total[owner[e]]
        change = max(change, abs(value - own[e]))
        own[e] = value
    none /= total
    return change


@njit(cache=True, nogil=True)
def _relaxed_side_by_side(i, k, from_p, from_q, p, q, p_none, q_none, weights, limits):  # type: ignore[no-untyped-def]
    """Iterate eq. 19-24 in place for ``LANES`` settings beside one another; a lane that is steady stays as it is."""
    new_p, new_q = np.empty_like(p), np.empty_like(q)
    total_i, total_k = np.empty_like(p_none), np.empty_like(q_none)
    moving, change = np.ones(LANES, np.float32), np.empty(LANES, np.float32)
    alive_p, alive_q = np.ones(len(p), np.bool_), np.ones(len(q), np.bool_)
    for _ in range(int(limits[0])):
        _improve_lanes(from_p, p, q, weights, alive_p, new_p)
        _improve_lanes(from_q, q, p, weights, alive_q, new_q)
        change[:] = 0
        _normalise_lanes(i, new_p, p, p_none, total_i, moving, change, alive_p)
        _normalise_lanes(k, new_q, q, q_none, total_k, moving, change, alive_q)
        going = False
        for w in range(LANES):
            if change[w] < limits[1]:
                moving[w] = 0
            going = going or moving[w] > 0
        if not going:
            break


@njit(cache=True, nogil=True)
def _improve_lanes(support, own, opposite, weights, alive, out):  # type: ignore[no-untyped-def]
    total = np.empty(LANES, np.float32)
    for e in range(len(own)):
        if not alive[e]:
            continue
        for w in range(LANES):
            total[w] = 0
        for s in range(support.start[e], support.start[e + 1]):
            f = support.by[s]
            if alive[f]:
                for w in range(LANES):
                    total[w] += own[f, w]
        for w in range(LANES):
            out[e, w] = own[e, w] * (weights[0, w] + weights[1, w] * total[w] + weights[2, w] * opposite[e, w])


@njit(cache=True, nogil=True)
def _normalise_lanes(owner, new, own, none, total, moving, change, alive):  # type: ignore[no-untyped-def]
    """Scale labels to sum 1 into *own*; a label that has become ``DEAD`` in all lanes is given up."""
    total[:] = none
    for e in range(len(own)):
        if alive[e]:
            for w in range(LANES):
                total[owner[e], w] += new[e, w]
    for v in range(len(none)):
        for w in range(LANES):
            total[v, w] = np.float32(1) / max(total[v, w], LEAST_SUM)
            none[v, w] *= moving[w] * total[v, w] + (np.float32(1) - moving[w])
    for e in range(len(own)):
        if alive[e]:
            top = np.float32(0)
            for w in range(LANES):
                step = (new[e, w] * total[owner[e], w] - own[e, w]) * moving[w]
                own[e, w] += step
                step = abs(step)
                change[w] = step if step > change[w] else change[w]
            for w in range(LANES):
                top = own[e, w] if own[e, w] > top else top
            alive[e] = top > DEAD


@njit(cache=True, nogil=True)
def _best_labels(p, none, owner, partner):  # type: ignore[no-untyped-def]
    best = np.full((LANES, len(none)), -1, np.int32)
    top = none.copy()
    for e in range(len(p)):
        for w in range(LANES):
            if p[e, w] > top[owner[e], w]:
                top[owner[e], w] = p[e, w]
                best[w, owner[e]] = partner[e]
    return best
