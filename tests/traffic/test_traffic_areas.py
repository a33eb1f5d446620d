"""Speeds, flows and densities of areas equal what the definitions give for known motion."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, Point, Polygon
from traffic_worlds import area, gate, path, straight, trajectories_of, view

from vtrack_batch.model.tables import TABLES
from vtrack_batch.model.zones import Zone
from vtrack_batch.traffic.measure import measure
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.paths import read_paths
from vtrack_batch.traffic.visits import clip

T = np.arange(0, 30, 1.5)
LANE = Zone("lane", "lane", "lane", LineString([(-40, 2), (35, 2)]), None, {"width_m": 4.0})


def _tables(points, zones, *, t_view=T, time_zone="UTC", **params):
    trajectories = trajectories_of(points, start_reason="appeared", end_reason="lost")
    params = TrafficParams(**params)
    return measure(trajectories, points, zones, view(t_view), time_zone=time_zone, params=params)


def _row(table, **key):
    for name, value in key.items():
        table = table[table[name] == value]
    assert len(table) == 1
    return table.iloc[0]


def test_speeds_over_a_gate():
    v = [6.0, 9.0, 18.0, 20.0]
    points = pd.concat([straight(f"v{i}", (-100, i), (speed, 0), T) for i, speed in enumerate(v)])
    out = _tables(points, [gate("g", (-3.3, -9), (-3.3, 9))])
    speeds, flows = out["speeds"], out["flows"]
    assert list(speeds.columns) == list(TABLES["speeds"].column_names)
    assert speeds["vehicles"].sum() == 4
    row = _row(speeds, place="g")
    assert row["time_mean_mps"] == pytest.approx(np.mean(v), abs=1e-6)
    assert row["space_mean_mps"] == pytest.approx(4 / np.sum(1 / np.array(v)), abs=1e-6)
    assert row[["p15_mps", "p50_mps", "p85_mps"]].tolist() == pytest.approx(np.percentile(v, [15, 50, 85]), abs=1e-6)
    assert row["standard_error_mps"] == pytest.approx(np.std(v, ddof=1) / 2, abs=1e-6)
    flow = _row(flows, place="g", vehicle_class="all")
    assert flow["flow_vph"] == pytest.approx(4 * 3600 / T[-1], abs=1e-9)
    assert np.isnan(flow["density_vpkm"])
    assert flow["space_mean_mps"] == pytest.approx(row["space_mean_mps"], abs=1e-9)


def test_edie_in_a_lane_drawn_as_a_line():
    """Two vehicles go through, one leaves by the side, one is parked: total way and time are known exactly."""
    points = pd.concat(
        [
            straight("a", (-100, 2), (10, 0), T),
            straight("b", (90, 3), (-8, 0), T),
            straight("c", (-10, 1), (5, 1), T[:8]),
            path("p", [(0, 2)] * len(T), T, "parked"),
            straight("beside", (-100, 4.1), (10, 0), T),
        ]
    )
    out = _tables(points, [LANE])
    # a goes 75 m in 7.5 s; b 75 m in 9.375 s; c from (-10, 1) to y = 4 after 3 s: 3 sqrt(26) m.
    way, time = 75 + 75 + 3 * np.sqrt(26), 7.5 + 75 / 8 + 3
    flow = _row(out["flows"], place="lane", vehicle_class="all")
    watched = 75 * T[-1]
    assert flow["count"] == 3
    assert flow["flow_vph"] == pytest.approx(3600 * way / watched, rel=1e-9)
    assert flow["density_vpkm"] == pytest.approx(1000 * time / watched, rel=1e-9)
    assert flow["space_mean_mps"] == pytest.approx(way / time, abs=1e-6)
    speed = _row(out["speeds"], place="lane")
    assert speed["vehicles"] == 3
    assert speed["time_mean_mps"] == pytest.approx((10 + 8 + np.sqrt(26)) / 3, abs=1e-6)
    assert speed["space_mean_mps"] == pytest.approx(way / time, abs=1e-6)


def test_way_and_time_are_cut_at_the_borders_of_bins():
    points = straight("a", (-100, 2), (10, 0), T)
    out = _tables(points, [LANE], bin_s=10)
    flows = out["flows"][out["flows"]["vehicle_class"] == "all"]
    # Inside from 6 s to 13.5 s: 4 s in the first bin, 3.5 s in the second, none in the third.
    assert flows["density_vpkm"].tolist() == pytest.approx([1000 * 4 / 750, 1000 * 3.5 / 750, 0], abs=1e-9)
    assert flows["count"].tolist() == [1, 1, 0]
    assert out["speeds"]["vehicles"].tolist() == [1, 1, 0]
    assert out["speeds"]["time_mean_mps"].tolist()[:2] == pytest.approx([10, 10], abs=1e-6)
    assert np.isnan(out["speeds"]["time_mean_mps"][2])


@pytest.mark.parametrize(
    ("properties", "length"), [({}, 50.0), ({"width_m": 4.0}, 125.0), ({"length_m": 40.0, "width_m": 4.0}, 40.0)]
)
def test_length_of_an_area_along_its_road(properties, length):
    points = straight("a", (-100, 2), (10, 0), T)
    zone = area("z", -20, -4, 30, 6, **properties)
    flow = _row(_tables(points, [zone])["flows"], place="z", vehicle_class="all")
    assert flow["density_vpkm"] == pytest.approx(1000 * 5 / (length * T[-1]), rel=1e-9)


def test_half_an_area_in_view_halves_the_region_watched():
    points = straight("a", (0, 2), (10, 0), T[:9])
    zone = area("z", 20, -4, 220, 6)
    flow = _row(_tables(points, [zone])["flows"], place="z", vehicle_class="all")
    assert flow["density_vpkm"] == pytest.approx(1000 * 10 / (100 * T[-1]), rel=1e-9)


def test_classes_are_counted_apart_and_together():
    points = pd.concat([straight("a", (-100, 2), (10, 0), T), straight("b", (-100, 3), (12, 0), T)])
    trajectories = trajectories_of(points, vehicle_class={"a": "car", "b": "bus"})
    flows = measure(trajectories, points, [LANE], view(T), time_zone="UTC")["flows"]
    assert dict(zip(flows["vehicle_class"], flows["count"], strict=True)) == {"all": 2, "bus": 1, "car": 1}


hollow = Polygon([(-40, -30), (50, -35), (60, 30), (20, -5), (0, 33), (-35, 20)], [[(-5, -20), (15, -22), (0, -8)]])
coordinates = st.integers(-700, 700).map(lambda v: v / 10 + 0.013)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(coordinates, coordinates), min_size=2, max_size=9))
def test_clipping_agrees_with_intersection_for_hollow_areas(corners):
    points = path("a", corners, T[: len(corners)])
    paths = read_paths(pd.Series(["a"]), points, params=TrafficParams())
    pieces = clip(paths, hollow)
    inside = ((pieces.share_out - pieces.share_in) * paths.length_m[pieces.segment]).sum()
    steps = [LineString(step) for step in pairwise(corners) if step[0] != step[1]]
    assert inside == pytest.approx(sum(step.intersection(hollow).length for step in steps), abs=1e-6)
    middle = (pieces.share_in + pieces.share_out) / 2
    for x, y in zip(*paths.at(pieces.segment, middle), strict=True):
        assert hollow.distance(Point(x, y)) < 1e-9


def test_standing_vehicles_are_in_or_out_as_a_whole():
    points = pd.concat([path("in", [(10.0, 20.0)] * 5, T[:5]), path("hole", [(2.0, -18.0)] * 5, T[:5])])
    inside = Polygon(hollow.exterior)
    assert inside.contains(shapely.points(2.0, -18.0))
    assert not hollow.contains(shapely.points(2.0, -18.0))
    zone = Zone("z", "z", "zone", hollow, None, {"length_m": 100.0})
    flow = _row(
        _tables(pd.concat([points, path("two", [(-20.0, 0.0)] * 5, T[:5])]), [zone])["flows"],
        place="z",
        vehicle_class="all",
    )
    assert flow["count"] == sum(hollow.contains(shapely.points(*p)) for p in [(10, 20), (2, -18), (-20, 0)])
    assert flow["space_mean_mps"] == 0
