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
    """State and weight of every link as a way into (backward: out of) its far end; ``seen`` = sightings behind it."""

    weight: Array
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
def _grown(cov, dt, q):  # type: ignore[no-untyped-def]
    """Covariance (pp, pv, vv) after the time *dt*, of either sign."""
    h = abs(dt)
    return (
        cov[0] + 2 * dt * cov[1] + dt * dt * cov[2] + q * h**3 / 3,
        cov[1] + dt * cov[2] + q * h * dt / 2,
        cov[2] + q * h,
    )


@njit(cache=True, nogil=True)
def _log_place(mean, cov, dt, x, y, variance, motion):  # type: ignore[no-untyped-def]
    """Log density of a sighting at (x, y) for a vehicle in this state, ordinary or rough driving."""
    dx, dy = x - mean[0] - dt * mean[2], y - mean[1] - dt * mean[3]
    square = dx * dx + dy * dy
    usual = _grown(cov, dt, motion[0])[0] + variance
    rough = _grown(cov, dt, motion[0] * motion[1])[0] + variance
    density = (1 - motion[2]) * np.exp(-0.5 * square / usual) / usual + motion[2] * np.exp(
        -0.5 * square / rough
    ) / rough
    return np.log(density / (2 * np.pi) + 1e-300)


@njit(cache=True, nogil=True)
def _log_meet(mean, cov, dt, later, later_cov, motion):  # type: ignore[no-untyped-def]
    """Log density ratio of a past and a future state being one vehicle's; the velocity's prior stands in both once."""
    dx, dy = later[0] - mean[0] - dt * mean[2], later[1] - mean[1] - dt * mean[3]
    du, dv = later[2] - mean[2], later[3] - mean[3]
    density = 1e-300
    for rough in range(2):
        pp, pv, vv = _grown(cov, dt, motion[0] * (motion[1] if rough else 1.0))
        pp, pv, vv = pp + later_cov[0], pv + later_cov[1], vv + later_cov[2]
        det = max(pp * vv - pv * pv, 1e-12)
        z = (vv * (dx * dx + dy * dy) - 2 * pv * (dx * du + dy * dv) + pp * (du * du + dv * dv)) / det
        density += (motion[2] if rough else 1 - motion[2]) * np.exp(-0.5 * z) / (det * (2 * np.pi) ** 2)
    total = np.log(density)
    u, v = 0.5 * (later[2] + mean[2]), 0.5 * (later[3] + mean[3])
    return total + 0.5 * (u * u + v * v) / motion[3] ** 2 + np.log(2 * np.pi * motion[3] ** 2)


@njit(cache=True, nogil=True)
def _updated(mean, cov, dt, x, y, variance, q, out_mean, out_cov):  # type: ignore[no-untyped-def]
    """Kalman step: predict by *dt*, correct by the sighting; writes the new state."""
    pp, pv, vv = _grown(cov, dt, q)
    s = pp + variance
    for c in range(2):
        at = mean[c] + dt * mean[c + 2]
        residual = (x if c == 0 else y) - at
        out_mean[c] = at + pp / s * residual
        out_mean[c + 2] = mean[c + 2] + pv / s * residual
    out_cov[0], out_cov[1], out_cov[2] = pp - pp * pp / s, pv - pp * pv / s, vv - pv * pv / s


@njit(cache=True, nogil=True)
def _log_paint(g, i, k, first, second, variance):  # type: ignore[no-untyped-def]
    """Log-likelihood ratio of two mean colours, at the sightings i and k; 0 without colour."""
    if not len(g.noise):
        return 0.0
    return log_same_paint(first, second, variance, 0.5 * (g.log_paint[i] + g.log_paint[k]), g.noise)


@njit(cache=True, nogil=True)
def _messages(order, g, ways):  # type: ignore[no-untyped-def]
    """Pass states along all links, sighting by sighting, each way weighted against its rivals at both ends."""
    size = len(g.i)
    m = Messages(np.zeros(size), np.zeros((size, 4)), np.zeros((size, 3)), np.zeros((size, 3)), np.ones(size))
    odds, sum_into, sum_out = np.zeros(size), np.zeros(len(g.t)), np.zeros(len(g.t))
    for h in order:
        known = 0.0
        for s in range(ways.into_start[h], ways.into_start[h + 1]):
            e = ways.into[s]
            rivals = max(sum_into[h] - odds[e], 0.0) + max(sum_out[g.i[e]] - odds[e], 0.0)
            m.weight[e] = g.motion[4] * odds[e] / (1 + odds[e] + rivals)
            known += m.weight[e]
        log_birth = np.log(max(1 - known, 1 - g.motion[4]))
        for s in range(ways.out_start[h], ways.out_start[h + 1]):
            e = ways.out[s]
            total, way = _best_way(e, log_birth, g, ways, m)
            _write_state(e, way, g, m)
            odds[e] = np.exp(min(max(total + g.log_odds[e], -LOG_ODDS_MAX), LOG_ODDS_MAX))
            sum_out[h] += odds[e]
            sum_into[g.k[e]] += odds[e]
    return m


@njit(cache=True, nogil=True)
def _best_way(e, log_birth, g, ways, m):  # type: ignore[no-untyped-def]
    """Sum over the ways into link *e*, birth included; returns the log sum and the best way, -1 = birth."""
    h, k = g.i[e], g.k[e]
    dt, x, y = g.t[k] - g.t[h], g.xy[k, 0], g.xy[k, 1]
    best = log_birth + g.log_alone[e] + _log_paint(g, h, k, g.paint[h], g.paint[k], 2.0)
    total, way = best, -1
    for s in range(ways.into_start[h], ways.into_start[h + 1]):
        w = ways.into[s]
        if m.weight[w] < FAINT:
            continue
        term = np.log(m.weight[w]) + _log_place(m.mean[w], m.cov[w], dt, x, y, g.variance[k], g.motion)
        if term < total - BEHIND:
            continue
        term += _log_paint(g, h, k, m.paint[w], g.paint[k], 1 / m.seen[w] + 1)
        total = _log_sum(total, term)
        if term > best:
            best, way = term, w
    return total, way


@njit(cache=True, nogil=True)
def _write_state(e, way, g, m):  # type: ignore[no-untyped-def]
    """Write the state at the far end of link *e* of a vehicle that came by *way*, or was born at the near end."""
    h, k = g.i[e], g.k[e]
    dt, x, y = g.t[k] - g.t[h], g.xy[k, 0], g.xy[k, 1]
    if way < 0:
        mean, cov = np.zeros(4), np.zeros(3)
        mean[0], mean[1] = g.xy[h, 0], g.xy[h, 1]
        cov[0], cov[2] = g.variance[h], g.motion[3] ** 2
        _updated(mean, cov, dt, x, y, g.variance[k], g.motion[0], m.mean[e], m.cov[e])
        m.paint[e], m.seen[e] = 0.5 * (g.paint[h] + g.paint[k]), 2.0
    else:
        _updated(m.mean[way], m.cov[way], dt, x, y, g.variance[k], g.motion[0], m.mean[e], m.cov[e])
        n = min(m.seen[way], g.motion[5])
        m.paint[e], m.seen[e] = (n * m.paint[way] + g.paint[k]) / (n + 1), n + 1


@njit(cache=True, nogil=True)
def _combined(g, ways, past, future):  # type: ignore[no-untyped-def]
    """Log-odds of every link: the sum over ways into its near end and out of its far end, none included on each."""
    gain = np.empty(len(g.i))
    for e in range(len(g.i)):
        i, k = g.i[e], g.k[e]
        no_past, no_future = 1.0, 1.0
        for s in range(ways.into_start[i], ways.into_start[i + 1]):
            no_past -= past.weight[ways.into[s]]
        for s in range(ways.out_start[k], ways.out_start[k + 1]):
            no_future -= future.weight[ways.out[s]]
        no_past, no_future = max(no_past, 1 - g.motion[4]), max(no_future, 1 - g.motion[4])
        total = np.log(no_past * no_future) + g.log_alone[e] + _log_paint(g, i, k, g.paint[i], g.paint[k], 2.0)
        for s in range(ways.into_start[i], ways.into_start[i + 1]):
            a = ways.into[s]
            if past.weight[a] >= FAINT:
                total = _log_sum(total, _by_past(e, a, no_future, g, ways, past, future))
        for s in range(ways.out_start[k], ways.out_start[k + 1]):
            b = ways.out[s]
            if future.weight[b] < FAINT:
                continue
            at = g.xy[i]
            term = np.log(future.weight[b] * no_past) + _log_paint(
                g, i, k, future.paint[b], g.paint[i], 1 / future.seen[b] + 1
            )
            dt = g.t[i] - g.t[k]
            term += _log_place(future.mean[b], future.cov[b], dt, at[0], at[1], g.variance[i], g.motion)
            total = _log_sum(total, term)
        gain[e] = total + g.log_odds[e]
    return gain


@njit(cache=True, nogil=True)
def _by_past(e, a, no_future, g, ways, past, future):  # type: ignore[no-untyped-def]
    """Log-likelihood of link *e* for a vehicle that came by *a*: with no future, or any of the ways on."""
    i, k = g.i[e], g.k[e]
    dt, mean, cov = g.t[k] - g.t[i], past.mean[a], past.cov[a]
    total = np.log(no_future) + _log_place(mean, cov, dt, g.xy[k, 0], g.xy[k, 1], g.variance[k], g.motion)
    total += _log_paint(g, i, k, past.paint[a], g.paint[k], 1 / past.seen[a] + 1)
    for s in range(ways.out_start[k], ways.out_start[k + 1]):
        b = ways.out[s]
        if past.weight[a] * future.weight[b] < FAINT:
            continue
        term = np.log(future.weight[b]) + _log_meet(mean, cov, dt, future.mean[b], future.cov[b], g.motion)
        if term < total - BEHIND:
            continue
        term += _log_paint(g, i, k, past.paint[a], future.paint[b], 1 / past.seen[a] + 1 / future.seen[b])
        total = _log_sum(total, term)
    return np.log(past.weight[a]) + total
