"""Matching without training: Bayes' rule with the neighbours' motion as prior, solved by repeated substitution.

The relaxation of Fuse & Shimizu multiplies support into the labels round after round, so that colour is soon forgotten
and groups of vehicles can jump together. Here the evidence stays what it is and the neighbours only say which
displacements are to be expected:

    odds_e = evidence_e · f_e,    f_e = (κ · prior(d_e) + Σ w_ee' p_e') / (κ + Σ_j w_ij)

with a Gaussian w over the difference of displacements and over the place of the neighbour, wide along the motion and
narrow across it: vehicles of the same stream count, those beside it hardly. p_e are the odds against all rivals of an
edge on both sides. Fixed point in a few rounds; swapping the images swaps the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.candidates import Array, Edges, Index
from vtrack_batch.matching.params import NeighbourParams
from vtrack_batch.matching.relaxation import Labels

STILL_M = 2.0  # displacements below this have no direction: neighbours all around count alike
MOST_VOTES = 150_000_000
MOST_NEAR = 100_000_000
MOST_SQUARES = 64  # into which displacements are sorted along either axis
CUT = 3.0  # kernels end at this many standard deviations


@dataclass(frozen=True)
class Votes:
    """Sparse votes: edge e hears ``by[start[e]:start[e + 1]]`` with ``weight`` (1/m2); ``voters[e]`` is Σ_j w_ij."""

    start: Index
    by: NDArray[np.int32]
    weight: NDArray[np.float32]
    voters: Array


@dataclass(frozen=True)
class Neighbours:
    """The votes of neighbours in the earlier and in the later image: geometry only, found once."""

    earlier: Votes
    later: Votes


def neighbours_of(
    edges: Edges, earlier_xy: Array, later_xy: Array, *, elapsed_s: float, params: NeighbourParams
) -> Neighbours:
    """Find who has a say in which edge; points are (n, 2) and (m, 2) metres."""
    spread = params.spread_m(elapsed_s)
    return Neighbours(
        find_votes(edges.i, edges.displacement, earlier_xy, spread, params),
        find_votes(edges.k, edges.displacement, later_xy, spread, params),
    )


def match_by_neighbours(
    edges: Edges, neighbours: Neighbours, log_evidence: Array, prior: Array, params: NeighbourParams
) -> tuple[Labels, Array]:
    """Return label probabilities and log-odds (e,) of the edges.

    *log_evidence* (e,) is the log-likelihood ratio of everything but motion, per density of vehicles (m2); *prior* (e,)
    the density (1/m2) of each displacement before neighbours are asked.
    """
    a, b = neighbours.earlier, neighbours.later
    voters = params.prior_weight + 0.5 * (a.voters + b.voters)
    expected = prior
    for _ in range(params.rounds):
        p = _against_rivals(edges, log_evidence + np.log(expected))
        heard = _heard(a.start, a.by, a.weight, p) + _heard(b.start, b.by, b.weight, p)
        expected = (params.prior_weight * prior + 0.5 * heard) / voters
    log_odds = log_evidence + np.log(expected)
    return labels_from(edges, log_odds), np.asarray(log_odds)


def labels_from(edges: Edges, log_odds: Array) -> Labels:
    """Turn log-odds (e,) of edges against no match into label probabilities of both images."""
    odds = np.exp(np.clip(log_odds, -30, 30))
    sum_i = 1 + np.bincount(edges.i, weights=odds, minlength=edges.n)
    sum_k = 1 + np.bincount(edges.k, weights=odds, minlength=edges.m)
    return Labels(odds / sum_i[edges.i], odds / sum_k[edges.k], 1 / sum_i, 1 / sum_k)


def _against_rivals(edges: Edges, log_odds: Array) -> Array:
    """Return the probability of every edge against no match and all rivals at both of its ends."""
    odds = np.exp(np.clip(log_odds, -30, 30))
    sum_i = np.bincount(edges.i, weights=odds, minlength=edges.n)
    sum_k = np.bincount(edges.k, weights=odds, minlength=edges.m)
    return np.asarray(odds / (1 + sum_i[edges.i] + np.maximum(sum_k[edges.k] - odds, 0)))


def find_votes(owner: Index, displacement: Array, xy: Array, spread: float, params: NeighbourParams) -> Votes:
    """Find which edges speak for which: those of owners in the same stream, with nearly the same displacement."""
    if not len(owner):
        return Votes(np.zeros(1, np.int64), np.zeros(0, np.int32), np.zeros(0, np.float32), np.zeros(0))
    cells = _cells(owner, displacement, xy, CUT * params.along_m, CUT * spread)
    scale = np.array([spread, params.along_m, params.across_m])
    start, voters = np.zeros(len(owner) + 1, np.int64), np.zeros(len(owner))
    by, weight = np.empty(24 * len(owner), np.int32), np.empty(24 * len(owner), np.float32)
    done = 0
    while done < len(owner):
        if len(by) > MOST_VOTES:
            raise UnusableData(
                f"more than {MOST_VOTES} pairs of possible links speak for one another among {len(xy)} vehicles: is "
                "the unit of the coordinates metres, and is the interval right?"
            )
        done, room = _votes(owner, displacement, xy, cells, scale, start, by, weight, voters, done)
        if done < len(owner):
            room = max(len(by), room)
            by, weight = (np.concatenate([a, np.empty(room, a.dtype)]) for a in (by, weight))
    return Votes(start, by[: start[-1]], weight[: start[-1]], voters)


class _Cells(NamedTuple):
    """Owners by place, and edges by place and displacement (a named tuple, because compiled code reads it).

    Places are squares as wide as half the farthest that a neighbour is heard: ``cell`` (n,) of each owner, ``centre``
    (c, 2), ``around`` (c, 25) the square itself and those about it, or -1; ``owner_xy`` of cell c are the rows from
    ``first_owner[c]`` on. Displacements are sorted into ``side`` x ``side`` squares half as wide as they may differ,
    ``square`` (e, 2) that of each edge. Edges of cell c in square q are the rows of ``edge`` from
    ``first[c * side² + q]`` on, and in the same order ``what`` (e, 5): displacement, place and owner.
    """

    cell: Index
    centre: Array
    half_m: float
    around: Index
    owner_xy: Array
    first_owner: Index
    side: int
    square: Index
    edge: Index
    what: Array
    first: NDArray[np.int32]


def _cells(owner: Index, displacement: Array, xy: Array, near_m: float, alike_m: float) -> _Cells:
    """Sort owners by place and their edges by displacement, which may be *near_m* and *alike_m* from one another.

    Only places where somebody is are cells, so that distance costs nothing.
    """
    origin, size = xy.min(axis=0), near_m / 2
    place = np.floor((xy - origin) / size).astype(np.int64) + 2
    width = int(place[:, 0].max()) + 3
    key, one, cell = np.unique(place[:, 1] * width + place[:, 0], return_index=True, return_inverse=True)
    steps = np.arange(-2, 3)
    beside = key[:, None] + (width * steps[:, None] + steps).ravel()
    at = np.minimum(np.searchsorted(key, beside), len(key) - 1)
    around = np.where(key[at] == beside, at, -1)
    owners = np.argsort(cell, kind="stable")
    first_owner = np.searchsorted(cell[owners], np.arange(len(key) + 1))
    crowd = np.append(np.diff(first_owner), 0)
    near = int((crowd[:-1, None] * crowd[around]).sum())
    if near > MOST_NEAR:
        raise UnusableData(
            f"some {near} pairs of {len(xy)} and {len(xy)} vehicles of one image are within {2 * size:.0f} m, more "
            f"than {MOST_NEAR}: is the unit of the coordinates metres?"
        )
    low, high = displacement.min(axis=0), displacement.max(axis=0)
    square_m = max(alike_m / 2, float((high - low).max()) / MOST_SQUARES)
    square = np.floor((displacement - low) / square_m).astype(np.int64) + 2
    side = int(square.max()) + 3
    code = (cell[owner] * side + square[:, 0]) * side + square[:, 1]
    edge = np.argsort(code, kind="stable")
    first = np.zeros(len(key) * side * side + 1, np.int32)
    np.cumsum(np.bincount(code, minlength=len(first) - 1), out=first[1:])
    centre = origin + (place[one] - 1.5) * size
    what = np.column_stack([displacement, xy[owner], owner])[edge]
    return _Cells(cell, centre, size / 2, around, xy[owners], first_owner, side, square, edge, what, first)


@njit(cache=True, nogil=True)
def _votes(owner, d, xy, cells, scale, start, by, weight, voters, done):  # type: ignore[no-untyped-def]
    """Write the votes for the edges from number *done* on.

    Returns the first for which room may be short, and the room that it needs.
    """
    spread, along, across = scale
    near, low, high = np.empty(25, np.int64), np.empty(125, np.int64), np.empty(125, np.int64)
    peak, narrow = 1 / (2 * np.pi * spread**2), 1 / spread**2
    at = start[done]
    for e in range(done, len(owner)):
        i = owner[e]
        x, y, dx, dy = xy[i, 0], xy[i, 1], d[e, 0], d[e, 1]
        length = np.hypot(dx, dy)
        still = length <= STILL_M
        # who stands has neighbours all around, as far as along a motion
        ux, uy = (1.0, 0.0) if still else (dx / length, dy / length)
        far_u, far_v = along, (along if still else across)
        cells_near = _cells_near(cells, cells.cell[i], x, y, ux, uy, far_u, far_v, near)
        ranges, room = _ranges(cells, near[:cells_near], cells.square[e], low, high)
        if at + room > len(by):
            return e, room
        per_u, per_v, total = 1 / far_u, 1 / far_v, -1.0  # less the owner itself
        for c in near[:cells_near]:
            for s in range(cells.first_owner[c], cells.first_owner[c + 1]):
                rx, ry = cells.owner_xy[s, 0] - x, cells.owner_xy[s, 1] - y
                u, v = (rx * ux + ry * uy) * per_u, (rx * uy - ry * ux) * per_v
                z = u * u + v * v
                if z <= CUT * CUT:
                    total += np.exp(-0.5 * z)
        voters[e] = total
        for r in range(ranges):
            for s in range(low[r], high[r]):
                ox, oy = cells.what[s, 0] - dx, cells.what[s, 1] - dy
                rx, ry = cells.what[s, 2] - x, cells.what[s, 3] - y
                u, v = (rx * ux + ry * uy) * per_u, (rx * uy - ry * ux) * per_v
                q, z = (ox * ox + oy * oy) * narrow, u * u + v * v
                if max(q, z) <= CUT * CUT and cells.what[s, 4] != i:
                    by[at], weight[at] = cells.edge[s], peak * np.exp(-0.5 * (z + q))
                    at += 1
        start[e + 1] = at
    return len(owner), 0


@njit(cache=True, nogil=True)
def _cells_near(cells, c, x, y, ux, uy, far_u, far_v, near):  # type: ignore[no-untyped-def]
    """Write the cells about *c* that reach into the ellipse around (x, y) along (ux, uy); returns how many."""
    count, half = 0, cells.half_m * (abs(ux) + abs(uy))
    for b in range(25):
        beside = cells.around[c, b]
        if beside >= 0:
            rx, ry = cells.centre[beside, 0] - x, cells.centre[beside, 1] - y
            if abs(rx * ux + ry * uy) <= CUT * far_u + half and abs(rx * uy - ry * ux) <= CUT * far_v + half:
                near[count] = beside
                count += 1
    return count


@njit(cache=True, nogil=True)
def _ranges(cells, near, square, low, high):  # type: ignore[no-untyped-def]
    """Write where the edges of the cells *near* lie that may be like one in *square*; returns ranges and edges."""
    count, total = 0, 0
    for c in near:
        for row in range(-2, 3):
            middle = (c * cells.side + square[0] + row) * cells.side + square[1]
            low[count], high[count] = cells.first[middle - 2], cells.first[middle + 3]
            if high[count] > low[count]:
                total += high[count] - low[count]
                count += 1
    return count, total


@njit(cache=True, nogil=True)
def _heard(start, by, weight, p):  # type: ignore[no-untyped-def]
    total = np.zeros(len(p))
    for e in range(len(p)):
        for s in range(start[e], start[e + 1]):
            total[e] += weight[s] * p[by[s]]
    return total
