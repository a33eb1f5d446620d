"""What past and future say about every possible link: messages along the graph of links, forward and backward.

Every possible link e = (h, i) carries the state (position, velocity, mean colour) that a vehicle would have which came
that way. The belief in a link (i, k) is a mixture over the ways into i and the ways out of k, each weighted by what its
own past (or future) makes of it: wrong links beside it do not blind it, as they would if the past were one chain.
A link's message never holds the link itself.

A state is a row of numbers: place, velocity, their covariance (the same on both axes), mean colour, and how many
sightings are in it. A sighting alone is a state too, of a vehicle that is born there. Likelihoods are multiplied as
they are, not as logarithms: the least of them, of a vehicle without past or future, is far above the least number.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from vtrack_batch.tracking.sightings import Array, Index

X, Y, VX, VY, PP, PV, VV, LIGHT, REDDISH, BLUISH, SEEN = range(11)
WIDTH = 11
FAINT = 1e-3  # ways less likely than this are left out
LEAST_ODDS, MOST_ODDS = np.exp(-30.0), np.exp(30.0)
BEHIND = np.exp(-20.0)  # ways whose motion is this much less likely than the rest are left out before colour is asked
FARTHEST = 100.0  # half a squared distance, in variances of rough driving, from which on a density is zero


class Graph(NamedTuple):
    """Sightings and the possible links between them.

    ``i``, ``k`` (e,) int64; ``log_alone`` (e,) log density (1/m2) of the displacement when nothing is known of the
    motion on either side; ``log_odds`` (e,) all of a link's log-odds but motion and colour. Of sightings: ``t`` (n,) s,
    ``xy`` (n, 2) m, ``variance`` (n,) m2, ``paint`` (n, 3) in opponent axes, ``log_paint`` (n,) its log density.
    ``noise`` of colours, empty = no colour; ``motion``: q, factor and share of rough driving, sigma of unknown speeds,
    greatest trust in a way, and for how many sightings a mean colour counts.
    """

    i: Index
    k: Index
    log_alone: Array
    log_odds: Array
    t: Array
    xy: Array
    variance: Array
    paint: Array
    log_paint: Array
    noise: Array
    motion: Array


def link_gains(g: Graph) -> Array:
    """Return the log-odds (e,) of every possible link, by the past, the future, motion and colour."""
    n = len(g.t)
    born = np.column_stack([g.xy, np.zeros((n, 2)), g.variance, np.zeros((n, 2)), g.paint, np.ones(n)])
    born[:, VV] = g.motion[3] ** 2
    noise, shared = np.array([1.0, 0.0, 1.0, 1.0]), np.zeros(len(g.i))
    if len(g.noise):
        noise, shared = g.noise, np.exp(g.noise[4] - 0.5 * (g.log_paint[g.i] + g.log_paint[g.k]))
    alone = np.exp(g.log_alone) * _alike(g.i, g.k, shared, born, noise)
    order, odds = np.argsort(g.t, kind="stable"), np.exp(g.log_odds)
    into, out = _grouped(g.k, n), _grouped(g.i, n)
    given: tuple[Any, ...] = (alone, odds, shared, g.t, born, noise, g.motion)
    past = _messages(order, g.i, g.k, *into, *out, *given)
    future = _messages(order[::-1].copy(), g.k, g.i, *out, *into, *given)
    return np.asarray(_combined(g.i, g.k, *into, *out, *past, *future, *given))


@njit(cache=True, nogil=True)
def _grouped(owner, n):  # type: ignore[no-untyped-def]
    """Return start (n + 1,) and link numbers (e,) grouped by owner."""
    start, order = np.zeros(n + 1, np.int64), np.empty(len(owner), np.int64)
    for e in range(len(owner)):
        start[owner[e] + 1] += 1
    for h in range(n):
        start[h + 1] += start[h]
    at = start[:-1].copy()
    for e in range(len(owner)):
        order[at[owner[e]]] = e
        at[owner[e]] += 1
    return start, order


@njit(cache=True, nogil=True)
def distinct(i, k, n):  # type: ignore[no-untyped-def]
    """Return the row (d,) of the first of each link between sightings *i* and *k* (e,) of *n*, in order of i and k."""
    start, order = _grouped(i, n)
    rows, count = np.empty(len(i), np.int64), 0
    for h in range(n):
        for s in range(start[h], start[h + 1]):  # few belong to one sighting: each is put where it belongs
            row, at = order[s], s
            while at > start[h] and k[order[at - 1]] > k[row]:
                order[at] = order[at - 1]
                at -= 1
            order[at] = row
        for s in range(start[h], start[h + 1]):
            if s == start[h] or k[order[s]] != k[order[s - 1]]:
                rows[count] = order[s]
                count += 1
    return rows[:count]


@njit(cache=True, nogil=True)
def _density(dx, dy, grown, jolt, motion):  # type: ignore[no-untyped-def]
    """Density (1/m2) of a sighting (dx, dy) off, of variance *grown* but for the jolts of driving, usual or rough."""
    half, usual, rough = 0.5 * (dx * dx + dy * dy), grown + jolt, grown + jolt * motion[1]
    if half > FARTHEST * rough:
        return 0.0
    density = (1 - motion[2]) * np.exp(-half / usual) / usual + motion[2] * np.exp(-half / rough) / rough
    return density / (2 * np.pi)


@njit(cache=True, nogil=True)
def _place(state, w, dt, born, k, motion):  # type: ignore[no-untyped-def]
    """Density (1/m2) of sighting *k* for a vehicle in state *w*, *dt* away; ordinary or rough driving."""
    dx = born[k, X] - state[w, X] - dt * state[w, VX]
    dy = born[k, Y] - state[w, Y] - dt * state[w, VY]
    grown = state[w, PP] + 2 * dt * state[w, PV] + dt * dt * state[w, VV] + born[k, PP]
    return _density(dx, dy, grown, motion[0] * abs(dt) ** 3 / 3, motion)


@njit(cache=True, nogil=True)
def _same_paint(first, a, second, b, shared, noise):  # type: ignore[no-untyped-def]
    """Likelihood ratio of the mean colours of two states being one vehicle's; see ``colour.log_same_paint``.

    *shared* is what all states at the ends of one link have in common, 0 without colour.
    """
    if shared == 0:
        return noise[3]
    variance = 1 / first[a, SEEN] + 1 / second[b, SEEN]
    brightness = 0.5 * (first[a, LIGHT] + second[b, LIGHT])
    v_light = (noise[0] ** 2 + (noise[1] * brightness) ** 2) * variance
    v_chroma = noise[2] ** 2 * variance
    light, red, blue = (
        first[a, LIGHT] - second[b, LIGHT], first[a, REDDISH] - second[b, REDDISH], first[a, BLUISH] - second[b, BLUISH]
    )  # fmt: skip
    z = light**2 / v_light + (red**2 + blue**2) / v_chroma
    return shared * np.exp(-0.5 * z) / (np.sqrt(v_light) * v_chroma) + noise[3]


@njit(cache=True, nogil=True)
def _alike(i, k, shared, born, noise):  # type: ignore[no-untyped-def]
    out = np.empty(len(i))
    for e in range(len(i)):
        out[e] = _same_paint(born, i[e], born, k[e], shared[e], noise)
    return out


@njit(cache=True, nogil=True)
def _messages(order, near, far, into_start, into, out_start, out, alone, odds, shared, t, born, noise, motion):  # type: ignore[no-untyped-def]
    """Pass states along all links, sighting by sighting, each way weighted against its rivals at both ends.

    Returns of every link its state and weight as a way into (backward: out of) its far end, and the density of this end
    for all the ways into its near end.
    """
    size, trust = len(near), motion[4]
    state, weight, likely = np.zeros((size, WIDTH)), np.zeros(size), np.empty(size, np.int64)
    found, sum_into, sum_out, expected = np.zeros(size), np.zeros(len(t)), np.zeros(len(t)), np.zeros(size)
    for h in order:
        known, count = 0.0, 0
        for s in range(into_start[h], into_start[h + 1]):
            e = into[s]
            rivals = max(sum_into[h] - found[e], 0.0) + max(sum_out[near[e]] - found[e], 0.0)
            weight[e] = trust * found[e] / (1 + found[e] + rivals)
            known += weight[e]
            if weight[e] >= FAINT:
                likely[count] = e
                count += 1
        birth = max(1 - known, 1 - trust)
        for s in range(out_start[h], out_start[h + 1]):
            e = out[s]
            k = far[e]
            dt = t[k] - t[h]
            best, way = birth * alone[e], -1
            total = best
            for c in range(count):
                w = likely[c]
                term = weight[w] * _place(state, w, dt, born, k, motion)
                if term < total * BEHIND:
                    continue
                term *= _same_paint(state, w, born, k, shared[e], noise)
                total += term
                expected[e] += term
                if term > best:
                    best, way = term, w
            if way < 0:
                _write_state(born, h, dt, born, k, motion, state, e)
            else:
                _write_state(state, way, dt, born, k, motion, state, e)
            found[e] = min(max(total * odds[e], LEAST_ODDS), MOST_ODDS)
            sum_out[h] += found[e]
            sum_into[k] += found[e]
    return state, weight, expected


@njit(cache=True, nogil=True)
def _write_state(former, way, dt, born, k, motion, state, e):  # type: ignore[no-untyped-def]
    """Write as ``state[e]`` what ``former[way]`` has become when the vehicle is seen as sighting *k*, *dt* away."""
    h = abs(dt)
    pp, pv, vv = former[way, PP], former[way, PV], former[way, VV]
    pp, pv = pp + 2 * dt * pv + dt * dt * vv + motion[0] * h * h * h / 3, pv + dt * vv + motion[0] * h * dt / 2
    vv += motion[0] * h
    n = min(former[way, SEEN], motion[5])
    for c in (LIGHT, REDDISH, BLUISH):
        state[e, c] = (n * former[way, c] + born[k, c]) / (n + 1)
    state[e, SEEN] = n + 1
    share, share_v = pp / (pp + born[k, PP]), pv / (pp + born[k, PP])  # Kalman gains
    for c in (X, Y):
        ahead = former[way, c] + dt * former[way, c + 2]
        residual = born[k, c] - ahead
        state[e, c], state[e, c + 2] = ahead + share * residual, former[way, c + 2] + share_v * residual
    state[e, PP], state[e, PV], state[e, VV] = pp - share * pp, pv - share * pv, vv - share_v * pv


@njit(cache=True, nogil=True)
def _combined(i, k, into_start, into, out_start, out, past, past_weight, from_past, future, future_weight, from_future, alone, odds, shared, t, born, noise, motion):  # type: ignore[no-untyped-def]  # fmt: skip  # noqa: E501
    """Log-odds of every link: the sum over ways into its near end and out of its far end, none included on each."""
    gain = np.empty(len(i))
    no_past = _none(into_start, into, past_weight, motion[4])
    no_future = _none(out_start, out, future_weight, motion[4])
    for e in range(len(i)):
        dt = t[k[e]] - t[i[e]]
        total = no_past[i[e]] * no_future[k[e]] * alone[e]
        total += no_future[k[e]] * from_past[e] + no_past[i[e]] * from_future[e]
        for r in range(into_start[i[e]], into_start[i[e] + 1]):
            a = into[r]
            if past_weight[a] < FAINT:
                continue
            for s in range(out_start[k[e]], out_start[k[e] + 1]):
                b = out[s]
                both = past_weight[a] * future_weight[b]
                if both < FAINT:
                    continue
                term = both * _meet(past, a, dt, future, b, motion)
                if term >= total * BEHIND:
                    total += term * _same_paint(past, a, future, b, shared[e], noise)
        gain[e] = np.log(total * odds[e])
    return gain


@njit(cache=True, nogil=True)
def _none(start, ways, weight, trust):  # type: ignore[no-untyped-def]
    """Probability (n,) that a vehicle came (or went) by none of its ways."""
    none = np.empty(len(start) - 1)
    for h in range(len(none)):
        left = 1.0
        for s in range(start[h], start[h + 1]):
            left -= weight[ways[s]]
        none[h] = max(left, 1 - trust)
    return none


@njit(cache=True, nogil=True)
def _meet(past, a, dt, future, b, motion):  # type: ignore[no-untyped-def]
    """Density ratio of a past and a future state being one vehicle's; the velocity's prior stands in both once."""
    h, prior = abs(dt), motion[3] ** 2
    du, dv = future[b, VX] - past[a, VX], future[b, VY] - past[a, VY]
    dx, dy = future[b, X] - past[a, X] - dt * past[a, VX], future[b, Y] - past[a, Y] - dt * past[a, VY]
    xx, xv, vv = dx * dx + dy * dy, dx * du + dy * dv, du * du + dv * dv
    c_pp = past[a, PP] + 2 * dt * past[a, PV] + dt * dt * past[a, VV] + future[b, PP]
    c_pv, c_vv = past[a, PV] + dt * past[a, VV] + future[b, PV], past[a, VV] + future[b, VV]
    u, v = 0.5 * (future[b, VX] + past[a, VX]), 0.5 * (future[b, VY] + past[a, VY])
    speed, density = 0.5 * (u * u + v * v) / prior, 0.0
    for rough in range(2):
        q, share = (motion[0] * motion[1], motion[2]) if rough else (motion[0], 1 - motion[2])
        pp, pv, p_vv = c_pp + q * h * h * h / 3, c_pv + q * h * dt / 2, c_vv + q * h
        det = max(pp * p_vv - pv * pv, 1e-12)
        z = (p_vv * xx - 2 * pv * xv + pp * vv) / det
        density += share * np.exp(speed - 0.5 * z) / det
    return density * prior / (2 * np.pi)
