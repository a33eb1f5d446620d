"""Weights follow the Lagrange condition; regions find the most similar one, whichever feature tells them apart."""

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize

from vtrack_batch.matching.candidates import candidates
from vtrack_batch.matching.match import match
from vtrack_batch.matching.params import MatchingParams, RegionParams
from vtrack_batch.matching.regions import Features, expected, features_of, lagrange_weights, region_labels


@pytest.mark.parametrize("spread", [[4.0, 1.0, 0.25], [1e-3, 7.0, 90.0, 2.0, 3.0]])
def test_weights_minimise_the_sum_while_their_product_is_one(spread):
    spread = np.array(spread)
    weights = lagrange_weights(spread)
    assert np.prod(weights) == pytest.approx(1, abs=1e-9)
    np.testing.assert_allclose(weights * spread, (weights * spread)[0])  # every feature brings the same share
    free = minimize(lambda u: (np.exp(np.append(u, -u.sum())) * spread).sum(), np.zeros(len(spread) - 1), tol=1e-14)
    assert (weights * spread).sum() == pytest.approx(free.fun, rel=1e-5)


def image(xy, grey=None, velocity=None, first_id=0):
    table = pd.DataFrame({"detection_id": first_id + np.arange(len(xy)), "x_m": xy[:, 0], "y_m": xy[:, 1]})
    if grey is not None:
        table[["red", "green", "blue"]] = np.tile(grey, (3, 1)).T
    if velocity is not None:
        table[["vx_mps", "vy_mps"]] = velocity
    return table


def links(found):
    both = found.dropna(subset=["detection_id_from", "detection_id_to"])
    return dict(zip(both["detection_id_from"], both["detection_id_to"], strict=True))


def platoon(count, gap_m=8.0, seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack([np.arange(count) * gap_m, 3.0 + rng.normal(0, 0.2, count)]), rng


def test_measured_velocity_carries_vehicles_past_their_neighbours_old_places():
    xy, rng = platoon(12)
    moved = xy + np.array([12.0, 0.0]) + rng.normal(0, 0.3, xy.shape)
    velocity = np.tile([24.0, 0.0], (12, 1)) + rng.normal(0, 0.5, (12, 2))
    want = {i: 100 + i for i in range(12)}
    fast = match(image(xy, velocity=velocity), image(moved, first_id=100), elapsed_s=0.5, method="regions")
    assert links(fast) == want
    still = match(image(xy), image(moved, first_id=100), elapsed_s=0.5, method="regions")
    assert sum(links(still).get(i) == k for i, k in want.items()) < 6


def test_grey_tells_apart_what_place_cannot():
    xy, _ = platoon(10, gap_m=4.0)
    grey = np.array([30, 220] * 5)
    moved = xy + np.array([2.4, 0.0])
    found = links(match(image(xy, grey), image(moved, grey, first_id=100), elapsed_s=0.2, method="regions"))
    assert found == {i: 100 + i for i in range(10)}


def test_two_regions_never_take_one():
    found = match(image(np.array([[0.0, 0], [3.0, 0]])), image(np.array([[2.0, 0]]), first_id=9), elapsed_s=0.2,
                  method="regions")  # fmt: skip
    assert links(found) == {1: 9}
    assert len(found) == 2
    assert found["probability"].between(0, 1).all()


def test_equal_features_do_not_take_over():
    """The heights agree exactly: floored, they weigh no more than noise of position lets them."""
    xy, _ = platoon(8)
    xy[:, 1] = 3.0
    edges = candidates(xy, xy + np.array([1.0, 0.0]), 30.0)
    params = RegionParams()
    features = Features(features_of(xy, None, None), *expected(2.0, 10.0, params))
    labels = region_labels(edges, features, features_of(xy + np.array([1.0, 0.0]), None, None), params)
    assert np.isfinite(labels.p).all()
    own = edges.i == edges.k
    assert (labels.p[own] > 0.5).all()


def test_velocities_may_be_missing_for_some_or_all():
    xy, _ = platoon(9)
    velocity = np.tile([4.0, 0.0], (9, 1))
    moved = xy + np.array([2.0, 0.0])
    want = {i: 100 + i for i in range(9)}
    velocity[2:4] = np.nan
    assert (
        links(match(image(xy, velocity=velocity), image(moved, first_id=100), elapsed_s=0.5, method="regions")) == want
    )
    none = image(xy).assign(vx_mps=None, vy_mps=None)
    assert links(match(none, image(moved, first_id=100), elapsed_s=0.5, method="regions")) == want


def test_constants_are_those_given():
    xy, _ = platoon(5, gap_m=30.0)
    moved = xy + np.array([6.0, 0.0])
    params = MatchingParams(regions=RegionParams(start_speed_mps=1.0, cutoff_sigmas=1.0, rounds=1))
    assert len(links(match(image(xy), image(moved, first_id=100), elapsed_s=0.5, method="regions"))) == 5
    strict = MatchingParams(regions=RegionParams(start_speed_mps=0.1, position_floor_m=0.1, cutoff_sigmas=0.1))
    assert len(links(match(image(xy), image(moved, first_id=100), elapsed_s=0.5, method="regions", params=params))) == 5
    assert not links(match(image(xy), image(moved, first_id=100), elapsed_s=0.5, method="regions", params=strict))
