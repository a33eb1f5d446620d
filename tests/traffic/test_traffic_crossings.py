"""Crossings: where, when, which way, once."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from traffic_worlds import gate, path, straight, trajectories_of, view

from vtrack_batch.model.tables import TABLES
from vtrack_batch.traffic.crossings import line_crossings
from vtrack_batch.traffic.measure import measure
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.paths import read_paths
from vtrack_batch.traffic.places import places_of

T = np.arange(0, 21, 1.5)


def _measured(points, zones, **params):
    return measure(
        trajectories_of(points, start_reason="appeared", end_reason="lost"),
        points,
        zones,
        view(T),
        time_zone="Europe/Berlin",
        params=TrafficParams(**params),
    )


def test_time_place_and_speed_of_a_crossing_are_exact():
    points = straight("a", (-50, 3), (7, -0.5), T)
    crossings = _measured(points, [gate("g", (13, -20), (13, 20))])["crossings"]
    assert list(crossings.columns) == list(TABLES["crossings"].column_names)
    assert crossings["t_utc"][0] == points["t_utc"][0] + pd.Timedelta(seconds=9)
    assert crossings["speed_mps"][0] == pytest.approx(np.hypot(7, 0.5), abs=1e-9)
    # The gate is drawn upwards: its left is west, so going east is forward.
    assert crossings["direction"].tolist() == ["forward"]


def test_turning_the_gate_round_mirrors_the_direction_only():
    points = pd.concat([straight("a", (-50, 3), (7, -0.5), T), straight("b", (60, -4), (-9, 1), T)])
    one = _measured(points, [gate("g", (13, -20), (10, 5), (13, 20))])["crossings"]
    other = _measured(points, [gate("g", (13, 20), (10, 5), (13, -20))])["crossings"]
    assert one["direction"].tolist() == ["forward", "backward"]
    assert other["direction"].tolist() == ["backward", "forward"]
    pd.testing.assert_frame_equal(one.drop(columns="direction"), other.drop(columns="direction"))


def test_passing_beside_the_gate_is_no_crossing():
    points = straight("a", (-50, 3), (7, 0), T)
    assert len(_measured(points, [gate("g", (13, 3.1), (13, 20))])["crossings"]) == 0
    assert len(_measured(points, [gate("g", (13, -9), (13, 2.9))])["crossings"]) == 0


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(-40, 40), st.integers(-20, 20)), min_size=3, max_size=6), st.integers(-9, 9))
def test_a_path_through_points_of_gate_and_path_is_counted_once(corners, offset):
    """However the gate across the view is bent, who drives straight through it crosses it once."""
    ys = np.linspace(-60, 60, len(corners))
    bent = gate("g", *[(x / 10, y) for (x, _), y in zip(corners, ys, strict=True)])
    places = places_of([bent], site_centre=None, params=TrafficParams())
    paths = read_paths(pd.Series(["a"]), straight("a", (-49, offset), (7, 0), T), params=TrafficParams())
    assert line_crossings(paths, places, hysteresis_m=0.0)["forward"].tolist() == [True]


def test_wavering_on_the_line_counts_once_or_not_at_all():
    x = np.array([-20, -10, -1, 0.4, -0.5, 0.3, -0.2, 0.6, 8, 20, 30.0])
    there = path("there", np.c_[x, 0 * x], T[: len(x)])
    back = path("back", np.c_[np.r_[x[:7], -8, -20], np.zeros(9)], T[:9])
    twice = path("twice", np.c_[[-20, -10, 10, 20, 5, -9], np.zeros(6)], T[:6])
    crossings = _measured(pd.concat([there, back, twice]), [gate("g", (0.0, -5), (0.0, 5))])["crossings"]
    assert crossings["vehicle_id"].tolist() == ["there", "twice", "twice"]
    assert crossings["direction"].tolist() == ["forward", "forward", "backward"]
    assert crossings["t_utc"][0] < there["t_utc"][3]


def test_speed_comes_from_the_path_where_points_hold_none():
    points = path("a", [(-10, 0), (20, 0), (26, 0)], [0, 1.5, 3])
    crossings = _measured(points, [gate("g", (0, -5), (0, 5))])["crossings"]
    assert 4.0 <= crossings["speed_mps"][0] <= 20.0
    assert crossings["speed_sigma_mps"].isna().all()
