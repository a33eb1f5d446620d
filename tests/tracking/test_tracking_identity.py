"""A path is as sure as its weakest link, and what is stated of links keeps their order."""

import numpy as np
import pandas as pd

from vtrack_batch.tracking.identity import calibrated, identity_probability
from vtrack_batch.tracking.link import Chains
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.tracking.paths import paths_of
from vtrack_batch.tracking.sightings import read_detections, sightings_of
from vtrack_batch.tracking.track import track


def street(frames=8, count=5):
    """Vehicles 40 m apart, 12 m/s eastward."""
    rng = np.random.default_rng(2)
    t, vehicle = np.divmod(np.arange(frames * count), count)
    xy = np.column_stack([40.0 * vehicle + 12.0 * t, -3.0 * (vehicle % 2)]) + rng.normal(0, 0.2, (len(t), 2))
    paint = np.array([[230, 230, 230], [20, 20, 20], [150, 30, 30], [40, 70, 140], [120, 120, 120]])[vehicle % 5]
    times = pd.Timestamp("2026-05-01T10:00Z") + pd.to_timedelta(t, unit="s")
    columns = {"detection_id": np.arange(len(t)), "t_utc": times, "x_m": xy[:, 0], "y_m": xy[:, 1]}
    return pd.DataFrame(columns | dict(zip(("red", "green", "blue"), paint.T, strict=True)))


def chains_of(after, probability):
    before = np.full(len(after), -1)
    before[after[after >= 0]] = np.flatnonzero(after >= 0)
    return Chains(after, before, probability, np.full(len(after), 0.5))


def test_a_path_is_as_sure_as_its_weakest_link():
    rows = street(frames=3, count=2)
    s = sightings_of(read_detections(rows), "all", None, 0.4)
    link = {
        (a, b): s.frame[a] + 1 == s.frame[b] and abs(s.xy[b, 0] - s.xy[a, 0] - 12) < 2
        for a in range(6)
        for b in range(6)
    }
    after = np.array([next((b for b in range(6) if link[a, b]), -1) for a in range(6)])
    probability = np.linspace(0.5, 0.9, 6)
    paths = paths_of(s, chains_of(after, probability), TrackingParams())
    found = identity_probability(chains_of(after, probability), paths)
    for n, start in enumerate(paths.sighting[paths.start]):
        assert found[n] == min(probability[start], probability[after[start]])
    assert len(found) == 2


def test_calibration_keeps_the_order_of_links_and_leaves_ends_alone():
    after = np.array([1, 2, 3, -1])
    chains = chains_of(after, np.array([0.2, 0.6, 0.97, 0.3]))
    mended = calibrated(chains).probability
    assert 0 < mended[0] < mended[1] < mended[2] < 1
    assert mended[3] == 0.3


def test_plain_traffic_is_surer_than_a_crowd_at_random():
    sure = track(street()).trajectories["identity_probability"]
    assert len(sure) == 5
    assert sure.between(0.9, 1).all()
    rng = np.random.default_rng(3)
    crowd = street(frames=6, count=12)
    crowd[["x_m", "y_m"]] = rng.uniform(0, 60, (len(crowd), 2))
    unsure = track(crowd.drop(columns=["red", "green", "blue"])).trajectories["identity_probability"]
    assert unsure.between(0, 1).all()
    assert unsure.median() < sure.median() - 0.05


def test_methods_without_calibration_state_nothing():
    assert track(street(), method="proposed").trajectories["identity_probability"].isna().all()
