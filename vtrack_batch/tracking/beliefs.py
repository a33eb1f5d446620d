"""What past and future say about every possible link: messages along the graph of links, forward and backward.

Every possible link e = (h, i) carries the state (position, velocity, mean colour) that a vehicle would have which came
that way. The belief in a link (i, k) is a mixture over the ways into i and the ways out of k, each weighted by what its
own past (or future) makes of it: wrong links beside it do not blind it, as they would if the past were one chain.
A link's message never holds the link itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from vtrack_batch.matching.colour import log_same_paint
from vtrack_batch.tracking.sightings import Array, Index

FAINT = 1e-3  # ways less likely than this are left out
LOG_ODDS_MAX = 30.0


@dataclass(frozen=True)
class Graph:
    """Sightings and the possible links between them.

    ``i``, ``k`` (e,) int64; ``log_alone`` (e,) log density (1/m2) of the displacement when nothing is known of the motion
    on either side; ``log_odds`` (e,) all of a link's log-odds but motion and colour. Sightings: ``t`` (n,) s, ``xy`` (n, 2)
    m, ``variance`` (n,) m2, ``paint`` (n, 3) in opponent axes, ``log_paint`` (n,) its log density; ``noise`` of colours,
    empty = no colour; ``motion``: q, factor and share of rough driving, sigma of unknown speed, most trust in a way.
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


@dataclass(frozen=True)
class Messages:
    """State and weight of every link as the way into (or, backward, out of) its far sighting."""

    weight: Array
    mean: Array
    cov: Array
    paint: Array
    count: Array


def link_gains(g: Graph) -> Array:
    """Return the log-odds (e,) of every possible link, by the past, the future, motion and colour."""
    n = len(g.t)
    into_start, into = _grouped(g.k, n)
    out_start, out = _grouped(g.i, n)
    order = np.argsort(g.t, kind="stable")
    past = Messages(*_messages(order, g.i, g.k, into_start, into, out_start, out, *_fields(g)))
    future = Messages(*_messages(order[::-1].copy(), g.k, g.i, out_start, out, into_start, into, *_fields(g)))
    return np.asarray(
        _combined(
            g.i, g.k, into_start, into, out_start, out, *_fields(g),
            past.weight, past.mean, past.cov, past.paint, past.count,
            future.weight, future.mean, future.cov, future.paint, future.count,
        )
    )  # fmt: skip


def _fields(g: Graph) -> tuple[Array, ...]:
    return g.log_alone, g.log_odds, g.t, g.xy, g.variance, g.paint, g.log_paint, g.noise, g.motion


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
    total = -np.inf
    for rough in range(2):
        q = motion[0] * (motion[1] if rough else 1.0)
        s = _grown(cov, dt, q)[0] + variance
        share = motion[2] if rough else 1 - motion[2]
        total = _log_sum(total, np.log(share) - 0.5 * (dx * dx + dy * dy) / s - np.log(2 * np.pi * s))
    return total


@njit(cache=True, nogil=True)
def _log_meet(mean, cov, dt, later, later_cov, motion):  # type: ignore[no-untyped-def]
    """Log density ratio of a past and a future state being one vehicle's; the velocity's prior stands in both once."""
    dx, dy = later[0] - mean[0] - dt * mean[2], later[1] - mean[1] - dt * mean[3]
    du, dv = later[2] - mean[2], later[3] - mean[3]
    total = -np.inf
    for rough in range(2):
        pp, pv, vv = _grown(cov, dt, motion[0] * (motion[1] if rough else 1.0))
        pp, pv, vv = pp + later_cov[0], pv + later_cov[1], vv + later_cov[2]
        det = max(pp * vv - pv * pv, 1e-12)
        z = (vv * (dx * dx + dy * dy) - 2 * pv * (dx * du + dy * dv) + pp * (du * du + dv * dv)) / det
        share = motion[2] if rough else 1 - motion[2]
        total = _log_sum(total, np.log(share) - 0.5 * z - np.log(det) - 2 * np.log(2 * np.pi))
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
def _messages(
    order,
    near,
    far,
    into_start,
    into,
    out_start,
    out,
    log_alone,
    log_odds,
    t,
    xy,
    variance,
    paint,
    log_paint,
    noise,
    motion,
):  # type: ignore[no-untyped-def]  # noqa: E501
    n_links = len(near)
    weight, odds = np.zeros(n_links), np.zeros(n_links)
    mean, cov = np.zeros((n_links, 4)), np.zeros((n_links, 3))
    colour, count = np.zeros((n_links, 3)), np.ones(n_links)
    sum_into, sum_out = np.zeros(len(t)), np.zeros(len(t))
    start_mean, start_cov = np.zeros(4), np.zeros(3)
    start_cov[2] = motion[3] ** 2
    for h in order:
        known = 0.0
        for s in range(into_start[h], into_start[h + 1]):
            e = into[s]
            rivals = max(sum_into[h] - odds[e], 0.0) + max(sum_out[near[e]] - odds[e], 0.0)
            weight[e] = motion[4] * odds[e] / (1 + odds[e] + rivals)
            known += weight[e]
        log_birth = np.log(max(1 - known, 1 - motion[4]))
        start_mean[0], start_mean[1], start_cov[0] = xy[h, 0], xy[h, 1], variance[h]
        for s in range(out_start[h], out_start[h + 1]):
            e = out[s]
            k, dt = far[e], t[far[e]] - t[h]
            log_random = 0.5 * (log_paint[h] + log_paint[k])
            best = log_birth + log_alone[e]
            if len(noise):
                best += log_same_paint(paint[h], paint[k], 2.0, log_random, noise)
            total, best_way = best, -1
            for r in range(into_start[h], into_start[h + 1]):
                w = into[r]
                if weight[w] < FAINT:
                    continue
                term = np.log(weight[w]) + _log_place(mean[w], cov[w], dt, xy[k, 0], xy[k, 1], variance[k], motion)
                if len(noise):
                    term += log_same_paint(colour[w], paint[k], 1 / count[w] + 1, log_random, noise)
                total = _log_sum(total, term)
                if term > best:
                    best, best_way = term, w
            odds[e] = np.exp(min(max(total + log_odds[e], -LOG_ODDS_MAX), LOG_ODDS_MAX))
            sum_out[h] += odds[e]
            sum_into[k] += odds[e]
            if best_way < 0:
                _updated(start_mean, start_cov, dt, xy[k, 0], xy[k, 1], variance[k], motion[0], mean[e], cov[e])
                colour[e], count[e] = 0.5 * (paint[h] + paint[k]), 2.0
            else:
                w, n = best_way, min(count[best_way], motion[5])
                _updated(mean[w], cov[w], dt, xy[k, 0], xy[k, 1], variance[k], motion[0], mean[e], cov[e])
                colour[e], count[e] = (n * colour[w] + paint[k]) / (n + 1), n + 1
    return weight, mean, cov, colour, count


@njit(cache=True, nogil=True)
def _combined(
    near,
    far,
    into_start,
    into,
    out_start,
    out,
    log_alone,
    log_odds,
    t,
    xy,
    variance,
    paint,
    log_paint,
    noise,
    motion,
    p_weight,
    p_mean,
    p_cov,
    p_paint,
    p_count,
    f_weight,
    f_mean,
    f_cov,
    f_paint,
    f_count,
):  # type: ignore[no-untyped-def]  # noqa: E501
    gain = np.empty(len(near))
    for e in range(len(near)):
        i, k = near[e], far[e]
        dt = t[k] - t[i]
        log_random = 0.5 * (log_paint[i] + log_paint[k])
        no_past, no_future = 1.0, 1.0
        for r in range(into_start[i], into_start[i + 1]):
            no_past -= p_weight[into[r]]
        for r in range(out_start[k], out_start[k + 1]):
            no_future -= f_weight[out[r]]
        log_no_past, log_no_future = np.log(max(no_past, 1 - motion[4])), np.log(max(no_future, 1 - motion[4]))
        total = log_no_past + log_no_future + log_alone[e]
        if len(noise):
            total += log_same_paint(paint[i], paint[k], 2.0, log_random, noise)
        for r in range(into_start[i], into_start[i + 1]):
            a = into[r]
            if p_weight[a] < FAINT:
                continue
            log_a = np.log(p_weight[a])
            term = log_a + log_no_future + _log_place(p_mean[a], p_cov[a], dt, xy[k, 0], xy[k, 1], variance[k], motion)
            if len(noise):
                term += log_same_paint(p_paint[a], paint[k], 1 / p_count[a] + 1, log_random, noise)
            total = _log_sum(total, term)
            for q in range(out_start[k], out_start[k + 1]):
                b = out[q]
                if p_weight[a] * f_weight[b] < FAINT:
                    continue
                term = log_a + np.log(f_weight[b]) + _log_meet(p_mean[a], p_cov[a], dt, f_mean[b], f_cov[b], motion)
                if len(noise):
                    spread = 1 / p_count[a] + 1 / f_count[b]
                    term += log_same_paint(p_paint[a], f_paint[b], spread, log_random, noise)
                total = _log_sum(total, term)
        for q in range(out_start[k], out_start[k + 1]):
            b = out[q]
            if f_weight[b] < FAINT:
                continue
            term = np.log(f_weight[b]) + log_no_past
            term += _log_place(f_mean[b], f_cov[b], -dt, xy[i, 0], xy[i, 1], variance[i], motion)
            if len(noise):
                term += log_same_paint(f_paint[b], paint[i], 1 / f_count[b] + 1, log_random, noise)
            total = _log_sum(total, term)
        gain[e] = total + log_odds[e]
    return gain
