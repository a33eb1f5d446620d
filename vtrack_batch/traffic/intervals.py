"""95 % intervals of counts and shares that are made of uncertain vehicles."""

from __future__ import annotations

import numpy as np
from numba import njit

from vtrack_batch.traffic.paths import Floats, Ints

_Z = 1.959963984540054


def count_intervals(probability: Floats, group: Ints, groups: int) -> tuple[Floats, Floats]:
    """Return the 2.5 % and 97.5 % quantiles (groups,) of the number of vehicles in each group.

    Each vehicle (n,) belongs to its *group* with its *probability*, independently: the number follows the
    Poisson-binomial law (Wang 1993), computed exactly by convolution.
    """
    order = np.lexsort((probability, group))
    border = np.searchsorted(group[order], np.arange(groups + 1))
    lo, hi = np.zeros(groups), np.zeros(groups)
    _quantiles(np.clip(probability[order], 0.0, 1.0), border, lo, hi)
    return lo, hi


def wilson_intervals(successes: Floats, trials: Floats) -> tuple[Floats, Floats]:
    """Return the ends of the 95 % Wilson score interval (Wilson 1927) of a share; NaN where there were no trials."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = successes / trials
        centre = (share + _Z**2 / (2 * trials)) / (1 + _Z**2 / trials)
        half = _Z * np.sqrt(share * (1 - share) / trials + _Z**2 / (4 * trials**2)) / (1 + _Z**2 / trials)
        lo, hi = np.clip(centre - half, 0.0, share), np.clip(centre + half, share, 1.0)
    return np.where(trials > 0, lo, np.nan), np.where(trials > 0, hi, np.nan)


@njit(cache=True, nogil=True)
def _quantiles(probability, border, lo, hi):  # type: ignore[no-untyped-def]
    """Fill *lo*, *hi* with the smallest numbers whose cumulative probability reaches 2.5 % and 97.5 %."""
    for g in range(len(lo)):
        p = probability[border[g] : border[g + 1]]
        law = np.zeros(len(p) + 1)
        law[0] = 1.0
        for k in range(len(p)):
            for j in range(k + 1, 0, -1):
                law[j] = law[j] * (1.0 - p[k]) + law[j - 1] * p[k]
            law[0] *= 1.0 - p[k]
        below, lo[g], hi[g] = 0.0, -1.0, float(len(p))
        for j in range(len(p) + 1):
            below += law[j]
            if lo[g] < 0.0 and below >= 0.025:
                lo[g] = j
            if below >= 0.975:
                hi[g] = j
                break
