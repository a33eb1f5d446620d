"""The one-to-one decision is the best there is; argmax and mutual choice do what their names say."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from vtrack_batch.matching.candidates import Edges
from vtrack_batch.matching.decision import argmax, assign, mutual, one_to_one
from vtrack_batch.matching.relaxation import Labels


@pytest.mark.parametrize("rounded", [False, True])
def test_assignment_equals_the_dense_optimum(rounded):
    rng = np.random.default_rng(5)
    for _ in range(150):
        n, m = rng.integers(1, 12, 2)
        worth = np.round(rng.normal(0, 3, (n, m)), 0 if rounded else 6)
        i, k = np.nonzero(rng.random((n, m)) < 0.6)
        picked = assign(i, k, worth[i, k])
        full = np.zeros((n, m + n))
        full[i, k] = np.maximum(worth[i, k], 0)
        best = full[linear_sum_assignment(-full)].sum()
        assert worth[i, k][picked].sum() == pytest.approx(best, abs=1e-9)
        assert len(set(i[picked])) == len(set(k[picked])) == picked.sum()


def test_a_chain_of_rivals_is_solved_as_a_whole():
    # greedy would take (1, 1) at 5 and lose the sum 4 + 4
    picked = assign(np.array([0, 1, 1]), np.array([1, 1, 2]), np.array([4.0, 5.0, 4.0]))
    assert picked.tolist() == [True, False, True]


def test_nothing_worthless_is_picked():
    assert not assign(np.array([0, 1]), np.array([0, 1]), np.array([0.0, -1.0])).any()
    assert not assign(np.zeros(0, int), np.zeros(0, int), np.zeros(0)).any()


def contested():
    """Vehicles 0 and 1 both prefer 0 of the later image; 0 of the later image prefers 1."""
    edges = Edges(2, 2, np.array([0, 0, 1]), np.array([0, 1, 0]), np.zeros((3, 2)))
    labels = Labels(np.array([0.6, 0.3, 0.8]), np.array([0.3, 0.9, 0.6]), np.array([0.1, 0.2]), np.array([0.1, 0.1]))
    return edges, labels


def test_argmax_lets_two_pick_the_same():
    assert argmax(*contested()).tolist() == [True, False, True]


def test_mutual_choice_keeps_the_pair_that_agrees():
    assert mutual(*contested()).tolist() == [False, False, True]


def test_one_to_one_serves_both():
    assert one_to_one(*contested()).tolist() == [False, True, True]


def test_ties_with_no_match_go_to_no_match():
    edges = Edges(1, 1, np.array([0]), np.array([0]), np.zeros((1, 2)))
    half = np.array([0.5])
    assert not argmax(edges, Labels(half, half, half, half)).any()
