"""The smoother is the least-squares answer, and its errors are what it says."""

import numpy as np
import pytest

from vtrack_batch.tracking.motion import filter_chain, smooth


def drive(seed, q=1.0, sigma=0.4, dt=1.5, steps=40):
    """A vehicle by the filter's own model of motion; returns t, true states and noisy places."""
    rng = np.random.default_rng(seed)
    noise = np.linalg.cholesky(q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
    state = np.zeros((steps, 2, 2))
    state[0, :, 1] = [11.0, -3.0]
    for n in range(1, steps):
        state[n] = state[n - 1] @ [[1, 0], [dt, 1]] + rng.normal(size=(2, 2)) @ noise.T
    places = state[:, :, 0] + rng.normal(0, sigma, (steps, 2))
    return np.arange(steps) * dt, state, places


def smoothed(t, places, seen=None, q=1.0, sigma=0.4):
    seen = np.ones(len(t), bool) if seen is None else seen
    return smooth(np.array([0, len(t)]), t, seen, places, np.full(len(t), sigma), q, 10.0)


def test_errors_are_as_large_as_stated():
    score_place, score_speed = [], []
    for seed in range(60):
        t, state, places = drive(seed)
        mean, cov = smoothed(t, places)
        score_place.append((mean[:, :2] - state[:, :, 0]) ** 2 / cov[:, :1])
        score_speed.append((mean[:, 2:] - state[:, :, 1]) ** 2 / cov[:, 2:])
    assert 0.85 < np.mean(score_place) < 1.15
    assert 0.85 < np.mean(score_speed) < 1.15


def test_smoothing_is_the_same_forward_and_backward_in_time():
    t, _, places = drive(3)
    forward, cov = smoothed(t, places)
    backward, cov_back = smoothed(t[-1] - t[::-1], places[::-1])
    np.testing.assert_allclose(forward[3:-3, :2], backward[::-1][3:-3, :2], atol=0.01)
    np.testing.assert_allclose(forward[3:-3, 2:], -backward[::-1][3:-3, 2:], atol=0.05)
    np.testing.assert_allclose(cov[3:-3, 0], cov_back[::-1][3:-3, 0], rtol=0.01)


def test_unseen_points_are_interpolated_and_less_certain():
    t, state, places = drive(4)
    seen = np.ones(len(t), bool)
    seen[[10, 11, 25]] = False
    mean, cov = smoothed(t, np.where(seen[:, None], places, 1e6), seen)
    assert np.abs(mean[:, :2] - state[:, :, 0]).max() < 5
    assert cov[10, 0] > 2 * cov[20, 0]


def test_tracks_side_by_side_do_not_mix():
    t, _, places = drive(5)
    alone, _ = smoothed(t, places)
    first = np.array([0, len(t), 2 * len(t)])
    both, _ = smooth(
        first,
        np.tile(t, 2),
        np.ones(2 * len(t), bool),
        np.vstack([places, 9 - places]),
        np.full(2 * len(t), 0.4),
        1.0,
        10.0,
    )
    np.testing.assert_array_equal(both[: len(t)], alone)


@pytest.mark.parametrize("sense", [1, -1])
def test_filtering_along_a_chain_finds_the_speed_from_either_end(sense):
    t = np.arange(12) * 1.5
    places = np.column_stack([13.0 * t, -4.0 * t + 2])
    linked = np.arange(12) - 1 if sense > 0 else np.where(np.arange(12) < 11, np.arange(12) + 1, -1)
    states = filter_chain(linked, t, places, np.full(12, 0.4), 1.0, 10.0)
    end = 11 if sense > 0 else 0
    np.testing.assert_allclose(states.mean[end, 2:], [13.0, -4.0], atol=0.05)
    assert states.count[end] == 12
    assert states.moving.sum() == 11
