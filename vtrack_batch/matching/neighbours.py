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
from vtrack_batch.matching.bits import lowest
from vtrack_batch.matching.candidates import Array, Edges, Index, bell, in_bands, others_near
from vtrack_batch.matching.params import NeighbourParams
from vtrack_batch.matching.relaxation import Labels, by_displacement

STILL_M = 2.0  # displacements below this have no direction: neighbours all around count alike
MOST_VOTES = 150_000_000
MOST_NEAR = 50_000_000
CUT = 3.0  # kernels end at this many standard deviations
MOST_BINS = 64  # of displacements along an axis: wider ones where these do not reach, so that tables stay small
LEAST_ODDS, MOST_ODDS = np.exp(-30.0), np.exp(30.0)


class Votes(NamedTuple):
    """Sparse votes: edge e hears ``by[start[e]:stop[e]]`` with ``weight`` (1/m2); ``voters[e]`` is Σ_j w_ij.

    A named tuple, because compiled code reads it.
    """

    start: Index
    stop: Index
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
    given = edges.i, edges.k, edges.n, edges.m, neighbours.earlier, neighbours.later
    expected = _substituted(*given, np.exp(log_evidence), prior, params.prior_weight, params.rounds)
    log_odds = log_evidence + np.log(expected)
    return labels_from(edges, log_odds), np.asarray(log_odds)


def labels_from(edges: Edges, log_odds: Array) -> Labels:
    """Turn log-odds (e,) of edges against no match into label probabilities of both images."""
    odds = np.exp(np.clip(log_odds, -30, 30))
    sum_i = 1 + np.bincount(edges.i, weights=odds, minlength=edges.n)
    sum_k = 1 + np.bincount(edges.k, weights=odds, minlength=edges.m)
    return Labels(odds / sum_i[edges.i], odds / sum_k[edges.k], 1 / sum_i, 1 / sum_k)


@njit(cache=True, nogil=True)
def _substituted(i, k, n, m, earlier, later, evidence, prior, prior_weight, rounds):  # type: ignore[no-untyped-def]
    """Return the densities (e,) of displacements that neighbours expect, after so many rounds of asking them."""
    expected, p = prior.copy(), np.empty(len(prior))
    for _ in range(rounds):
        sum_i, sum_k = np.zeros(n), np.zeros(m)
        for e in range(len(p)):
            p[e] = min(max(evidence[e] * expected[e], LEAST_ODDS), MOST_ODDS)
            sum_i[i[e]] += p[e]
            sum_k[k[e]] += p[e]
        for e in range(len(p)):  # against no match and all rivals at both ends
            p[e] /= 1 + sum_i[i[e]] + max(sum_k[k[e]] - p[e], 0.0)
        for e in range(len(p)):
            heard = 0.0
            for s in range(earlier.start[e], earlier.stop[e]):
                heard += earlier.weight[s] * p[earlier.by[s]]
            for s in range(later.start[e], later.stop[e]):
                heard += later.weight[s] * p[later.by[s]]
            voters = prior_weight + 0.5 * (earlier.voters[e] + later.voters[e])
            expected[e] = (prior_weight * prior[e] + 0.5 * heard) / voters
    return expected


def find_votes(owner: Index, displacement: Array, xy: Array, spread: float, params: NeighbourParams) -> Votes:
    """Find which edges speak for which: those of owners in the same stream, with nearly the same displacement."""
    size = len(owner)
    start, stop, voters = np.zeros(size, np.int64), np.zeros(size, np.int64), np.zeros(size)
    by, weight = np.empty(24 * size, np.int32), np.empty(24 * size, np.float32)
    if not size:
        return Votes(start, stop, by, weight, voters)
    bands = in_bands(xy, CUT * max(params.along_m, params.across_m))
    if len(xy) ** 2 > MOST_NEAR and _crowded(xy, bands, MOST_NEAR):
        raise UnusableData(
            f"more than {MOST_NEAR} pairs of {len(xy)} and {len(xy)} vehicles of one image are within "
            f"{bands.origin[1]:.0f} m: is the unit of the coordinates metres?"
        )
    order, first = by_displacement(owner, displacement[:, 0], len(xy))
    sorted_d, scale = np.ascontiguousarray(displacement[order]), np.array([spread, params.along_m, params.across_m])
    windows = _windows(owner[order], sorted_d, first, CUT * spread)
    given = order, owner[order], sorted_d, first, windows, np.ascontiguousarray(xy), bands, scale
    done = used = 0
    while done < size:
        if len(by) > MOST_VOTES:
            raise UnusableData(
                f"more than {MOST_VOTES} pairs of possible links speak for one another among {len(xy)} vehicles: is "
                "the unit of the coordinates metres, and is the interval right?"
            )
        done, used, room = _votes(*given, start, stop, by, weight, voters, done, used)
        if done < size:
            room = max(len(by), room)
            by, weight = (np.concatenate([a, np.empty(room, a.dtype)]) for a in (by, weight))
    return Votes(start, stop, by[:used], weight[:used], voters)


@njit(cache=True, nogil=True)
def _crowded(xy, bands, most):  # type: ignore[no-untyped-def]
    """Tell whether more than *most* pairs are near one another."""
    other, rx, ry, count = np.empty(len(xy), np.int64), np.empty(len(xy)), np.empty(len(xy)), 0
    for i in range(len(xy)):
        count += others_near(i, xy, bands, other, rx, ry)
        if count > most:
            return True
    return False


class Windows(NamedTuple):
    """Which edges of a vehicle go about as far as another edge: sets of bits, 32 edges of one owner to the word.

    An edge falls into the bins ``bin_x`` and ``bin_y`` (e,); the bits of ``x[bin, word]`` are the edges in this bin
    of x or in one beside it. The words of owner j begin at ``word[j]``, one at least; ``first`` (w,) is the first edge
    of each, and ``leads`` (w,) is 1 for an owner's first word, 0 for its others.
    """

    word: Index
    first: Index
    leads: Array
    bin_x: NDArray[np.int32]
    bin_y: NDArray[np.int32]
    x: NDArray[np.uint32]
    y: NDArray[np.uint32]


@njit(cache=True, nogil=True)
def _votes(order, owner, d, first, windows, xy, bands, scale, start, stop, by, weight, voters, done, at):  # type: ignore[no-untyped-def]
    """Write the votes for the edges, by owner and then by displacement, from number *done* on and to row *at* on.

    Returns the first for which room may be short, the rows written, and the room that it needs.
    """
    spread, along, across = scale
    peak, narrow = 1 / (2 * np.pi * spread**2), 1 / spread**2
    words = len(windows.first)
    other, rx, ry = np.empty(len(xy), np.int64), np.empty(len(xy)), np.empty(len(xy))
    here, at_x, at_y = np.empty(words, np.int64), np.empty(words), np.empty(words)
    z, who, place, found = np.empty(words), np.empty(words, np.int64), np.empty(words), np.empty(words, np.int64)
    square, share = np.empty(64), np.empty(64)
    i, near, room = -1, 0, 0
    for e in range(done, len(order)):
        if owner[e] != i:
            i, near, room = owner[e], 0, 0
            for c in range(others_near(i, xy, bands, other, rx, ry)):
                room += first[other[c] + 1] - first[other[c]]
                for word in range(windows.word[other[c]], windows.word[other[c] + 1]):
                    here[near], at_x[near], at_y[near] = word, rx[c], ry[c]
                    near += 1
            if room > len(square):
                square, share = np.empty(2 * room), np.empty(2 * room)
        if at + room > len(by):
            return e, at, room
        dx, dy = d[e, 0], d[e, 1]
        length = np.hypot(dx, dy)
        still = length <= STILL_M
        # who stands has neighbours all around, as far as along a motion
        ux, uy = (1.0, 0.0) if still else (dx / length, dy / length)
        per_u, per_v = 1 / along, 1 / (along if still else across)
        for c in range(near):
            u, v = (at_x[c] * ux + at_y[c] * uy) * per_u, (at_x[c] * uy - at_y[c] * ux) * per_v
            z[c] = u * u + v * v
        inside = 0
        for c in range(near):
            who[inside], place[inside] = here[c], z[c]
            inside += z[c] <= CUT * CUT
        for n in range(inside):
            place[n] = bell(place[n])
        alike_x, alike_y = windows.x[windows.bin_x[e]], windows.y[windows.bin_y[e]]
        total, start[order[e]], count, speaking = 0.0, at, 0, 0
        for n in range(inside):
            total += place[n] * windows.leads[who[n]]
            found[speaking] = n
            speaking += (alike_x[who[n]] & alike_y[who[n]]) != 0
        for s in range(speaking):
            n = found[s]
            f, weighed, alike = windows.first[who[n]], peak * place[n], alike_x[who[n]] & alike_y[who[n]]
            while alike:
                g = f + lowest(alike)
                alike &= alike - np.uint32(1)
                x, y = d[g, 0] - dx, d[g, 1] - dy
                q = (x * x + y * y) * narrow
                by[at + count], square[count], share[count] = order[g], q, weighed
                count += q <= CUT * CUT
        for n in range(count):
            weight[at + n] = share[n] * bell(square[n])
        at += count
        voters[order[e]], stop[order[e]] = total, at
    return len(order), at, 0


@njit(cache=True, nogil=True)
def _windows(owner, d, first, cut):  # type: ignore[no-untyped-def]
    """Sort the edges, given by owner, into bins as wide as the *cut*, or wider where there were too many."""
    word = np.zeros(len(first), np.int64)
    for j in range(len(first) - 1):
        word[j + 1] = word[j] + max(1, (first[j + 1] - first[j] + 31) // 32)
    begin, leads = np.empty(word[-1], np.int64), np.zeros(word[-1])
    for j in range(len(first) - 1):
        leads[word[j]] = 1.0
        for w in range(word[j], word[j + 1]):
            begin[w] = first[j] + 32 * (w - word[j])
    bins = np.empty((2, len(d)), np.int32)
    bins = np.empty((2, len(d)), np.int32)
    for axis in range(2):
        low = d[:, axis].min()
        width = max(cut, (d[:, axis].max() - low) / MOST_BINS)
        for e in range(len(d)):
            bins[axis, e] = 1 + int((d[e, axis] - low) / width)
    x, y = np.zeros((bins[0].max() + 2, word[-1]), np.uint32), np.zeros((bins[1].max() + 2, word[-1]), np.uint32)
    for e in range(len(d)):
        nth = e - first[owner[e]]
        at, bit = word[owner[e]] + nth // 32, np.uint32(1) << np.uint32(nth % 32)
        for beside in range(-1, 2):
            x[bins[0, e] + beside, at] |= bit
            y[bins[1, e] + beside, at] |= bit
    return Windows(word, begin, leads, bins[0], bins[1], x, y)
