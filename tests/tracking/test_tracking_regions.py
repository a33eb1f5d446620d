"""Region tracking at film rates: every vehicle counted once; filters of constant jerk; gross errors clamped."""

import numpy as np
import pandas as pd
import pytest
from tracking_worlds import labels, street, times, utc

from vtrack_batch.tracking.params import RegionTrackParams, TrackingParams
from vtrack_batch.tracking.regions import MasterList, clamped, motion_model, predicted
from vtrack_batch.tracking.track import track

FEW = TrackingParams(min_sightings=5)


def stop_and_go(seed, *, missed=0.1, velocity=True, noise_m=0.33):
    """One lane of an oblong street at 10 Hz for 30 s: a platoon brakes to a stop line, waits and drives on."""
    rng = np.random.default_rng(seed)
    t, count = np.arange(300) * 0.1, 9
    speed = np.interp(t, [0, 5, 9, 16, 22, 30], [13, 13, 0, 0, 12, 13])
    lead = 40 + np.concatenate([[0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.1)])
    rows = []
    for n in range(count):
        x = np.interp(t - 0.9 * n, t, lead, left=np.nan) - 8.0 * n
        early = np.isnan(x)
        x[early] = lead[0] - 8.0 * n + 13 * (t - 0.9 * n)[early]
        seen = (x > 0) & (x < 200) & (rng.random(len(t)) >= missed)
        vx = np.gradient(x, 0.1)
        rows.append(pd.DataFrame({"t": t[seen], "x_m": x[seen], "y_m": -3.0, "vx_mps": vx[seen], "truth": n}))
    table = pd.concat(rows, ignore_index=True)
    table[["x_m", "y_m"]] += rng.normal(0, noise_m, (len(table), 2))
    table["vx_mps"] += rng.normal(0, 0.8, len(table))
    table["vy_mps"] = rng.normal(0, 0.8, len(table))
    grey = rng.uniform(40, 220, count)[table["truth"]]
    table["red"] = table["green"] = table["blue"] = np.clip(grey + rng.normal(0, 5, len(table)), 0, 255)
    table["t_utc"], table["speed"] = times(table["t"]), table["vx_mps"].abs()
    table["detection_id"] = rng.permutation(len(table))
    return utc(table if velocity else table.drop(columns=["vx_mps", "vy_mps"]))


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_platoon_at_a_signal_is_counted_vehicle_by_vehicle(seed, velocity):
    world = stop_and_go(seed, velocity=velocity)
    tracks = track(world, method="regions", params=FEW)
    found = labels(tracks, world)
    assert (found.groupby("vehicle_id")["truth"].nunique() == 1).all()
    assert found["truth"].nunique() == 9
    assert len(tracks.trajectories) <= 9 * 1.05
    assert (tracks.matches["method"] == "regions").all()


@pytest.mark.parametrize("interval_s", [0.1, 0.25, 0.5])
def test_two_streams_at_film_rates(interval_s):
    world = utc(street(interval_s, frames=int(40 / interval_s), missed=0.1))
    tracks = track(world, method="regions", params=FEW)
    found = labels(tracks, world)
    assert (found.groupby("vehicle_id")["truth"].nunique() == 1).all()
    assert 16 == world["truth"].nunique() == len(tracks.trajectories)


def test_regions_leave_the_list_after_several_misses_and_come_back_as_new():
    world = stop_and_go(4, missed=0.0)
    away = (world["truth"] == 3) & (world["t_utc"] - world["t_utc"].min()).dt.total_seconds().between(3.0, 4.0)
    split = labels(track(world[~away], method="regions", params=FEW), world)
    assert split.groupby("truth")["vehicle_id"].nunique().to_dict() == {n: 2 if n == 3 else 1 for n in range(9)}
    patient = TrackingParams(min_sightings=5, regions=RegionTrackParams(forget_s=1.5))
    whole = labels(track(world[~away], method="regions", params=patient), world)
    assert (whole.groupby("truth")["vehicle_id"].nunique() == 1).all()


def test_rows_in_any_order_and_false_alarms():
    world = stop_and_go(5)
    rng = np.random.default_rng(0)
    noise = world.sample(40, random_state=1).assign(
        detection_id=10**6 + np.arange(40), truth=-1, x_m=rng.uniform(0, 200, 40), y_m=rng.uniform(-60, 60, 40)
    )
    world = pd.concat([world, noise], ignore_index=True)
    one = track(world, method="regions")
    two = track(world.sample(frac=1, random_state=3), method="regions")
    for name in ("track_points", "trajectories", "matches"):
        pd.testing.assert_frame_equal(getattr(one, name), getattr(two, name))
    of_truth = labels(one, world).query("truth >= 0").groupby("truth")["vehicle_id"].nunique()
    assert of_truth.mean() <= 1.2


def test_constant_jerk_is_predicted_exactly():
    x0, v, a, c, dt = 3.0, 11.0, -2.0, 0.7, 1.7
    listed = MasterList(
        np.array([[[x0, v, a, c], [0.0, 0, 0, 0]]]),
        np.zeros((1, 4, 4)),
        np.zeros(1, int),
        np.zeros(1),
        np.zeros(1, int),
    )
    after = predicted(listed, dt, RegionTrackParams()).mean[0, 0]
    want = [x0 + v * dt + a * dt**2 / 2 + c * dt**3 / 6, v + a * dt + c * dt**2 / 2, a + c * dt, c]
    np.testing.assert_allclose(after, want, rtol=1e-12)
    one_second, _ = motion_model(1.0, 1.0)
    np.testing.assert_allclose(one_second, [[1, 1, 0.5, 1 / 6], [0, 1, 1, 0.5], [0, 0, 1, 1], [0, 0, 0, 1]])


def test_noise_of_two_short_steps_is_that_of_a_long_one():
    half, q_half = motion_model(0.4, 2.0)
    whole, q_whole = motion_model(0.8, 2.0)
    np.testing.assert_allclose(half @ half, whole, rtol=1e-12)
    np.testing.assert_allclose(half @ q_half @ half.T + q_half, q_whole, rtol=1e-10)
    assert (np.linalg.eigvalsh(q_whole) > 0).all()


def test_gross_errors_are_drawn_to_the_bound_and_never_pushed_out():
    at, sigma = np.array([10.0, 10.0, 10.0]), np.array([0.5, 0.5, 0.5])
    assert clamped(np.array([4.0, 10.7, 19.0]), at, sigma, 2.0).tolist() == [9.0, 10.7, 11.0]
