"""Stops: who stood where, for how long, and why."""

import numpy as np
import pandas as pd
import pytest
from traffic_worlds import area, lopsided_crossing, path, trajectories_of, view

from vtrack_batch.model.tables import TABLES
from vtrack_batch.traffic.measure import measure
from vtrack_batch.traffic.params import TrafficParams

T = np.arange(0, 60, 1.5)


def _halting(name, y, stop_x, first=10, last=20, state="stopped"):
    """Drives east at 6 m/s, stands at *stop_x* from the first to the last step, drives on."""
    steps = np.arange(len(T))
    moving = np.where(steps <= first, steps - first, np.where(steps >= last, steps - last, 0)) * 9.0
    states = np.where((steps >= first) & (steps <= last), state, "moving")
    return path(name, np.c_[stop_x + moving, np.full(len(T), y)], T).assign(state=states)


def _stops(points, zones=(), **params):
    trajectories = trajectories_of(points)
    out = measure(trajectories, points, list(zones), view(T), time_zone="UTC", params=TrafficParams(**params))
    assert list(out["stops"].columns) == list(TABLES["stops"].column_names)
    return out["stops"].set_index("vehicle_id")


def test_begin_end_duration_and_place():
    stop = _stops(_halting("a", 5, -30), [area("z", -40, 0, -20, 9), area("big", -90, -90, 90, 90)]).loc["a"]
    assert stop["duration_s"] == pytest.approx(15.0)
    assert (stop["x_m"], stop["y_m"]) == pytest.approx((-30, 5), abs=1e-9)
    assert (stop["t_end_utc"] - stop["t_start_utc"]).total_seconds() == 15
    assert (stop["place"], stop["kind"]) == ("z", "unknown")


def test_short_halts_are_no_stops():
    assert len(_stops(_halting("a", 5, -30, 10, 12), stop_min_s=3.1)) == 0
    assert len(_stops(_halting("a", 5, -30, 10, 12), stop_min_s=3.0)) == 1


def test_slow_points_without_a_state_are_stops_too():
    points = _halting("a", 5, -30).drop(columns="state").assign(speed_mps=np.r_[[6.0] * 10, [0.2] * 11, [6.0] * 19])
    assert _stops(points).loc["a", "duration_s"] == pytest.approx(15.0)


def test_first_at_the_line_waits_for_the_signal_and_those_behind_queue():
    points = pd.concat([_halting("first", -12, -85), _halting("second", -12, -92), _halting("third", -12.5, -100)])
    kinds = _stops(points, lopsided_crossing("approach"))["kind"]
    assert kinds.to_dict() == {"first": "signal", "second": "queue", "third": "queue"}


def test_a_line_beyond_the_arm_is_a_signal_where_the_vehicle_faces_the_junction():
    assert _stops(_halting("a", -12, 0), lopsided_crossing())["kind"].to_dict() == {"a": "signal"}
    assert _stops(_halting("a", -12, 50), lopsided_crossing())["kind"].to_dict() == {"a": "unknown"}


def test_neighbours_beside_behind_or_at_another_time_are_no_leaders():
    beside = pd.concat([_halting("a", 0, 0), _halting("b", 8, 0)])
    assert set(_stops(beside)["kind"]) == {"unknown"}
    later = pd.concat([_halting("a", 0, 0, 5, 12), _halting("b", 0, 8, 20, 30)])
    assert set(_stops(later)["kind"]) == {"unknown"}
    far = pd.concat([_halting("a", 0, 0), _halting("b", 0, 12.5)])
    assert set(_stops(far)["kind"]) == {"unknown"}


def test_parked_vehicles_are_parked_and_head_no_queue():
    points = pd.concat([_halting("kerb", 0, 8, 0, 39, "parked"), _halting("a", 0, 0)])
    assert _stops(points)["kind"].to_dict() == {"kerb": "parked", "a": "unknown"}


def test_position_is_exact_on_a_national_grid():
    points = _halting("a", 5.25, -30.5).assign()
    points["x_m"] += 691_000.0
    points["y_m"] += 5_334_000.0
    stop = _stops(points).loc["a"]
    assert (stop["x_m"], stop["y_m"]) == pytest.approx((690_969.5, 5_334_005.25), abs=1e-6)
