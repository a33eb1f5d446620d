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

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.candidates import Array, Edges, Index, pairs_within
from vtrack_batch.matching.params import NeighbourParams
from vtrack_batch.matching.relaxation import Labels, by_displacement

STILL_M = 2.0  # displacements below this have no direction: neighbours all around count alike
MOST_VOTES = 150_000_000
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
    a, b = pairs_within(xy, xy, CUT * params.along_m, p=2, limit=50_000_000)
    a, b = a[a != b], b[a != b]
    near = np.searchsorted(a, np.arange(len(xy) + 1)), b
    order, first = by_displacement(owner, displacement[:, 0], len(xy))
    by_owner, d = owner[order], np.ascontiguousarray(displacement[order])
    reached = np.concatenate([[0], np.cumsum(np.diff(first)[b])])  # edges of near owners: the most that may vote
    most = np.diff(reached[near[0]])
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
        done = _votes(by_owner, d, first, *near, most, xy, scale, start, by, weight, voters, done)
        if done < len(owner):
            room = max(len(by), int(most[by_owner[done]]))
            by, weight = (np.concatenate([a, np.empty(room, a.dtype)]) for a in (by, weight))
    return _renumbered(order, Votes(start, by[: start[-1]], weight[: start[-1]], voters))


@njit(cache=True, nogil=True)
def _votes(owner, d, first, near_start, near, most, xy, scale, start, by, weight, voters, done):  # type: ignore[no-untyped-def]
    """Write the votes for the edges from number *done* on; returns the first for which room may be short."""
    spread, along, across = scale
    at = start[done]
    for e in range(done, len(owner)):
        i = owner[e]
        if at + most[i] > len(by):
            return e
        length = np.hypot(d[e, 0], d[e, 1])
        still = length <= STILL_M
        ux, uy = (0.0, 0.0) if still else (d[e, 0] / length, d[e, 1] / length)
        for s in range(near_start[i], near_start[i + 1]):
            j = near[s]
            rx, ry = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
            u, v = rx * ux + ry * uy, rx * uy - ry * ux
            z = (rx * rx + ry * ry) / along**2 if still else (u / along) ** 2 + (v / across) ** 2
            if z > CUT * CUT:
                continue
            place = np.exp(-0.5 * z)
            voters[e] += place
            lo, hi = first[j], first[j + 1]
            while lo < hi:  # the first edge of j whose dx is near enough
                middle = (lo + hi) // 2
                if d[middle, 0] < d[e, 0] - CUT * spread:
                    lo = middle + 1
                else:
                    hi = middle
            for f in range(lo, first[j + 1]):
                dx, dy = d[f, 0] - d[e, 0], d[f, 1] - d[e, 1]
                if dx > CUT * spread:
                    break
                q = (dx * dx + dy * dy) / spread**2
                if q > CUT * CUT:
                    continue
                by[at] = f
                weight[at] = place * np.exp(-0.5 * q) / (2 * np.pi * spread**2)
                at += 1
        start[e + 1] = at
    return len(owner)


def _renumbered(order: Index, votes: Votes) -> Votes:
    """Give votes found among the edges ``order`` the edges' own numbers back."""
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    counts = np.diff(votes.start)[rank]
    start = np.concatenate([[0], np.cumsum(counts)])
    take = np.repeat(votes.start[:-1][rank] - start[:-1], counts) + np.arange(start[-1])
    return Votes(start, order[votes.by[take]].astype(np.int32), votes.weight[take], votes.voters[rank])


@njit(cache=True, nogil=True)
def _heard(start, by, weight, p):  # type: ignore[no-untyped-def]
    total = np.zeros(len(p))
    for e in range(len(p)):
        for s in range(start[e], start[e + 1]):
            total[e] += weight[s] * p[by[s]]
    return total
