"""What past and future say about every possible link: messages along the graph of links, forward and backward.

Every possible link e = (h, i) carries the state (position, velocity, mean colour) that a vehicle would have which came
that way. The belief in a link (i, k) is a mixture over the ways into i and the ways out of k, each weighted by what its
own past (or future) makes of it: wrong links beside it do not blind it, as they would if the past were one chain.
A link's message never holds the link itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from vtrack_batch.matching.colour import log_same_paint
from vtrack_batch.tracking.sightings import Array, Index

FAINT = 1e-3  # ways less likely than this are left out
LOG_ODDS_MAX = 30.0
BEHIND = 20.0  # ways whose motion is this much (log) less likely than the rest are left out before colour is asked


class Graph(NamedTuple):
    """Sightings and the possible links between them (a named tuple, because compiled code reads it).

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


class Ways(NamedTuple):
    """Links by sighting: those into h are ``into[into_start[h]:into_start[h + 1]]``, those out of it likewise."""

    into_start: Index
    into: Index
    out_start: Index
    out: Index


class Messages(NamedTuple):
    """State and weight of every link as a way into (backward: out of) its far end; ``seen`` = sightings behind it.

    ``log_weight`` is known where a way is not ``FAINT``.
    """

    weight: Array
    log_weight: Array
    mean: Array
    cov: Array
    paint: Array
    seen: Array


def link_gains(g: Graph) -> Array:
    """Return the log-odds (e,) of every possible link, by the past, the future, motion and colour."""
    order = np.argsort(g.t, kind="stable")
    into, out = _grouped(g.k, len(g.t)), _grouped(g.i, len(g.t))
    past = _messages(order, g, Ways(*into, *out))
    future = _messages(order[::-1].copy(), g._replace(i=g.k, k=g.i), Ways(*out, *into))
    return np.asarray(_combined(g, Ways(*into, *out), past, future))


def _grouped(owner: Index, n: int) -> tuple[Index, Index]:
    """Return start (n + 1,) and link numbers (e,) grouped by owner."""
    order = np.argsort(owner, kind="stable")
    return np.searchsorted(owner[order], np.arange(n + 1)).astype(np.int64), order.astype(np.int64)


@njit(cache=True, nogil=True)
def _log_sum(a, b):  # type: ignore[no-untyped-def]
    if a < b:
        a, b = b, a
    return a if b == -np.inf else a + np.log1p(np.exp(b - a))


@njit(cache=True, nogil=True)
def _grown(pp, pv, vv, dt, q):  # type: ignore[no-untyped-def]
    """Covariance (pp, pv, vv) after the time *dt*, of either sign."""
    h = abs(dt)
    return pp + 2 * dt * pv + dt * dt * vv + q * h * h * h / 3, pv + dt * vv + q * h * dt / 2, vv + q * h


@njit(cache=True, nogil=True)
def _log_place(m, w, dt, x, y, variance, motion, least):  # type: ignore[no-untyped-def]
    """Log density of a sighting at (x, y) for a vehicle in state *w*, ordinary or rough driving; -inf below *least*."""
    dx, dy = x - m.mean[w, 0] - dt * m.mean[w, 2], y - m.mean[w, 1] - dt * m.mean[w, 3]
    half = 0.5 * (dx * dx + dy * dy)
    grown = m.cov[w, 0] + 2 * dt * m.cov[w, 1] + dt * dt * m.cov[w, 2] + variance
    jolt = motion[0] * abs(dt) ** 3 / 3
    usual, rough = grown + jolt, grown + jolt * motion[1]
    if -half / rough < least + np.log(2 * np.pi * usual):  # the density is at most exp(-half / rough) / (2 pi usual)
        return -np.inf
    density = (1 - motion[2]) * np.exp(-half / usual) / usual + motion[2] * np.exp(-half / rough) / rough
    return np.log(density / (2 * np.pi) + 1e-300)


@njit(cache=True, nogil=True)
def _log_meet(past, a, dt, future, b, motion):  # type: ignore[no-untyped-def]
    """Log density ratio of a past and a future state being one vehicle's; the velocity's prior stands in both once."""
    dx, dy = future.mean[b, 0] - past.mean[a, 0], future.mean[b, 1] - past.mean[a, 1]
    du, dv = future.mean[b, 2] - past.mean[a, 2], future.mean[b, 3] - past.mean[a, 3]
    dx, dy = dx - dt * past.mean[a, 2], dy - dt * past.mean[a, 3]
    density = 1e-300
    for rough in range(2):
        pp, pv, vv = _grown(past.cov[a, 0], past.cov[a, 1], past.cov[a, 2], dt, motion[0] * (motion[1] if rough else 1))
        pp, pv, vv = pp + future.cov[b, 0], pv + future.cov[b, 1], vv + future.cov[b, 2]
        det = max(pp * vv - pv * pv, 1e-12)
        z = (vv * (dx * dx + dy * dy) - 2 * pv * (dx * du + dy * dv) + pp * (du * du + dv * dv)) / det
        density += (motion[2] if rough else 1 - motion[2]) * np.exp(-0.5 * z) / det
    u, v = 0.5 * (future.mean[b, 2] + past.mean[a, 2]), 0.5 * (future.mean[b, 3] + past.mean[a, 3])
    prior = 2 * np.pi * motion[3] ** 2
    return np.log(density * prior / (2 * np.pi) ** 2) + 0.5 * (u * u + v * v) / motion[3] ** 2


@njit(cache=True, nogil=True)
def _log_paint(g, e, first, a, second, b, variance):  # type: ignore[no-untyped-def]
    """Log-likelihood ratio of two mean colours at the ends of link *e*; 0 without colour."""
    if not len(g.noise):
        return 0.0
    log_random = 0.5 * (g.log_paint[g.i[e]] + g.log_paint[g.k[e]])
    return log_same_paint(first, a, second, b, variance, log_random, g.noise)


@njit(cache=True, nogil=True)
def _messages(order, g, ways):  # type: ignore[no-untyped-def]
    """Pass states along all links, sighting by sighting, each way weighted against its rivals at both ends."""
    size = len(g.i)
    m = Messages(
        np.zeros(size), np.full(size, -np.inf), np.zeros((size, 4)), np.zeros((size, 3)), np.zeros((size, 3)),
        np.ones(size),
    )  # fmt: skip
    odds, sum_into, sum_out = np.zeros(size), np.zeros(len(g.t)), np.zeros(len(g.t))
    likely = np.empty(size, np.int64)
    for h in order:
        known, count = 0.0, 0
        for s in range(ways.into_start[h], ways.into_start[h + 1]):
            e = ways.into[s]
            rivals = max(sum_into[h] - odds[e], 0.0) + max(sum_out[g.i[e]] - odds[e], 0.0)
            m.weight[e] = g.motion[4] * odds[e] / (1 + odds[e] + rivals)
            known += m.weight[e]
            if m.weight[e] >= FAINT:
                m.log_weight[e] = np.log(m.weight[e])
                likely[count] = e
                count += 1
        log_birth = np.log(max(1 - known, 1 - g.motion[4]))
        for s in range(ways.out_start[h], ways.out_start[h + 1]):
            e = ways.out[s]
            total, way = _best_way(e, log_birth, g, likely[:count], m)
            _write_state(e, way, g, m)
            odds[e] = np.exp(min(max(total + g.log_odds[e], -LOG_ODDS_MAX), LOG_ODDS_MAX))
            sum_out[h] += odds[e]
            sum_into[g.k[e]] += odds[e]
    return m


@njit(cache=True, nogil=True)
def _best_way(e, log_birth, g, likely, m):  # type: ignore[no-untyped-def]
    """Sum over the *likely* ways into link *e*, birth included; returns the log sum and the best way, -1 = birth."""
    h, k = g.i[e], g.k[e]
    dt, x, y = g.t[k] - g.t[h], g.xy[k, 0], g.xy[k, 1]
    best = log_birth + g.log_alone[e] + _log_paint(g, e, g.paint, h, g.paint, k, 2.0)
    total, way = best, -1
    for w in likely:
        term = m.log_weight[w] + _log_place(m, w, dt, x, y, g.variance[k], g.motion, total - BEHIND - m.log_weight[w])
        if term < total - BEHIND:
            continue
        term += _log_paint(g, e, m.paint, w, g.paint, k, 1 / m.seen[w] + 1)
        total = _log_sum(total, term)
        if term > best:
            best, way = term, w
    return total, way


@njit(cache=True, nogil=True)
def _write_state(e, way, g, m):  # type: ignore[no-untyped-def]
    """Write the state at the far end of link *e* of a vehicle that came by *way*, or was born at the near end."""
    h, k = g.i[e], g.k[e]
    dt = g.t[k] - g.t[h]
    if way < 0:
        at = g.xy[h, 0], g.xy[h, 1], 0.0, 0.0
        pp, pv, vv = _grown(g.variance[h], 0.0, g.motion[3] ** 2, dt, g.motion[0])
        n = 1.0
        for c in range(3):
            m.paint[e, c] = 0.5 * (g.paint[h, c] + g.paint[k, c])
    else:
        at = m.mean[way, 0], m.mean[way, 1], m.mean[way, 2], m.mean[way, 3]
        pp, pv, vv = _grown(m.cov[way, 0], m.cov[way, 1], m.cov[way, 2], dt, g.motion[0])
        n = min(m.seen[way], g.motion[5])
        for c in range(3):
            m.paint[e, c] = (n * m.paint[way, c] + g.paint[k, c]) / (n + 1)
    m.seen[e] = n + 1
    share, share_v = pp / (pp + g.variance[k]), pv / (pp + g.variance[k])  # Kalman gains
    for c in range(2):
        ahead = at[c] + dt * at[c + 2]
        residual = g.xy[k, c] - ahead
        m.mean[e, c], m.mean[e, c + 2] = ahead + share * residual, at[c + 2] + share_v * residual
    m.cov[e, 0], m.cov[e, 1], m.cov[e, 2] = pp - share * pp, pv - share * pv, vv - share_v * pv


@njit(cache=True, nogil=True)
def _combined(g, ways, past, future):  # type: ignore[no-untyped-def]
    """Log-odds of every link: the sum over ways into its near end and out of its far end, none included on each."""
    gain = np.empty(len(g.i))
    no_past, no_future = _none(ways.into_start, ways.into, past, g), _none(ways.out_start, ways.out, future, g)
    for e in range(len(g.i)):
        i, k = g.i[e], g.k[e]
        log_none = no_past[i] + no_future[k]
        total = log_none + g.log_alone[e] + _log_paint(g, e, g.paint, i, g.paint, k, 2.0)
        for s in range(ways.into_start[i], ways.into_start[i + 1]):
            a = ways.into[s]
            if past.weight[a] >= FAINT:
                total = _log_sum(total, _by_past(e, a, no_future[k], g, ways, past, future))
        dt, x, y = g.t[i] - g.t[k], g.xy[i, 0], g.xy[i, 1]
        for s in range(ways.out_start[k], ways.out_start[k + 1]):
            b = ways.out[s]
            if future.weight[b] >= FAINT:
                base = future.log_weight[b] + no_past[i]
                term = base + _log_place(future, b, dt, x, y, g.variance[i], g.motion, total - 2 * BEHIND - base)
                term += _log_paint(g, e, future.paint, b, g.paint, i, 1 / future.seen[b] + 1)
                total = _log_sum(total, term)
        gain[e] = total + g.log_odds[e]
    return gain


@njit(cache=True, nogil=True)
def _none(start, ways, m, g):  # type: ignore[no-untyped-def]
    """Log probability (n,) that a vehicle came (or went) by none of its ways."""
    none = np.empty(len(start) - 1)
    for h in range(len(none)):
        left = 1.0
        for s in range(start[h], start[h + 1]):
            left -= m.weight[ways[s]]
        none[h] = np.log(max(left, 1 - g.motion[4]))
    return none


@njit(cache=True, nogil=True)
def _by_past(e, a, no_future, g, ways, past, future):  # type: ignore[no-untyped-def]
    """Log-likelihood of link *e* for a vehicle that came by *a*: with no future, or any of the ways on."""
    i, k = g.i[e], g.k[e]
    dt = g.t[k] - g.t[i]
    total = no_future + _log_place(past, a, dt, g.xy[k, 0], g.xy[k, 1], g.variance[k], g.motion, -np.inf)
    total += _log_paint(g, e, past.paint, a, g.paint, k, 1 / past.seen[a] + 1)
    for s in range(ways.out_start[k], ways.out_start[k + 1]):
        b = ways.out[s]
        if past.weight[a] * future.weight[b] < FAINT:
            continue
        term = future.log_weight[b] + _log_meet(past, a, dt, future, b, g.motion)
        if term < total - BEHIND:
            continue
        term += _log_paint(g, e, past.paint, a, future.paint, b, 1 / past.seen[a] + 1 / future.seen[b])
        total = _log_sum(total, term)
    return past.log_weight[a] + total
