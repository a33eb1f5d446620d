"""Built-in scenes and who drives on them: networks as described, demand as asked, gates and arms where roads are."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import fromstring

import numpy as np
import pytest
import shapely
from simulation_scenes import scenario

from vtrack_batch.errors import ConfigError
from vtrack_batch.model.homography import apply
from vtrack_batch.simulation import fleet, places, scenes, sumo, zones
from vtrack_batch.simulation.params import DemandParams
from vtrack_batch.simulation.roadnet import RoadNet, read_net
from vtrack_batch.simulation.scenes import Flow
from vtrack_batch.simulation.stage import Stage, local_stage
from vtrack_batch.simulation.view_params import CameraParams
from vtrack_batch.traffic.junctions import junctions_of
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.places import places_of
from vtrack_batch.traffic.zones import parse_zones

SCENES = ("road", "crossing", "roundabout", "motorway", "grid", "street")


@pytest.fixture(scope="module")
def nets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, RoadNet]:
    found = {}
    for name in SCENES:
        folder = tmp_path_factory.mktemp(name)
        made = scenes.plan(scenario(scene=name), reach_m=400.0, rng=np.random.default_rng(1))
        found[name] = read_net(sumo.build_net(made, folder))
    return found


def stage(**camera: float) -> Stage:
    return local_stage(CameraParams.model_validate(camera))


def found(net: RoadNet, **camera: float) -> places.Places:
    return places.find_places(net, stage(**camera))


@pytest.mark.parametrize(
    ("name", "gates", "arms"),
    [
        ("road", {"W": "in", "E": "out"}, 0),
        ("street", {"W": "both", "E": "both"}, 0),
        ("crossing", {"E": "both", "N": "both", "W": "both", "S": "both"}, 4),
        ("roundabout", {"E": "both", "N": "both", "W": "both", "S": "both"}, 4),
        ("motorway", {"E1": "in", "E2": "out", "E3": "out", "W1": "in", "W2": "in", "W3": "out"}, 0),
    ],
)
def test_gates_stand_where_roads_leave_the_view(
    nets: dict[str, RoadNet], name: str, gates: dict[str, str], arms: int
) -> None:
    for azimuth in (0, -9):
        at = found(nets[name], azimuth_deg=azimuth)
        assert {gate.id: gate.traffic for gate in at.gates} == gates
        assert len(at.arms) == arms
        view = stage(azimuth_deg=azimuth)
        px = apply(view.ground_to_reference @ view.scene_to_ground, np.concatenate([gate.line for gate in at.gates]))
        assert (px > 20).all()
        assert (px < np.array([1900, 1060])).all()
        # every lane of the road, and no more than a shoulder beyond
        widths = {len(gate.loops): np.hypot(*(gate.line[1] - gate.line[0])) for gate in at.gates}
        assert all(3.2 * lanes < width < 3.2 * lanes + 4.5 for lanes, width in widths.items())


def test_grid_has_a_gate_a_street_and_four_arms_a_crossing(nets: dict[str, RoadNet]) -> None:
    at = found(nets["grid"], width_px=2000, height_px=2000, gsd_m=0.5, azimuth_deg=0)
    assert len(at.gates) == 20
    assert len({gate.id for gate in at.gates}) == 20
    assert len(at.arms) == 100
    areas = shapely.polygons([arm.ring for arm in at.arms])
    assert shapely.is_valid(areas).all()
    tree = shapely.STRtree(areas)
    one, _ = tree.query(areas, predicate="overlaps")
    assert not len(one), "no arm overlaps another"
    # a view whose border runs through crossings is drawn in until it does not
    part = found(nets["grid"], width_px=1330, height_px=700, gsd_m=0.5, azimuth_deg=0)
    assert {gate.traffic for gate in part.gates} == {"both"}


@pytest.mark.parametrize("name", ["crossing", "roundabout", "grid"])
def test_movements_are_those_of_the_traffic_chapter(nets: dict[str, RoadNet], name: str) -> None:
    camera = {"width_px": 1400, "height_px": 1400, "gsd_m": 0.5, "azimuth_deg": 17}
    at = found(nets[name], **camera)
    drawn = parse_zones(zones.zones_geojson(at, stage(**camera)), crs=None, source="zones")
    known = places_of(drawn, site_centre=None, params=TrafficParams())
    arms = {arm.id: arm for arm in at.arms}
    compared = set()
    for junction in junctions_of(drawn, known):
        for (entry, leaving), movement in junction.movement.items():
            assert at.movement(arms[known[entry].id], arms[known[leaving].id]) == movement
            compared.add(movement)
    assert compared == {"left", "through", "right", "u_turn"}


def test_zones_lead_inwards(nets: dict[str, RoadNet]) -> None:
    at, view = found(nets["crossing"], azimuth_deg=20), stage(azimuth_deg=20)
    drawn = parse_zones(zones.zones_geojson(at, view), crs=None, source="zones")
    gates = [zone for zone in drawn if zone.role == "gate"]
    assert len(gates) == 4
    for zone in gates:
        (x0, y0), (x1, y1) = zone.geometry.coords
        x, y = view.centre_m
        assert zone.properties["inward"] == "right"
        assert (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) < 0, "the middle lies to the right"


def test_demand_and_shares_come_out() -> None:
    flows = [Flow("a", "x", 600.0), Flow("a", "y", 200.0), Flow("b", "x", 0.0)]
    text, drawn = fleet.draw_demand(flows, DemandParams(bus_share=0.1), end_s=7200.0, rng=np.random.default_rng(5))
    trips = fromstring(text).findall("trip")
    assert len(trips) == len(drawn) == len(set(drawn.ids.tolist()))
    to = np.array([trip.get("to") for trip in trips])
    assert abs((to == "x").sum() - 1200) < 120
    assert abs((to == "y").sum() - 400) < 70
    departs = np.array([float(trip.get("depart", "nan")) for trip in trips])
    assert (np.diff(departs) >= 0).all()
    assert 0 <= departs.min() < 30
    assert 7150 < departs.max() < 7200
    kinds = np.bincount(drawn.looks.kind, minlength=4) / len(drawn)
    assert np.allclose(kinds, [0.74, 0.08, 0.08, 0.10], atol=0.035)
    means = [drawn.looks.length_m[drawn.looks.kind == kind].mean() for kind in range(4)]
    assert np.allclose(means, [4.5, 5.6, 9.0, 12.0], atol=0.35)
    types = {row.get("id"): row for row in fromstring(text).findall("vType")}
    lengths = [float(types[trip.get("type")].get("length", "nan")) for trip in trips]
    assert np.allclose(lengths, drawn.looks.length_m)
    white = (drawn.looks.paint_rgb.mean(axis=1) > 190).mean()
    assert 0.28 < white < 0.42


def test_drivers_differ_as_much_as_asked() -> None:
    spread = {}
    for asked in (0.0, 0.15):
        demand = DemandParams(speed_spread=asked, van_share=0, lorry_share=0, bus_share=0)
        text, _ = fleet.draw_demand([Flow("a", "b", 900.0)], demand, end_s=3600.0, rng=np.random.default_rng(2))
        spread[asked] = np.std([float(row.get("speedFactor", "nan")) for row in fromstring(text).findall("vType")])
    assert spread[0.0] == 0
    assert 0.13 < spread[0.15] < 0.17


def test_nobody_drives_where_nobody_is_asked_to() -> None:
    text, drawn = fleet.draw_demand([Flow("a", "b", 0.0)], DemandParams(), end_s=60.0, rng=np.random.default_rng(1))
    assert len(drawn) == 0
    assert list(fromstring(text)) == []


def test_lanes_carry_what_they_allow(tmp_path: Path) -> None:
    (tmp_path / "a.net.xml").write_text(
        '<net><edge id="e" from="a" to="b">'
        '<lane id="e_0" index="0" allow="pedestrian" speed="1" length="9" shape="0,-4 9,-4" width="2"/>'
        '<lane id="e_1" index="1" disallow="tram" speed="13.9" length="9" shape="0,0 9,0,5"/>'
        '<lane id="e_2" index="2" allow="tram rail_urban" speed="13.9" length="9" shape="0,4 9,4"/></edge>'
        '<edge id=":b_c0" function="crossing">'
        '<lane id=":b_c0_0" index="0" speed="1" length="4" shape="1,0 1,4"/></edge>'
        '<junction id="a" type="dead_end" x="0" y="0" shape=""/>'
        '<junction id="b" type="traffic_light" x="9" y="0" shape="9,-5 9,5 12,5"/>'
        '<junction id=":b_0" type="internal" x="9" y="0"/><roundabout nodes="a b" edges="e"/></net>'
    )
    net = read_net(tmp_path / "a.net.xml")
    assert [lane.traffic for lane in net.lanes] == ["foot", "road", "rail", "foot"]
    assert [lane.width_m for lane in net.lanes] == [2.0, 3.2, 3.2, 3.2]
    assert [lane.internal for lane in net.lanes] == [False, False, False, True]
    assert net.lanes[1].shape_m.tolist() == [[0, 0], [9, 0]]
    assert [(j.id, j.signalised, len(j.shape_m)) for j in net.junctions] == [("a", False, 0), ("b", True, 3)]
    assert net.roundabouts == (frozenset({"a", "b"}),)
    assert [lane.id for lane in net.roads["e"].lanes] == ["e_1"]
    assert net.road_ends == (["e"], ["e"])
    (tmp_path / "b.net.xml").write_text("<net>")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_net(tmp_path / "b.net.xml")
