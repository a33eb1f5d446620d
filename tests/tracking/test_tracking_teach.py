"""Facts about a sequence that teaches itself: whose motions make the map, and when there is none."""

import numpy as np
import pandas as pd
import pytest

import vtrack_batch as vt
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.tracking.link import link
from vtrack_batch.tracking.params import LinkParams, TrackingParams
from vtrack_batch.tracking.sightings import read_detections, sightings_of
from vtrack_batch.tracking.teach import Taught, flow_of_tables

SPEED_MPS, INTERVAL_S = 12.0, 1.0


def stream(seed: int = 1, *, frames: int = 12) -> pd.DataFrame:
    """Eastbound vehicles on a lopsided road, 12 m/s, 30-50 m apart, seen every second."""
    rng = np.random.default_rng(seed)
    start = -np.cumsum(rng.uniform(30, 50, 9))
    rows = []
    for f in range(frames):
        x = start + SPEED_MPS * INTERVAL_S * f + rng.normal(0, 0.2, 9)
        rows.append(pd.DataFrame({"x_m": x, "y_m": 40.0 + rng.normal(0, 0.2, 9), "f": f}))
    table = pd.concat(rows, ignore_index=True).sample(frac=1, random_state=seed, ignore_index=True)
    t_utc = pd.Timestamp("2026-05-17T06:00Z") + pd.to_timedelta(table.pop("f") * INTERVAL_S, unit="s")
    ids = np.random.default_rng(seed + 1).permutation(len(table)).astype(str)
    return table.assign(t_utc=t_utc, detection_id=ids)


def sightings(rows: pd.DataFrame):
    return sightings_of(read_detections(rows), "all", None, 0.4)


def test_the_first_window_is_linked_by_its_own_map_and_the_next_by_that_of_the_first() -> None:
    taught = Taught(MatchingParams(), TrackingParams(), None)
    first = taught(sightings(stream()))
    assert taught.flow_map is not None
    assert np.hypot(*taught.flow_map.velocity.T).mean() == pytest.approx(SPEED_MPS, abs=0.3)
    learned = taught.flow_map
    second = sightings(stream(5))
    expected = link(second, MatchingParams(), TrackingParams(), learned)
    assert np.array_equal(taught(second).after, expected.after)
    assert (first.after >= 0).sum() == 9 * 11


def test_a_map_that_is_given_stays_and_without_teaching_there_is_none() -> None:
    given = FlowMap(np.array([[0.0, 40.0]]), np.array([[SPEED_MPS, 0.0]]))
    taught = Taught(MatchingParams(), TrackingParams(), given)
    taught(sightings(stream()))
    assert taught.flow_map is given
    alone = Taught(MatchingParams(), TrackingParams(link=LinkParams(self_taught=False)), None)
    s = sightings(stream())
    assert np.array_equal(alone(s).probability, link(s, MatchingParams(), TrackingParams()).probability)
    assert alone.flow_map is None


def test_tables_teach_the_motion_of_what_was_followed() -> None:
    rows = stream()
    tracks = vt.track(rows)
    learned = flow_of_tables(rows, tracks.track_points, tracks.matches)
    assert learned is not None
    assert len(learned.xy) == pytest.approx(9 * 11, abs=12)
    east, north = learned.velocity.T
    assert east.mean() == pytest.approx(SPEED_MPS, abs=0.2)
    assert abs(north.mean()) < 0.2
    assert set(map(tuple, learned.xy)) <= set(map(tuple, rows[["x_m", "y_m"]].to_numpy()))


def test_two_frames_teach_nothing() -> None:
    rows = stream(frames=2)
    tracks = vt.track(rows)
    assert flow_of_tables(rows, tracks.track_points, tracks.matches) is None
    assert len(tracks.trajectories) == 9
