"""Proposed zones: the arms of a crossing found from the ends of its trajectories."""

import numpy as np
import pandas as pd
import pytest
from traffic_worlds import path, trajectories_of, view

from vtrack_batch.model.views import Views
from vtrack_batch.traffic.measure import measure
from vtrack_batch.traffic.params import ProposalParams, TrafficParams
from vtrack_batch.traffic.propose import cluster_of, compass_names, propose_zones

WEST, EAST, SOUTH, NORTH = -100.0, 80.0, -90.0, 70.0
T = np.arange(0, 1200, 1.5)
PARAMS = TrafficParams()
# Right-hand traffic: (x, y) on the border for entering and for leaving.
ENTRY = {"W": (WEST, -3), "E": (EAST, 3), "S": (3, SOUTH), "N": (-3, NORTH)}
EXIT = {"W": (WEST, 3), "E": (EAST, -3), "S": (-3, SOUTH), "N": (3, NORTH)}


def crossing_traffic(many=120, speed=11.0, seed=4):
    """Vehicles between four arms of a view of 180 x 160 m, sampled every 1.5 s, with 0.4 m of noise."""
    rng = np.random.default_rng(seed)
    arms = list(ENTRY)
    parts, truth = [], {}
    for number in range(many):
        a, b = rng.choice(arms, 2, replace=False)
        start, end, middle = np.array(ENTRY[a]), np.array(EXIT[b]), np.array([ENTRY[a][0], ENTRY[a][1]], float)
        middle = np.array([EXIT[b][0] if a in "WE" else ENTRY[a][0], ENTRY[a][1] if a in "WE" else EXIT[b][1]])
        if {a, b} in ({"W", "E"}, {"N", "S"}):
            middle = (start + end) / 2
        lengths = np.hypot(*np.diff([start, middle, end], axis=0).T)
        way = np.arange(rng.uniform(0, speed * 1.5), lengths.sum(), speed * 1.5 * rng.uniform(0.8, 1.2))
        x = np.interp(way, np.r_[0, np.cumsum(lengths)], [start[0], middle[0], end[0]])
        y = np.interp(way, np.r_[0, np.cumsum(lengths)], [start[1], middle[1], end[1]])
        name = f"v{number:03d}"
        truth[name] = (a, b)
        first = 5 + 3 * number
        parts.append(path(name, np.c_[x, y] + rng.normal(0, 0.4, (len(x), 2)), T[first : first + len(x)]))
    return pd.concat(parts), truth


@pytest.fixture(scope="module")
def crossing():
    points, truth = crossing_traffic()
    trajectories = trajectories_of(points)
    views = view(T, WEST, SOUTH, EAST, NORTH)
    return points, trajectories, views, truth, propose_zones(trajectories, points, views, params=PARAMS)


def test_a_crossing_with_four_arms_gets_four_zones_named_by_the_compass(crossing):
    *_, zones = crossing
    assert [zone.id for zone in zones] == ["E", "N", "S", "W"]
    assert {zone.role for zone in zones} == {"zone"}
    assert {zone.junction for zone in zones} == {"junction"}
    centre = zones[0].properties["junction_centre_m"]
    assert np.hypot(*centre) < 6.0
    for zone in zones:
        assert zone.geometry.is_valid
        assert zone.properties["proposed"] is True


def test_all_pairs_and_turns_come_out_of_the_proposal(crossing):
    points, trajectories, views, truth, zones = crossing
    out = measure(trajectories, points, zones, views, time_zone="UTC")
    found = {row.vehicle_id: (row.origin, row.destination) for row in out["trajectories"].itertuples()}
    assert found == truth
    through = {("W", "E"), ("E", "W"), ("N", "S"), ("S", "N")}
    names = out["trajectories"].set_index("vehicle_id")["movement"]
    assert {name for name, ends in truth.items() if ends in through} == set(names.index[names == "through"])
    right = {("W", "S"), ("S", "E"), ("E", "N"), ("N", "W")}
    assert {name for name, ends in truth.items() if ends in right} == set(names.index[names == "right"])


def test_the_proposal_depends_on_neither_order_nor_standing_vehicles(crossing):
    points, trajectories, views, _, zones = crossing
    standing = path("zz", np.full((9, 2), 40.0), T[:9], "parked")
    more = pd.concat([points.sample(frac=1, random_state=1), standing])
    rows = pd.concat([trajectories[::-1], trajectories_of(standing)])
    again = propose_zones(rows, more, views, params=PARAMS)
    assert [(zone.id, zone.geometry.wkt) for zone in again] == [(zone.id, zone.geometry.wkt) for zone in zones]


def test_a_road_has_two_ends_and_no_junction():
    rng = np.random.default_rng(3)
    parts = []
    for number in range(30):
        x = np.arange(WEST + rng.uniform(0, 30), EAST, 30.0)
        parts.append(path(f"v{number}", np.c_[x, 0.3 * x + rng.normal(0, 1, len(x))], T[number : number + len(x)]))
    points = pd.concat(parts)
    views = view(T, WEST, SOUTH, EAST, NORTH)
    zones = propose_zones(trajectories_of(points), points, views, params=PARAMS)
    assert [(zone.id, zone.junction) for zone in zones] == [("E", None), ("W", None)]


@pytest.mark.parametrize("views", [{}, view(T, WEST, SOUTH, EAST, NORTH)])
def test_too_few_vehicles_make_no_zone(views):
    lonely = path("a", [(-95, 0), (-80, 0), (75, 0)], T[:3])
    assert propose_zones(trajectories_of(lonely), lonely, views, params=PARAMS) == []
    nobody = lonely.iloc[:0]
    assert propose_zones(trajectories_of(lonely).iloc[:0], nobody, views, params=PARAMS) == []
    lost = trajectories_of(lonely, start_reason="appeared", end_reason="lost")
    assert propose_zones(lost, lonely, views, params=PARAMS) == []


def test_a_platform_that_passes_by_gets_no_zones(crossing):
    points, trajectories, views, *_ = crossing
    still = views["s"]
    shift = np.linspace(0, 200, len(still))[:, None, None] * np.array([1.0, 0.0])
    passing = {"s": Views("s", still.t_utc, still.corners_m + shift, still.position_sigma_m)}
    assert propose_zones(trajectories, points, passing, params=PARAMS) == []


def test_clusters_are_numbered_by_place_and_strays_belong_to_none():
    points = np.array([(50, 0), (51, 1), (0, 5), (1, 1), (25, 80), (2, 3)], float)
    assert cluster_of(points, params=ProposalParams(min_vehicles=2)).tolist() == [1, 1, 0, 0, -1, 0]
    assert cluster_of(points, params=ProposalParams(min_vehicles=3)).tolist() == [-1, -1, 0, 0, -1, 0]
    assert cluster_of(points[:0], params=ProposalParams()).tolist() == []


def test_several_zones_on_one_side_are_numbered_clockwise():
    from shapely.geometry import Point

    centres = [Point(10, 100), Point(-10, 100), Point(100, 0), Point(-60, -60), Point(0, 100)]
    assert compass_names(centres, Point(0, 0)) == ["N3", "N1", "E", "SW", "N2"]


@pytest.mark.real
@pytest.mark.parametrize("interval_s", [0.5, 1.5, 4.0])
def test_pinned_crossing_gets_its_arms_and_its_pairs(shared_data, interval_s):
    rows = pd.read_parquet(shared_data / "sumo" / "sequences_crossing.parquet")
    chosen = (rows["seed"] == 31) & np.isclose(rows["interval_s"], interval_s) & (rows["missed"] == 0)
    inside = (rows["x_m"].abs() < 120) & (rows["y_m"].abs() < 95)
    rows = rows[chosen & inside].sort_values(["truth_vehicle", "t_s"])
    points = pd.concat([path(f"v{name}", of[["x_m", "y_m"]], of["t_s"]) for name, of in rows.groupby("truth_vehicle")])
    t = np.sort(rows["t_s"].unique())
    views = view(t, -120, -95, 120, 95)
    trajectories = trajectories_of(points)
    first, last = points["t_utc"].min(), points["t_utc"].max()
    trajectories.loc[trajectories["t_start_utc"] == first, "start_reason"] = "start_of_data"
    trajectories.loc[trajectories["t_end_utc"] == last, "end_reason"] = "end_of_data"
    zones = propose_zones(trajectories, points, views, params=PARAMS)
    assert [zone.id for zone in zones] == ["E", "N", "S", "W"]
    found = measure(trajectories, points, zones, views, time_zone="UTC")["trajectories"]
    ends = points.groupby("vehicle_id")[["x_m", "y_m"]].agg(["first", "last"]).reindex(found["vehicle_id"])

    def side(which):
        x, y = ends[("x_m", which)].to_numpy() / 120, ends[("y_m", which)].to_numpy() / 95
        return np.where(np.abs(x) > np.abs(y), np.where(x > 0, "E", "W"), np.where(y > 0, "N", "S"))

    whole = ((found["start_reason"] == "entered_view") & (found["end_reason"] == "left_view")).to_numpy()
    right = (found["origin"] == side("first")) & (found["destination"] == side("last"))
    assert 150 < whole.sum() < 250
    assert right[whole].mean() >= 0.98
