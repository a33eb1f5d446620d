"""Constant-velocity Kalman filters along chains of sightings, forward and backward, by real time steps.

State per axis: position and velocity; noise is the same on both axes, so both share one covariance (pp, pv, vv).
White-noise acceleration of spectral density q (Bar-Shalom, Li & Kirubarajan 2001, section 6.2.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.tracking.sightings import Array, Index


@dataclass(frozen=True)
class States:
    """Filtered states at every sighting: ``mean`` (n, 4) x, y, vx, vy; ``cov`` (n, 3) pp, pv, vv; ``count`` (n,).

    ``count`` is the number of sightings that went into a state; with one the velocity is still the prior.
    """

    mean: Array
    cov: Array
    count: Index

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Whether the velocity is known."""
        return self.count > 1


def filter_chain(linked: Index, t: Array, xy: Array, sigma: Array, q: float, speed_sigma: float) -> States:
    """Filter along chains: *linked* (n,) is the sighting that comes before each one, or -1; *t* (n,) seconds.

    With the sightings that come after, in place of those before, this is the backward filter: time steps are negative,
    velocities keep their sense.
    """
    order = np.argsort(t, kind="stable")
    if (t[linked[linked >= 0]] > t[linked >= 0]).any():
        order = order[::-1].copy()
    return States(*_filter(order, linked, t, xy, sigma, q, speed_sigma))


@njit(cache=True, nogil=True)
def _filter(order, linked, t, xy, sigma, q, speed_sigma):  # type: ignore[no-untyped-def]
    n = len(linked)
    mean, cov, count = np.zeros((n, 4)), np.zeros((n, 3)), np.ones(n, np.int64)
    for i in order:
        r = sigma[i] ** 2
        b = linked[i]
        if b < 0:
            mean[i, 0], mean[i, 1] = xy[i, 0], xy[i, 1]
            cov[i, 0], cov[i, 2] = r, speed_sigma**2
            continue
        dt = t[i] - t[b]
        h = abs(dt)
        pp = cov[b, 0] + 2 * dt * cov[b, 1] + dt * dt * cov[b, 2] + q * h**3 / 3
        pv = cov[b, 1] + dt * cov[b, 2] + q * h * dt / 2
        vv = cov[b, 2] + q * h
        s = pp + r
        for c in range(2):
            x = mean[b, c] + dt * mean[b, c + 2]
            residual = xy[i, c] - x
            mean[i, c] = x + pp / s * residual
            mean[i, c + 2] = mean[b, c + 2] + pv / s * residual
        cov[i, 0] = pp - pp * pp / s
        cov[i, 1] = pv - pp * pv / s
        cov[i, 2] = vv - pv * pv / s
        count[i] = count[b] + 1
    return mean, cov, count


@njit(cache=True, nogil=True)
def smooth(first, t, seen, xy, sigma, q, speed_sigma):  # type: ignore[no-untyped-def]
    """Smooth many tracks at once (Rauch, Tung & Striebel 1965): forward filter, then backward pass.

    Points of track k are rows first[k] ... first[k + 1] - 1 of *t* (n,), *seen* (n,) bool, *xy* (n, 2), *sigma* (n,).
    Returns means (n, 4) and covariances (n, 3) as in ``States``; unseen points are interpolated.
    """
    n = len(t)
    mean, cov = np.zeros((n, 4)), np.zeros((n, 3))
    ahead, ahead_cov = np.zeros((n, 4)), np.zeros((n, 3))
    for k in range(len(first) - 1):
        a, b = first[k], first[k + 1]
        for i in range(a, b):
            if i == a:
                mean[i, 0], mean[i, 1] = xy[i, 0], xy[i, 1]
                cov[i, 0], cov[i, 2] = sigma[i] ** 2, speed_sigma**2
                continue
            h = t[i] - t[i - 1]
            pp = cov[i - 1, 0] + 2 * h * cov[i - 1, 1] + h * h * cov[i - 1, 2] + q * h**3 / 3
            pv = cov[i - 1, 1] + h * cov[i - 1, 2] + q * h * h / 2
            vv = cov[i - 1, 2] + q * h
            ahead_cov[i, 0], ahead_cov[i, 1], ahead_cov[i, 2] = pp, pv, vv
            s = pp + sigma[i] ** 2
            for c in range(2):
                ahead[i, c] = mean[i - 1, c] + h * mean[i - 1, c + 2]
                ahead[i, c + 2] = mean[i - 1, c + 2]
                residual = xy[i, c] - ahead[i, c] if seen[i] else 0.0
                mean[i, c] = ahead[i, c] + pp / s * residual
                mean[i, c + 2] = ahead[i, c + 2] + pv / s * residual
            gain = 1.0 if seen[i] else 0.0
            cov[i, 0] = pp - gain * pp * pp / s
            cov[i, 1] = pv - gain * pp * pv / s
            cov[i, 2] = vv - gain * pv * pv / s
        for i in range(b - 2, a - 1, -1):
            h = t[i + 1] - t[i]
            pp, pv, vv = ahead_cov[i + 1, 0], ahead_cov[i + 1, 1], ahead_cov[i + 1, 2]
            det = pp * vv - pv * pv
            # gain = P F' (P ahead)^-1 with F = [[1, h], [0, 1]]
            m00, m01 = cov[i, 0] + h * cov[i, 1], cov[i, 1]
            m10, m11 = cov[i, 1] + h * cov[i, 2], cov[i, 2]
            g00, g01 = (m00 * vv - m01 * pv) / det, (m01 * pp - m00 * pv) / det
            g10, g11 = (m10 * vv - m11 * pv) / det, (m11 * pp - m10 * pv) / det
            for c in range(2):
                dx, dv = mean[i + 1, c] - ahead[i + 1, c], mean[i + 1, c + 2] - ahead[i + 1, c + 2]
                mean[i, c] += g00 * dx + g01 * dv
                mean[i, c + 2] += g10 * dx + g11 * dv
            epp, epv, evv = cov[i + 1, 0] - pp, cov[i + 1, 1] - pv, cov[i + 1, 2] - vv
            a0, a1 = g00 * epp + g01 * epv, g00 * epv + g01 * evv
            b0, b1 = g10 * epp + g11 * epv, g10 * epv + g11 * evv
            cov[i, 0] += a0 * g00 + a1 * g01
            cov[i, 1] += a0 * g10 + a1 * g11
            cov[i, 2] += b0 * g10 + b1 * g11
    return mean, cov
