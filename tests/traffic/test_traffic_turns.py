"""Turns: named by the geometry of the arms, counted by approach, with shares."""

import numpy as np
import pandas as pd
import pytest
import shapely.affinity
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString
from traffic_worlds import area, gate, lopsided_crossing, path, trajectories_of, view

from vtrack_batch.model.tables import TABLES
from vtrack_batch.model.zones import Zone
from vtrack_batch.traffic.junctions import junctions_of
from vtrack_batch.traffic.measure import measure
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.places import places_of

T = np.arange(0, 60, 1.5)
ARM_AT = {"W": (-110, -10), "E": (110, -10), "N": (20, 55), "S": (20, -55)}
CENTRE = (20, -10)
GATES = [
    gate("W", (-90, -25), (-90, 5), junction="J"),
    gate("E", (70, -25), (70, 5), junction="J"),
    gate("N", (5, 40), (35, 40), junction="J"),
    gate("S", (5, -50), (35, -50), junction="J"),
]
NAMES = {
    ("W", "E"): "through",
    ("W", "N"): "left",
    ("W", "S"): "right",
    ("E", "W"): "through",
    ("E", "N"): "right",
    ("E", "S"): "left",
    ("N", "S"): "through",
    ("N", "E"): "left",
    ("N", "W"): "right",
    ("S", "N"): "through",
    ("S", "W"): "left",
    ("S", "E"): "right",
    ("W", "W"): "u_turn",
}


def _drive(name, entry, leaving, start=0.0):
    corners = np.array([ARM_AT[entry], CENTRE, ARM_AT[leaving]], float)
    if entry == leaving:
        corners[2] += (0, 4)
    way = np.concatenate([np.linspace(corners[0], corners[1], 12), np.linspace(corners[1], corners[2], 12)[1:]])
    return path(name, way, start + T[: len(way)])


def _measured(points, zones, **columns):
    usual = {"start_reason": "appeared", "end_reason": "lost"}
    trajectories = trajectories_of(points, **{**usual, **columns})
    return measure(trajectories, points, zones, view(T), time_zone="UTC")


@pytest.mark.parametrize(
    "zones", [lopsided_crossing(), lopsided_crossing("approach"), GATES], ids=["zone", "arm", "gate"]
)
def test_every_movement_has_its_name(zones):
    vehicles = {f"{a}{b}": (a, b) for a, b in NAMES}
    out = _measured(pd.concat([_drive(name, *ends) for name, ends in vehicles.items()]), zones)
    found = out["trajectories"].set_index("vehicle_id")["movement"].to_dict()
    assert found == {name: NAMES[ends] for name, ends in vehicles.items()}
    turns = out["turns"]
    assert list(turns.columns) == list(TABLES["turns"].column_names)
    every = turns[turns["vehicle_class"] == "all"]
    assert every["count"].sum() == len(vehicles)
    assert (every.loc[every["movement"] == "unknown", "count"] == 0).all()
    assert set(turns["movement"]) == {"left", "through", "right", "u_turn", "unknown"}


@settings(max_examples=30, deadline=None)
@given(st.floats(0, 360), st.booleans())
def test_names_do_not_depend_on_the_compass_and_swap_in_the_mirror(angle, mirrored):
    zones = []
    for zone in lopsided_crossing():
        shape = shapely.affinity.rotate(zone.geometry, angle, origin=(7, 3))
        shape = shapely.affinity.scale(shape, -1 if mirrored else 1, 1, origin=(7, 3))
        zones.append(Zone(zone.id, zone.name, zone.role, shape, zone.junction))
    places = places_of(zones, site_centre=None, params=TrafficParams())
    movement = junctions_of(zones, places)[0].movement
    mirror = {"left": "right", "right": "left"} if mirrored else {}
    assert {(places[a].id, places[b].id) for a, b in movement} >= set(NAMES)
    for (a, b), name in movement.items():
        expected = NAMES.get((places[a].id, places[b].id), "u_turn")
        assert name == mirror.get(expected, expected)


def test_shares_rates_and_losses():
    points = pd.concat(
        [
            *(_drive(f"t{i}", "W", "E", start=i) for i in range(3)),
            _drive("l", "W", "N"),
            _drive("lost", "W", "E").iloc[:12],
            _drive("queued", "W", "E").iloc[:2],
        ]
    )
    turns = _measured(points, lopsided_crossing())["turns"]
    cell = turns[turns["vehicle_class"] == "all"].set_index(["approach", "movement"])
    assert cell.loc[("W", "through"), "count"] == 3
    assert cell.loc[("W", "left"), "count"] == 1
    assert cell.loc[("W", "right"), "count"] == 0
    # Lost in the junction: unknown. Still on its arm at the end: not yet a turn.
    assert cell.loc[("W", "unknown"), "count"] == 1
    assert cell.loc[("W", "through"), "share"] == pytest.approx(0.75)
    assert cell.loc[("W", "right"), "share"] == 0
    # Wilson's interval of 3 in 4.
    assert cell.loc[("W", "through"), "share_lo"] == pytest.approx(0.300642, abs=1e-6)
    assert cell.loc[("W", "through"), "share_hi"] == pytest.approx(0.954413, abs=1e-6)
    assert np.isnan(cell.loc[("E", "through"), "share"])
    assert np.isnan(cell.loc[("W", "unknown"), "share"])
    assert cell.loc[("W", "through"), "rate_vph"] == pytest.approx(3 * 3600 / T[-1])


def test_doubt_about_identity_counts_as_unknown():
    points = pd.concat([_drive(f"v{i}", "W", "E", start=i / 8) for i in range(20)])
    turns = _measured(points, lopsided_crossing(), identity_probability=0.9)["turns"]
    cell = turns[turns["vehicle_class"] == "all"].set_index(["approach", "movement"])
    assert cell.loc[("W", "through"), "count"] == pytest.approx(18)
    assert cell.loc[("W", "unknown"), "count"] == pytest.approx(2)
    # Binomial(20, 0.9): quantiles 15 and 20.
    assert tuple(cell.loc[("W", "through"), ["count_lo", "count_hi"]]) == (15, 20)


def test_wavering_at_the_stop_line_is_no_u_turn():
    x = [-110, -95, -85, -80.3, -79.6, -80.2, -79.7, -80.4, -79.5, -60, -20, 20, 60, 100]
    points = path("a", np.c_[x, np.full(len(x), -12.0)], T[: len(x)])
    turns = _measured(points, lopsided_crossing())["turns"]
    seen = turns[(turns["vehicle_class"] == "all") & (turns["count"] > 0)]
    assert seen[["approach", "movement"]].to_numpy().tolist() == [["W", "through"]]


def test_a_clipped_corner_of_another_arm_is_neither_entry_nor_exit():
    zones = [*lopsided_crossing()[:2], area("N", 10, -2, 60, 60, junction="J"), lopsided_crossing()[3]]
    x = np.linspace(-110, 110, 20)
    points = path("a", np.c_[x, np.full(20, -1.0)], T[:20])
    out = _measured(points, zones)
    assert out["trajectories"]["movement"].tolist() == ["through"]


def test_two_exits_alike_are_named_by_their_ids():
    zones = [
        area("A", -100, -10, -60, 10, junction="Y"),
        area("B", 60, 5, 100, 25, junction="Y"),
        area("C", 60, -25, 100, -5, junction="Y"),
    ]
    given_centre = [Zone(z.id, z.id, z.role, z.geometry, "Y", {"junction_centre_m": [0, 0]}) for z in zones]
    places = places_of(given_centre, site_centre=None, params=TrafficParams())
    movement = {
        (places[a].id, places[b].id): name for (a, b), name in junctions_of(given_centre, places)[0].movement.items()
    }
    assert movement[("A", "B")] == "exit:B"
    assert movement[("A", "C")] == "exit:C"
    assert movement[("B", "A")] == "through"
    assert movement[("B", "C")] == "left" or movement[("B", "C")] == "u_turn"


def test_arms_drawn_as_lines_along_or_across_their_road_mean_the_same():
    along = [
        Zone("W", "W", "approach", LineString([(-110, -10), (-80, -10)]), "J"),
        Zone("E", "E", "approach", LineString([(60, -10), (110, -10)]), "J"),
        Zone("N", "N", "approach", LineString([(20, 55), (20, 30)]), "J"),
        Zone("S", "S", "approach", LineString([(20, -40), (20, -58)]), "J"),
    ]
    across = [Zone(z.id, z.id, "approach", z.geometry, "J") for z in GATES]
    points = pd.concat([_drive("a", "W", "N"), _drive("b", "S", "E")])
    for zones in (along, across):
        assert _measured(points, zones)["trajectories"]["movement"].tolist() == ["left", "right"]


def test_one_way_arms_keep_their_names():
    """Carriageways drawn apart: the exit beside the entry is a u-turn, and what cannot be left by is no rival."""
    zones = [
        gate("Win", (-90, -25), (-90, -10), junction="J", traffic="in"),
        gate("Wout", (-90, -10), (-90, 5), junction="J", traffic="out"),
        gate("Ein", (70, -10), (70, 5), junction="J", traffic="in"),
        gate("Eout", (70, -25), (70, -10), junction="J", traffic="out"),
        gate("Sin", (20, -50), (35, -50), junction="J", traffic="in"),
        gate("Sout", (5, -50), (20, -50), junction="J", traffic="out"),
    ]
    places = places_of(zones, site_centre=None, params=TrafficParams())
    movement = {(places[a].id, places[b].id): name for (a, b), name in junctions_of(zones, places)[0].movement.items()}
    assert movement == {
        ("Win", "Eout"): "through",
        ("Win", "Sout"): "right",
        ("Win", "Wout"): "u_turn",
        ("Ein", "Wout"): "through",
        ("Ein", "Sout"): "left",
        ("Ein", "Eout"): "u_turn",
        ("Sin", "Wout"): "left",
        ("Sin", "Eout"): "right",
        ("Sin", "Sout"): "u_turn",
    }
