"""The best one-to-one pairing, found in groups, is the one that the whole matrix gives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from vtrack_batch.evaluation.assignment import best_pairs, near_pairs


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 9), st.floats(0.05, 1.0))
def test_groups_give_the_same_total_as_the_whole_matrix(seed: int, rows: int, columns: int, density: float) -> None:
    rng = np.random.default_rng(seed)
    gain = np.where(rng.random((rows, columns)) < density, rng.uniform(0.1, 5, (rows, columns)), 0.0)
    i, j = np.nonzero(gain)
    best = best_pairs(i, j, gain[i, j])
    assert len(set(i[best])) == len(best) == len(set(j[best]))
    assert gain[i, j][best].sum() == pytest.approx(gain[linear_sum_assignment(-gain)].sum())


@given(st.integers(0, 2**32 - 1), st.integers(0, 30), st.integers(0, 30))
def test_near_pairs_are_all_pairs_of_one_frame_within_reach(seed: int, a: int, b: int) -> None:
    rng = np.random.default_rng(seed)
    frames = rng.integers(0, 4, a), rng.integers(0, 4, b)
    places = rng.uniform(0, 40, (a, 2)), rng.uniform(0, 40, (b, 2))
    i, j, distance = near_pairs((frames[0], places[0]), (frames[1], places[1]), 12.0)
    far = np.hypot(*(places[0][:, None] - places[1][None]).transpose(2, 0, 1))
    expected = (far <= 12.0) & (frames[0][:, None] == frames[1][None])
    assert sorted(zip(i, j, strict=True)) == sorted(zip(*np.nonzero(expected), strict=True))
    np.testing.assert_allclose(distance, far[i, j])


def test_no_pairs_give_no_pairing() -> None:
    nothing = np.empty(0, np.int64)
    assert len(best_pairs(nothing, nothing, np.empty(0))) == 0
