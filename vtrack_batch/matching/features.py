"""What is known about a possible link, as numbers that mean the same at every place, interval and noise.

Lengths are in metres and speeds in m/s; nothing depends on where north is or on which image is called the earlier one,
but for the flow map, which knows the sense of time. A value of ``UNKNOWN`` says: there is no colour, or no map, or no
neighbour. The trees of ``score`` are trained on these columns, in this order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from vtrack_batch.matching.candidates import Array, Bands, Edges, Index, bell, in_bands, others_near
from vtrack_batch.matching.local_flow import LocalFlow

UNKNOWN = -99.0
STILL_M = 2.0  # displacements below this have no direction
NEAR_M = 90.0  # neighbours farther than this are not asked
SCALES = np.array([[15.0, 3.0], [60.0, 8.0]])  # of place, along and across the motion (Gaussian sigma)
FARTHEST = 9.0  # squared distance of a neighbour, in standard deviations, up to which it is heard
NOTHING = 50.0  # squared distance, in standard deviations, from which on a vote adds nothing
LANE_M, GAP_M = 2.2, 3.5  # vehicles of one lane: so near across; so far apart at least along
LANE_AHEAD_M = 40.0  # how far along a lane its order is looked at

BASE = (
    "elapsed_s", "length_m", "speed_mps", "log_density", "spacing_m", "log_odds", "log_colour", "log_prior", "rival",
    "rival_other", "share", "map_1", "map_8", "map_24", "map_start", "map_end", "map_forward", "map_forward_wide",
    "map_backward", "map_backward_wide", "log_map", "light", "chroma", "matched", "jitter_m",
)  # fmt: skip
HEARD = (
    "near_weight", "near_along", "near_across", "near_votes", "near_votes_wide", "mid_weight", "mid_along",
    "mid_across", "mid_votes", "mid_votes_wide", "lane_broken", "lane_kept", "lane_broken_one",
)  # fmt: skip
OWN = ("logit", "logit_rival", "logit_rival_other", "logit_share")


@dataclass(frozen=True)
class Evidence:
    """What Bayes' rule made of every edge, before anything learned: all (e,).

    ``log_odds`` against no match, ``log_colour`` the likelihood ratio of colours or None, ``log_prior`` the log density
    of the displacement with neighbours heard and ``log_density`` that of vehicles (both 1/m2). ``light`` and ``chroma``
    are how noisy colours were found to be.
    """

    log_odds: Array
    log_colour: Array | None
    log_prior: Array
    log_density: Array
    light: float
    chroma: float

    def select(self, keep: Index) -> Evidence:
        """Return the evidence of the edges *keep*."""
        colour = None if self.log_colour is None else self.log_colour[keep]
        return Evidence(
            self.log_odds[keep], colour, self.log_prior[keep], self.log_density[keep], self.light, self.chroma
        )


@dataclass(frozen=True)
class Surroundings:
    """The vehicles of both images, sorted so that the neighbours of each are found, and how far the nearest one is.

    ``spacing`` (n + m,) metres, ``NEAR_M`` at most.
    """

    earlier: Bands
    later: Bands
    spacing: Array

    @classmethod
    def of(cls, earlier_xy: Array, later_xy: Array) -> Surroundings:
        """Sort points (n, 2) and (m, 2), n > 0 and m > 0."""
        bands = in_bands(earlier_xy, NEAR_M), in_bands(later_xy, NEAR_M)
        spacing = _spacing(earlier_xy, bands[0]), _spacing(later_xy, bands[1])
        return cls(*bands, np.concatenate(spacing))


def base_features(
    edges: Edges,
    evidence: Evidence,
    around: Surroundings,
    *,
    heard: Array,
    elapsed_s: float,
    flow: LocalFlow | None,
) -> Array:
    """Return the columns ``BASE`` (e, f) of the edges; *heard* are their columns ``HEARD`` by what Bayes' rule says."""
    length = np.hypot(*edges.displacement.T)
    spacing = np.minimum(around.spacing[edges.i], around.spacing[edges.n + edges.k])
    share = shares(edges, evidence.log_odds)
    best_i, best_k = np.zeros(edges.n), np.zeros(edges.m)
    np.maximum.at(best_i, edges.i, share)
    np.maximum.at(best_k, edges.k, share)
    matched = 0.5 * float(best_i.sum() + best_k.sum()) / max(1, min(edges.n, edges.m))
    sure = (share > 0.9) & (length > STILL_M) & (heard[:, 5] > 1)
    jitter = float(np.median(np.abs(heard[sure, 7]))) * elapsed_s if sure.sum() >= 5 else UNKNOWN
    constant = (elapsed_s, evidence.light, evidence.chroma, matched, jitter)
    t, light, chroma, matched_all, jitter_all = (np.full(len(length), value) for value in constant)
    colour = np.full(len(length), UNKNOWN) if evidence.log_colour is None else evidence.log_colour
    columns = [t, length, length / elapsed_s, evidence.log_density, spacing, evidence.log_odds, colour]
    columns += [evidence.log_prior - evidence.log_density, *_rivals(edges, evidence.log_odds), np.log(share + 1e-9)]
    columns += [*_map_features(edges, flow).T]
    return np.column_stack([*columns, light, chroma, matched_all, jitter_all])


def heard_features(
    edges: Edges,
    p: Array,
    around: Surroundings,
    earlier_xy: Array,
    later_xy: Array,
    *,
    elapsed_s: float,
    asked: Index | None = None,
) -> Array:
    """Return the columns ``HEARD`` (a, f): what neighbours say, each of their edges with its probability *p* (e,).

    Of all edges, or of those *asked* (a,) for, ascending.
    """
    d, order = edges.displacement, np.argsort(edges.k, kind="stable")
    spread = np.array([0.5 + 0.35 * elapsed_s, 0.7 + 1.4 * elapsed_s])
    asked = np.arange(len(d)) if asked is None else asked
    first_k = np.searchsorted(edges.k[order], np.arange(edges.m + 1))
    out = _hear(asked, edges.i, d, p, edges.first, around.earlier, earlier_xy, SCALES, spread)
    # seen from the later image time runs backward
    place = np.full(len(d), -1)
    place[asked] = np.arange(len(asked))
    rank = np.flatnonzero(place[order] >= 0)
    back = _hear(rank, edges.k[order], -d[order], p[order], first_k, around.later, later_xy, SCALES, spread)
    _add_other_side(out, back, place[order[rank]], elapsed_s)
    for s in range(len(SCALES)):
        votes = out[:, 5 * s + 3 : 5 * s + 5]
        np.log(votes, out=votes)
    return out


def own_features(edges: Edges, p: Array) -> Array:
    """Return the columns ``OWN`` (e, f): the probability of the round before and that of the best rivals."""
    p = np.clip(p, 1e-6, 1 - 1e-6)
    logit = np.log(p / (1 - p))
    left = _sum_of_ends(edges, p) - 2 * p
    return np.column_stack([logit, *_rivals(edges, logit), left])


def shares(edges: Edges, log_odds: Array) -> Array:
    """Return the probability (e,) of every edge against no match and all rivals at both of its ends."""
    odds = np.exp(np.clip(log_odds, -30, 30))
    return np.asarray(odds / (1 + _sum_of_ends(edges, odds) - odds))


def _sum_of_ends(edges: Edges, values: Array) -> Array:
    """Sum over all edges of i plus sum over all edges of k; an edge itself counts in both."""
    of_i = np.bincount(edges.i, weights=values, minlength=edges.n)
    of_k = np.bincount(edges.k, weights=values, minlength=edges.m)
    return np.asarray(of_i[edges.i] + of_k[edges.k])


def _rivals(edges: Edges, value: Array) -> tuple[Array, Array]:
    """Return by how much each edge is above its best rival at either end: the lesser lead, then the greater."""
    at_i, at_k = value - _best_other(edges.i, value), value - _best_other(edges.k, value)
    return np.minimum(at_i, at_k), np.maximum(at_i, at_k)


@njit(cache=True, nogil=True)
def _best_other(owner, value):  # type: ignore[no-untyped-def]
    size = owner.max() + 1 if len(owner) else 0
    best, second = np.full(size, -30.0), np.full(size, -30.0)
    for e in range(len(owner)):
        i = owner[e]
        if value[e] > best[i]:
            best[i], second[i] = value[e], best[i]
        elif value[e] > second[i]:
            second[i] = value[e]
    out = np.empty(len(owner))
    for e in range(len(owner)):
        i = owner[e]
        out[e] = second[i] if value[e] == best[i] else best[i]
    return out


def _map_features(edges: Edges, flow: LocalFlow | None) -> Array:
    return np.full((len(edges), 10), UNKNOWN) if flow is None or not len(edges) else flow.evidence(edges)


@njit(cache=True, nogil=True)
def _spacing(xy, bands):  # type: ignore[no-untyped-def]
    other, rx, ry = np.empty(len(xy), np.int64), np.empty(len(xy)), np.empty(len(xy))
    out = np.full(len(xy), NEAR_M * NEAR_M)
    for i in range(len(xy)):
        for c in range(others_near(i, xy, bands, other, rx, ry)):
            out[i] = min(out[i], rx[c] * rx[c] + ry[c] * ry[c])
    return np.sqrt(out)


@njit(cache=True, nogil=True)
def _hear(asked, owner, d, p, first, bands, xy, scales, spread):  # type: ignore[no-untyped-def]
    """Sum over the edges of neighbours: weight, residual along and across, votes narrow and wide, per scale; lanes.

    Edges are by owner, from ``first[i]`` on; so are those that are *asked* for.
    """
    out, (voices, voice) = np.zeros((len(asked), 13)), _voices(p, d, first)
    other, rx, ry = np.empty(len(xy), np.int64), np.empty(len(xy)), np.empty(len(xy))
    who, from_x, from_y, said = np.empty(len(voice), np.int64), np.empty(len(voice)), np.empty(len(voice)), 0
    by_x, by_y, loud = np.empty(len(voice)), np.empty(len(voice)), np.empty(len(voice))
    at_u, at_v, lane = np.empty(len(voice)), np.empty(len(voice)), np.empty(len(voice), np.int64)
    square, along, across = np.empty(len(voice)), np.empty(len(voice)), np.empty(len(voice))
    near, far, say = np.empty(len(voice)), np.empty(len(voice)), np.empty(len(voice))
    narrow, wide, i = 1 / spread[0] ** 2, 1 / spread[1] ** 2, -1
    for at in range(len(asked)):
        e = asked[at]
        if owner[e] != i:
            i, said = owner[e], 0
            for c in range(others_near(i, xy, bands, other, rx, ry)):
                for f in range(voices[other[c]], voices[other[c] + 1]):
                    who[said], from_x[said], from_y[said] = c, rx[c], ry[c]
                    by_x[said], by_y[said], loud[said] = voice[f, 0], voice[f, 1], voice[f, 2]
                    said += 1
        length = np.hypot(d[e, 0], d[e, 1])
        still = length <= STILL_M
        ux, uy = (1.0, 0.0) if still else (d[e, 0] / length, d[e, 1] / length)
        for n in range(said):
            at_u[n], at_v[n] = from_x[n] * ux + from_y[n] * uy, from_x[n] * uy - from_y[n] * ux
        to_x, to_y = d[e, 0], d[e, 1]
        for n in range(said):
            square[n] = (by_x[n] - to_x) * (by_x[n] - to_x) + (by_y[n] - to_y) * (by_y[n] - to_y)
        for n in range(said):
            dx, dy = by_x[n] - to_x, by_y[n] - to_y
            along[n], across[n] = dx * ux + dy * uy, dx * uy - dy * ux
        if not still:
            count = 0
            for n in range(said):
                lane[count] = n
                count += (abs(at_v[n]) < LANE_M) & (abs(at_u[n]) < LANE_AHEAD_M)
            broken, kept = 0.0, 0.0
            for s in range(count):  # what all voices of one neighbour say of the order in the lane
                n = lane[s]
                if abs(at_v[n] + across[n]) < LANE_M:
                    after = at_u[n] + along[n]
                    passed = after * at_u[n] < 0 or abs(after) < GAP_M
                    broken, kept = (broken + loud[n], kept) if passed else (broken, kept + loud[n])
                if s + 1 == count or who[lane[s + 1]] != who[n]:
                    out[at, 10] += broken
                    out[at, 11] += kept
                    out[at, 12] = max(out[at, 12], broken)
                    broken, kept = 0.0, 0.0
        else:
            for n in range(said):
                along[n], across[n] = np.sqrt(square[n]), 0.0
        for n in range(said):
            a, b = square[n] * narrow, square[n] * wide
            near[n], far[n] = bell(min(a, NOTHING)), bell(min(b, NOTHING))
            near[n], far[n] = (near[n] if a < NOTHING else 0.0), (far[n] if b < NOTHING else 0.0)
        for r in range(len(scales)):
            # who stands has neighbours all around
            per_u, per_v = (2 / scales[r, 0], 2 / scales[r, 0]) if still else (1 / scales[r, 0], 1 / scales[r, 1])
            for n in range(said):
                z = (at_u[n] * per_u) ** 2 + (at_v[n] * per_v) ** 2
                place = bell(min(z, FARTHEST))
                say[n] = loud[n] * (place if z <= FARTHEST else 0.0)
            weight, by_along, by_across, by_near, by_far = 0.0, 0.0, 0.0, 0.0, 0.0
            for n in range(said):
                w = say[n]
                weight += w
                by_along += w * along[n]
                by_across += w * across[n]
                by_near += w * near[n]
                by_far += w * far[n]
            out[at, 5 * r : 5 * r + 5] = weight, by_along, by_across, by_near, by_far
    return out


@njit(cache=True, nogil=True)
def _add_other_side(out, back, rows, elapsed_s):  # type: ignore[no-untyped-def]
    """Make of the sums *out* (a, 13) at one end, and *back* (a, 13), of *rows*, at the other, the columns of both."""
    for n in range(len(rows)):
        at = rows[n]
        for s in range(0, 10, 5):
            weight = out[at, s] + back[n, s]
            for c in range(s + 1, s + 3):
                moment = out[at, c] + back[n, c]
                out[at, c] = moment / max(weight, 1e-3) / elapsed_s if weight > 1e-3 else UNKNOWN
            for c in range(s + 3, s + 5):
                out[at, c] = (out[at, c] + back[n, c] + 0.05) / (weight + 0.5)
            out[at, s] = weight
        out[at, 10] += back[n, 10]
        out[at, 11] += back[n, 11]
        out[at, 12] = max(out[at, 12], back[n, 12])


@njit(cache=True, nogil=True)
def _voices(p, d, first):  # type: ignore[no-untyped-def]
    """Return displacement and probability of the edges that are not hopeless, by owner: start (n + 1,), and (v, 3)."""
    start, voice, at = np.zeros(len(first), np.int64), np.empty((len(p), 3)), 0
    for j in range(len(first) - 1):
        for f in range(first[j], first[j + 1]):
            if p[f] >= 1e-3:
                voice[at, 0], voice[at, 1], voice[at, 2] = d[f, 0], d[f, 1], p[f]
                at += 1
        start[j + 1] = at
    return start, voice
