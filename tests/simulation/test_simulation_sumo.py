"""The truth says what SUMO says: trips, loop detectors, places of vehicles."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from simulation_scenes import BARE, mean_speeds_over_gates, scenario, sumo_loops, sumo_trips, table

from vtrack_batch.config.load import load_params
from vtrack_batch.errors import ConfigError
from vtrack_batch.simulation import sumo, traffic
from vtrack_batch.simulation.fleet import Fleet, draw_looks
from vtrack_batch.simulation.params import GroundParams, Scenario
from vtrack_batch.simulation.roadnet import Lane, RoadNet
from vtrack_batch.simulation.write import simulate

WHOLE = {
    # scene: (camera that sees the whole network, demand, length of the archive)
    "road": ({"width_px": 2300, "height_px": 200, "gsd_m": 1.0}, 2600.0, 190.0),
    "crossing": ({"width_px": 960, "height_px": 960, "gsd_m": 1.0}, 600.0, 170.0),
    "roundabout": ({"width_px": 860, "height_px": 860, "gsd_m": 1.0}, 500.0, 190.0),
    "motorway": ({"width_px": 3700, "height_px": 400, "gsd_m": 1.0}, 2400.0, 190.0),
    "grid": ({"width_px": 960, "height_px": 960, "gsd_m": 1.0}, 70.0, 280.0),
    "city": ({"width_px": 3600, "height_px": 3600, "gsd_m": 1.0}, 40.0, 600.0),
}
SLOW = [pytest.param("city", marks=pytest.mark.slow)]


@pytest.fixture(scope="module", params=["road", "crossing", "roundabout", "motorway", "grid", *SLOW])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene seen as a whole, from an empty network on."""
    camera, demand, duration_s = WHOLE[request.param]
    out = tmp_path_factory.mktemp("whole") / request.param
    simulate(
        scenario(
            scene=request.param,
            camera=camera | {"azimuth_deg": 0, "drift_px": 0},
            traffic={"demand_vph": demand},
            duration_s=duration_s,
            interval_s=5.0,
            warm_up_s=0.0,
        ),
        out,
    )
    return out


def test_trips_are_those_of_sumo(whole: Path) -> None:
    truth, trips = table(whole, "trajectories"), sumo_trips(whole)
    end_s = table(whole, "frames")["t_utc"].agg(lambda t: (t.max() - t.min()).total_seconds())
    arrived = trips[trips["arrival"].astype(float).between(0, end_s)]
    complete = truth[(truth["origin"] != "unknown") & (truth["destination"] != "unknown")]
    own = complete[complete["vehicle_id"].isin(arrived["vehicle_id"])]
    keys = ["origin", "destination"]
    assert len(arrived) > 40
    assert own.groupby(keys).size().to_dict() == arrived.groupby(keys).size().to_dict()
    # whoever is complete and not arrived is between its last gate and the end of its road
    rest = complete[~complete["vehicle_id"].isin(arrived["vehicle_id"])]
    last = table(whole, "track_points").drop_duplicates("vehicle_id", keep="last").set_index("vehicle_id")
    assert (last.loc[rest["vehicle_id"], "t_utc"] >= table(whole, "frames")["t_utc"].max() - pd.Timedelta("9s")).all()
    counted = table(whole, "od_pairs").query("vehicle_class == 'all'")
    known = counted[(counted["origin"] != "unknown") & (counted["destination"] != "unknown")]
    assert known["count"].sum() == len(complete) == len(arrived) + len(rest)


def test_travel_times_are_those_of_sumo(whole: Path) -> None:
    """From gate to gate is a trip without its two ends: some 15 m and half a vehicle at each."""
    crossings, trips = table(whole, "crossings"), sumo_trips(whole).set_index("vehicle_id")
    times = crossings.groupby("vehicle_id")["t_utc"].agg(["min", "max", "size"]).query("size == 2")
    took = (times["max"] - times["min"]).dt.total_seconds()
    trips = trips.loc[took.index]
    through = took[trips["arrival"].astype(float) >= 0]
    ends = trips.loc[through.index, "duration"].astype(float) - through
    assert len(ends) > 40
    assert ends.min() > 0.5
    assert ends.median() < 6.0


VIEWS = ["road", "congested", "crossing", "roundabout", "motorway", "grid", *SLOW]
VIEWED = {
    "motorway": {"traffic": {"demand_vph": 3000}},
    # all of it, for nobody drives from its border to the middle in time
    "city": {"camera": WHOLE["city"][0] | {"azimuth_deg": 0, "drift_px": 0}, "traffic": {"demand_vph": 150}},
}


@pytest.fixture(scope="module", params=VIEWS)
def view(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A part of a scene, as a frame shows it."""
    out = tmp_path_factory.mktemp("view") / request.param
    more = VIEWED.get(request.param, {})
    simulate(scenario(scene=request.param, duration_s=145.0, interval_s=0.5, warm_up_s=50.0, **more), out)
    return out


def test_counts_and_speeds_are_those_of_loop_detectors(view: Path) -> None:
    """A loop's speed is a vehicle's length over the time it takes from front to rear, the mean over its own length.

    The speed of a crossing is that of the centre, at the moment it is on the line. Who starts from a stop line passes a
    loop at 5 m/s and has 7 m/s in the middle of it; so what is compared is the truth's own time over the line.
    """
    crossings, loops = mean_speeds_over_gates(view), sumo_loops(view)
    # SUMO names a step by its begin, and writes vehicles down at its end
    crossings["t_s"] += 50.0 + 0.1
    speeds, compared = [], 0
    for (gate, begin), bins in loops[loops["begin"].between(60, 120)].groupby(["gate", "begin"]):
        at = crossings[crossings["gate"] == gate]
        ours = at[at["t_s"].between(begin, begin + 60, inclusive="left")]
        straddling = np.abs(at["t_s"].to_numpy()[:, None] - [begin, begin + 60]).min(axis=1, initial=np.inf) < 2.5
        # who stands on the loop while a bin ends has entered it in the one and left it in the other
        theirs, entered = bins["nVehContrib"].sum(), bins["nVehEntered"].sum()
        least, most = min(theirs, entered) - straddling.sum(), max(theirs, entered) + straddling.sum()
        assert least <= len(ours) <= most, (gate, begin)
        compared += int(theirs)
        if theirs == entered == len(ours) > 0:  # the same vehicles
            mean = ours["over_line_mps"]
            speeds.append((gate, (bins["speed"] * bins["nVehContrib"]).sum(), mean.sum(), mean.isna().any()))
    total = pd.DataFrame(speeds, columns=["gate", "loop", "own", "cut"])
    # of who is in view with the centre alone, the ends of the time over the line are not known
    assert total["cut"].mean() < 0.2
    total = total[~total["cut"]].groupby("gate")[["loop", "own"]].sum()
    assert compared > 25
    assert len(total)
    assert (total["own"] / total["loop"]).between(0.995, 1.005).all()


def test_centres_lie_half_a_length_behind_the_bumper() -> None:
    samples = pd.DataFrame(
        {"name": ["bus", "car"], "step": 0, "x": [10.0, 3.0], "y": [5.0, 4.0], "angle": [90.0, 180.0],
         "speed": [8.0, 0], "acceleration": 0.0, "odometer": 50.0, "waiting": 0.0, "lane": "l", "pos": [30.0, 20.0]}
    )  # fmt: skip
    looks = draw_looks(2, np.array([3, 0]), rng=np.random.default_rng(1))
    fleet = Fleet(("bus", "car"), np.array(["a", "b"], object), looks)
    lane = Lane("l", "e", 0, np.array([[0.0, 0], [100, 0]]), 3.2, 14.0, False, "road")
    moved = traffic.motion(samples, fleet, RoadNet((lane,), ()), period_s=0.5)
    assert np.allclose(moved.xy_m, [[10 - looks.length_m[0] / 2, 5], [3, 4 + looks.length_m[1] / 2]])
    assert moved.ahead_m.tolist() == [70.0, 80.0]


def test_queues_stand_with_their_bumpers_at_the_line(tmp_path: Path) -> None:
    """The first in a queue stop at one place whatever their length: their centres do not."""
    out = tmp_path / "out"
    simulate(scenario(duration_s=120.0, camera={"azimuth_deg": 0}, seed=9), out)
    queues, seen = table(out, "queues"), table(out, "detections")
    assert set(queues["place"]) == {"c_E", "c_N", "c_S", "c_W"}
    assert queues["length_max_m"].between(8, 350).all()
    assert (queues["vehicles_max"] >= 2).all()
    assert (queues["t_end_utc"] > queues["t_start_utc"]).all()
    centre = np.array([1920 * 0.33 / 2, -1080 * 0.33 / 2])
    west = seen[(seen["y_m"] < centre[1]) & (seen["x_m"] < centre[0]) & (seen["standing_s"] > 2)]
    front = centre[0] - (west["x_m"] + west["length_m"] / 2)
    first = front.groupby([west["t_utc"], west["y_m"].round(1)]).min()
    at_line = first[first < 20]
    assert len(at_line) > 30
    assert at_line.quantile(0.95) - at_line.quantile(0.05) < 1.5


def test_samples_divide_the_interval() -> None:
    assert [round(sumo.sample_period_s(s), 3) for s in (1.5, 0.5, 0.4, 0.7, 0.25, 0.02, 4.0)] == [
        0.5, 0.5, 0.4, 0.1, 0.1, 0.1, 0.5,
    ]  # fmt: skip


def test_states_between_samples_lie_on_the_path() -> None:
    """A steady turn and a steady acceleration, sampled twice a second, looked up at any time."""
    t = np.arange(0, 10, 0.5)
    angle, radius = 0.1 * t, 80.0
    xy = radius * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    forward = np.stack([np.cos(angle), -np.sin(angle)], axis=1)
    n, zero = len(t), np.zeros(len(t))
    moved = traffic.Motion(
        np.zeros(n, np.int64), np.arange(n), xy, forward, np.full(n, 8.0), zero, 8 * t, zero,
        np.zeros(n, np.int64), zero, ("l",), 0.5,
    )  # fmt: skip
    at = np.array([0.0, 0.13, 2.77, 9.4, 9.6])
    states = traffic.states_at(moved, at)
    assert states.frame.tolist() == [0, 1, 2, 3], "after the last sample nothing is known"
    expected = radius * np.stack([np.sin(0.1 * at), np.cos(0.1 * at)], axis=1)[:4]
    assert 0 < np.abs(states.xy_m - expected).max() < 1e-4
    line = np.array([[[20.0, 0.0], [20.0, 100.0]], [[20.0, 100.0], [20.0, 0.0]], [[20.0, -100.0], [20.0, 0.0]]])
    passed = traffic.passages(moved, line)
    assert passed["line"].tolist() == [0, 1]
    assert passed["forward"].tolist() == [True, False]
    assert np.allclose(passed["t_s"], np.arcsin(0.25) / 0.1, atol=1e-3)
    assert np.allclose(passed["way_m"], 80 * np.arcsin(0.25), atol=0.01)


def test_without_sumo_the_way_to_it_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "sumo", None)
    with pytest.raises(ConfigError, match=r'pip install "vtrack-batch\[sim\]"'):
        simulate(scenario(), tmp_path / "out")
    assert not (tmp_path / "out").exists()


NODES = """<nodes><node id="a" x="0" y="0"/><node id="b" x="300" y="0"/><node id="c" x="300" y="250"/>
<node id="d" x="640" y="-40"/></nodes>"""
EDGES = """<edges><edge id="ab" from="a" to="b"/><edge id="ba" from="b" to="a"/><edge id="bc" from="b" to="c"/>
<edge id="cb" from="c" to="b"/><edge id="bd" from="b" to="d" numLanes="2"/></edges>"""


@pytest.fixture
def own_net(tmp_path: Path) -> Path:
    (tmp_path / "t.nod.xml").write_text(NODES)
    (tmp_path / "t.edg.xml").write_text(EDGES)
    sumo._call("netconvert", ["-n", "t.nod.xml", "-e", "t.edg.xml", "-o", "t.net.xml", "--no-turnarounds"], tmp_path)
    return tmp_path / "t.net.xml"


def test_a_network_of_ones_own_gets_a_demand_between_its_ends(own_net: Path) -> None:
    out = own_net.parent / "out"
    made = scenario(network="t.net.xml", warm_up_s=60.0, duration_s=120.0, camera={"width_px": 2100, "azimuth_deg": 0})
    simulate(made, out, base=own_net.parent)
    od = table(out, "od_pairs").query("vehicle_class == 'all' and origin != 'unknown' and destination != 'unknown'")
    # in from the west and the north, out to these and the east, nobody turns back
    assert set(zip(od["origin"], od["destination"], strict=True)) == {("W", "N"), ("W", "E"), ("N", "W"), ("N", "E")}
    turns = table(out, "turns").query("vehicle_class == 'all' and movement != 'unknown'")
    assert set(turns["approach"]) == {"b_W", "b_N"}
    assert set(turns["movement"]) == {"left", "through", "right"}


def test_folders_may_be_named_from_where_one_stands(own_net: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(own_net.parent)
    made = scenario(network="t.net.xml", warm_up_s=10.0, duration_s=20.0)
    simulate(made, "here", base=".")
    simulate(made, own_net.parent / "there", base=own_net.parent)
    assert len(table(Path("here"), "detections"))
    for path in sorted((own_net.parent / "there" / "truth").rglob("*.parquet")):
        assert path.read_bytes() == (Path("here") / path.relative_to(own_net.parent / "there")).read_bytes()


def test_routes_of_ones_own_keep_their_types(own_net: Path) -> None:
    (own_net.parent / "r.rou.xml").write_text(
        '<routes><vType id="long" vClass="bus" length="14.5" width="2.4"/><vType id="sedan" length="4.1"/>'
        '<flow id="f" type="long" from="ab" to="bd" begin="0" end="60" number="4"/>'
        '<flow id="g" type="sedan" from="cb" to="bd" begin="0" end="60" number="5"/></routes>'
    )
    out = own_net.parent / "out"
    made = scenario(network="t.net.xml", routes="r.rou.xml", warm_up_s=0.0, duration_s=150.0, camera={"width_px": 2100})
    simulate(made, out, base=own_net.parent)
    trips = table(out, "trajectories").sort_values("length_m")
    assert trips["length_m"].tolist() == [4.1] * 5 + [14.5] * 4
    assert trips["vehicle_class"].tolist() == ["car"] * 5 + ["bus"] * 4
    assert trips["width_m"].tolist()[5:] == [2.4] * 4
    assert trips.groupby(["origin", "destination"]).size().sum() == 9
    assert (trips["origin"] != "unknown").all()
    assert (trips["destination"] != "unknown").all()


def test_mistakes_in_a_network_are_told(own_net: Path) -> None:
    folder = own_net.parent
    (folder / "wrong.rou.xml").write_text('<routes><trip id="x" depart="0" from="ab" to="nowhere"/></routes>')
    for changes, said in (
        ({"network": "missing.net.xml"}, r"missing\.net\.xml"),
        ({"network": "t.nod.xml"}, "no SUMO network"),
        ({"network": "t.net.xml", "routes": "wrong.rou.xml"}, "nowhere"),
        ({"network": "t.net.xml", "routes": "missing.rou.xml"}, r"missing\.rou\.xml"),
    ):
        with pytest.raises(ConfigError, match=said):
            simulate(scenario(**changes), folder / said[:4], base=folder)
        assert not (folder / said[:4]).exists(), "a second try finds no leavings of the first"
    with pytest.raises(ValueError, match="belong to a network"):
        scenario(routes="r.rou.xml")


def test_the_page_about_your_junction_can_be_followed(tmp_path: Path) -> None:
    page = Path(__file__).parents[2] / "docs" / "how-to" / "simulate-your-junction.md"
    blocks = re.findall(r"```(\w*)\n(.*?)```", page.read_text(), re.DOTALL)
    *plain, routes = (text for kind, text in blocks if kind == "xml")
    for name, text in zip(("nod", "edg", "rou"), (*plain, routes), strict=True):
        (tmp_path / f"junction.{name}.xml").write_text(text)
    (tmp_path / "scenario.yaml").write_text(next(text for kind, text in blocks if kind == "yaml"))
    command = next(text for kind, text in blocks if text.startswith("netconvert"))
    sumo._call("netconvert", command.split()[1:], tmp_path)
    made = load_params(tmp_path / "scenario.yaml", Scenario)
    ground = GroundParams.model_validate(BARE)
    changes = {"frames": False, "ground": ground, "duration_s": 60.0, "warm_up_s": 60.0}
    summary = simulate(made.model_copy(update=changes), tmp_path / "mine", base=tmp_path)
    assert 8 < summary["vehicles_per_frame"] < 40
    assert summary["trips_from_gate_to_gate"] > 5
    assert set(table(tmp_path / "mine", "turns")["approach"]) == {"middle_W", "middle_E", "middle_S"}
    assert {"W", "E", "S"} == set(table(tmp_path / "mine", "crossings")["gate"])


@pytest.mark.real
@pytest.mark.parametrize(("name", "most"), [("road", 90), ("congested", 140), ("crossing", 90), ("grid", 500)])
def test_the_pinned_scenes_run_as_given(shared_data: Path, tmp_path: Path, name: str, most: int) -> None:
    made = scenario(
        network=f"sumo/scenes/{name}/net.xml",
        routes=f"sumo/scenes/{name}/routes.rou.xml",
        warm_up_s=150.0,
        duration_s=30.0,
        camera={"width_px": 2000, "height_px": 2000, "gsd_m": 0.5} if name == "grid" else {},
        ground=BARE,
    )
    summary = simulate(made, tmp_path / name, base=shared_data)
    assert most / 8 < summary["vehicles_per_frame"] < most
    assert len(table(tmp_path / name, "crossings")) > 20
