"""Intervals of uncertain counts and shares."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from vtrack_batch.traffic.intervals import count_intervals, wilson_intervals


@settings(deadline=None)
@given(st.integers(1, 60), st.floats(0.01, 0.99))
def test_equal_probabilities_give_the_binomial_law(n, p):
    lo, hi = count_intervals(np.full(n, p), np.zeros(n, np.int64), 1)
    law = stats.binom(n, p)
    assert law.cdf(lo[0]) >= 0.025 - 1e-9
    assert lo[0] == 0 or law.cdf(lo[0] - 1) < 0.025 + 1e-9
    assert law.cdf(hi[0]) >= 0.975 - 1e-9
    assert hi[0] == 0 or law.cdf(hi[0] - 1) < 0.975 + 1e-9


def test_groups_are_apart_and_certain_vehicles_are_certain():
    group = np.array([2, 0, 2, 0, 2])
    lo, hi = count_intervals(np.array([1.0, 1.0, 0.0, 1.0, 0.5]), group, 4)
    assert lo.tolist() == [2, 0, 1, 0]
    assert hi.tolist() == [2, 0, 2, 0]


@pytest.mark.parametrize(("successes", "trials"), [(0, 10), (10, 10), (3, 4), (7.4, 20.2)])
def test_wilson_interval_solves_its_defining_equation(successes, trials):
    share = successes / trials
    for end in wilson_intervals(np.array([successes]), np.array([trials])):
        assert abs(end[0] - share) <= 1.959964 * np.sqrt(end[0] * (1 - end[0]) / trials) + 1e-6


def test_no_trials_no_interval():
    assert np.isnan(wilson_intervals(np.zeros(1), np.zeros(1))).all()
