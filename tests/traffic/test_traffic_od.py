"""Origins and destinations: each trajectory has one of each, and the totals balance."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from traffic_worlds import area, gate, path, straight, trajectories_of, view

from vtrack_batch.model.tables import TABLES
from vtrack_batch.traffic.measure import measure
from vtrack_batch.traffic.params import TrafficParams

T = np.arange(0, 30, 1.5)
GATES = [gate("W", (-80, -15), (-80, 15)), gate("E", (90, 15), (90, -15)), gate("N", (0, 50), (25, 50))]
ZONES = [area("ZW", -120, -15, -90, 15), area("ZE", 95, -15, 120, 15), area("ZM", -10, -15, 5, 15)]


def _od(points, zones=GATES, extend=0.0, **columns):
    usual = {"start_reason": "appeared", "end_reason": "lost"}
    trajectories = trajectories_of(points, **{**usual, **columns})
    params = TrafficParams(extend_steps=extend)
    out = measure(trajectories, points, zones, view(T), time_zone="UTC", params=params)
    pairs = {row.vehicle_id: (row.origin, row.destination) for row in out["trajectories"].itertuples()}
    return pairs, out


def _way(name, *corners):
    corners = np.array(corners, float)
    return path(name, corners, T[: len(corners)])


@pytest.mark.parametrize(
    ("corners", "expected"),
    [
        ([(-100, 0), (100, 0)], ("W", "E")),
        ([(100, 5), (-100, 5)], ("E", "W")),
        ([(10, 55), (10, 0), (100, 0)], ("N", "E")),
        ([(0, 0), (100, 0)], ("unknown", "E")),
        ([(-100, 0), (0, 0)], ("W", "unknown")),
        ([(-20, 0), (20, 0)], ("unknown", "unknown")),
        ([(-100, 0), (0, 0), (-100, 5)], ("W", "W")),
        # Out and in again by the same gate: it came from inside, and went to inside.
        ([(0, 0), (-100, 0), (0, 5)], ("unknown", "unknown")),
        # Through several gates: in by the first, out by the last.
        ([(-100, 0), (10, 0), (10, 55), (10, 0), (100, 0)], ("W", "E")),
    ],
)
def test_gates(corners, expected):
    assert _od(_way("a", *corners))[0]["a"] == expected


@pytest.mark.parametrize(
    ("corners", "expected"),
    [
        ([(-100, 0), (100, 0)], ("ZW", "ZE")),
        # Not seen until beyond the zone's far side; lost before its end: still the first left and the last reached.
        ([(-119, 20), (-100, 0), (100, 0), (110, 20)], ("ZW", "ZE")),
        ([(40, 0), (100, 0)], ("unknown", "ZE")),
        ([(-100, 0), (-40, 0)], ("ZW", "unknown")),
        # Never out of one zone: nothing tells whether it was about to come or to go.
        ([(-100, 0), (-92, 3)], ("unknown", "unknown")),
        # A single zone on the way belongs to the nearer end of the path.
        ([(-12, 0), (80, 0)], ("ZM", "unknown")),
        ([(-80, 0), (8, 0)], ("unknown", "ZM")),
        ([(20, 0), (50, 20)], ("unknown", "unknown")),
    ],
)
def test_zones(corners, expected):
    assert _od(_way("a", *corners), ZONES)[0]["a"] == expected


def test_inward_side_can_be_named():
    outside = [gate("W", (-80, -15), (-80, 15), inward="left"), *GATES[1:]]
    assert _od(_way("a", (-100, 0), (100, 0)), outside)[0]["a"] == ("unknown", "E")


def test_parked_at_an_end():
    standing = path("p", [(-100, 0)] * 4, T[:4], "parked")
    leaving = pd.concat([standing, path("p", [(-60, 0), (60, 0), (110, 0)], T[4:7])])
    stays = path("q", [(-50, 2)] * 5, T[:5], "parked")
    pairs, _ = _od(pd.concat([leaving, stays]), ZONES, start_reason={"p": "parked", "q": "parked"})
    assert pairs == {"p": ("parked", "ZE"), "q": ("parked", "parked")}


def test_a_path_that_left_the_view_is_prolonged_to_the_gate_just_ahead():
    points = straight("a", (-75, 0), (10, 0), T[:11])
    reasons = {"start_reason": "entered_view", "end_reason": "left_view"}
    assert _od(points, extend=1.0, **reasons)[0]["a"] == ("W", "E")
    assert _od(points, extend=0.0, **reasons)[0]["a"] == ("unknown", "unknown")
    assert _od(points, extend=1.0)[0]["a"] == ("unknown", "unknown")
    # What was not seen is in no other table.
    assert len(_od(points, extend=1.0, **reasons)[1]["crossings"]) == 0


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        ("start_of_data", "left_view", ("unknown", "ZW")),
        ("entered_view", "end_of_data", ("ZW", "unknown")),
        ("entered_view", "left_view", ("ZW", "ZW")),
        ("appeared", "end_of_data", ("unknown", "unknown")),
    ],
)
@pytest.mark.parametrize("extend", [0.0, 1.0])
def test_who_never_leaves_a_zone_belongs_to_it_where_the_view_ends(start, end, expected, extend):
    way = _way("a", (-94, 0), (-104, 1), (-114, 0))
    assert _od(way, ZONES, extend, start_reason=start, end_reason=end)[0]["a"] == expected


def test_counts_travel_time_and_zeros():
    points = pd.concat(
        [
            straight("a", (-105, 0), (10, 0), T),
            straight("b", (-105, 4), (12.5, 0), T),
            straight("c", (105, -4), (-10, 0), T).assign(),
        ]
    )
    od = _od(points, vehicle_class={"a": "car", "b": "bus", "c": "car"})[1]["od_pairs"]
    assert list(od.columns) == list(TABLES["od_pairs"].column_names)
    cell = od.set_index(["origin", "destination", "vehicle_class"])
    assert cell.loc[("W", "E", "all"), "count"] == 2
    assert cell.loc[("W", "E", "bus"), "count"] == 1
    assert cell.loc[("E", "W", "all"), "count"] == 1
    assert cell.loc[("N", "E", "all"), "count"] == 0
    assert cell.loc[("W", "E", "all"), "median_travel_time_s"] == pytest.approx((17 + 13.6) / 2, abs=1e-6)
    assert np.isnan(cell.loc[("N", "E", "all"), "median_travel_time_s"])
    assert cell["count_lo"].isna().all()
    assert (cell["observed_s"] == T[-1]).all()
    assert (cell["status"] == "partial").all()
    places = {"W", "E", "N", "unknown", "parked"}
    assert set(od["origin"]) == set(od["destination"]) == places
    assert (od["vehicle_class"] == "all").sum() == 25


def test_nothing_in_view_is_null_and_nothing_seen_is_zero():
    far = [*GATES, gate("far", (500, 0), (500, 20))]
    od = _od(_way("a", (-100, 0), (100, 0)), far)[1]["od_pairs"].set_index(["origin", "destination", "vehicle_class"])
    assert np.isnan(od.loc[("W", "far", "all"), "count"])
    assert od.loc[("W", "far", "all"), "status"] == "not_observed"
    assert od.loc[("W", "N", "all"), "count"] == 0


def test_doubt_about_identity_moves_mass_to_unknown_and_widens_the_interval():
    points = pd.concat([straight(f"v{i}", (-105, i), (10, 0), T) for i in range(10)])
    od = _od(points, identity_probability=0.8)[1]["od_pairs"]
    cell = od.set_index(["origin", "destination", "vehicle_class"])
    assert cell.loc[("W", "E", "all"), "count"] == pytest.approx(8.0)
    assert cell.loc[("W", "unknown", "all"), "count"] == pytest.approx(2.0)
    # Binomial(10, 0.8): P(X <= 4) = 0.6 %, P(X <= 5) = 3.3 %; P(X <= 9) = 89 %.
    assert tuple(cell.loc[("W", "E", "all"), ["count_lo", "count_hi"]]) == (5, 10)
    assert tuple(cell.loc[("N", "E", "all"), ["count_lo", "count_hi"]]) == (0, 0)
    sure = _od(points, identity_probability=1.0)[1]["od_pairs"].set_index(["origin", "destination", "vehicle_class"])
    assert tuple(sure.loc[("W", "E", "all"), ["count", "count_lo", "count_hi"]]) == (10, 10, 10)


walks = st.lists(st.tuples(st.integers(-1150, 1150), st.integers(-550, 550)), min_size=1, max_size=8)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(walks, st.floats(0, 1)), min_size=1, max_size=5), st.booleans(), st.randoms())
def test_totals_balance_and_rows_may_come_in_any_order(vehicles, with_zones, random):
    points = pd.concat(
        [path(f"v{i}", np.array(corners) / 10 + 0.037, T[: len(corners)]) for i, (corners, _) in enumerate(vehicles)]
    )
    doubt = {f"v{i}": p for i, (_, p) in enumerate(vehicles)}
    trajectories = trajectories_of(points, identity_probability=doubt)
    zones = GATES + (ZONES if with_zones else [])
    order = list(range(len(points)))
    random.shuffle(order)
    arguments = {"time_zone": "Europe/Berlin", "params": TrafficParams(bin_s=5)}
    out = measure(trajectories, points, zones, view(T), **arguments)
    mixed = measure(trajectories[::-1], points.iloc[order], zones[::-1], view(T), **arguments)
    for name in out:
        pd.testing.assert_frame_equal(out[name], mixed[name])
    od = out["od_pairs"]
    for one_class in ("all", "car"):
        assert od.loc[od["vehicle_class"] == one_class, "count"].sum() == pytest.approx(len(vehicles), abs=1e-9)
    found = out["trajectories"]
    by_origin = od[od["vehicle_class"] == "all"].groupby("origin")["count"].sum()
    for origin, many in found["origin"].value_counts().items():
        assert by_origin[origin] == pytest.approx(many, abs=1e-9)
