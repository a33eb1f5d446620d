"""The built-in traffic keeps to physics, to the signals and out of each other's way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import shapely

from vtrack_batch.simulation import fleet, network, traffic, zones
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.stage import local_stage


@dataclass(frozen=True)
class Run:
    scenario: Scenario
    net: network.Network
    fleet: fleet.Fleet
    states: traffic.States
    offset_s: float


def drive(scenario: Scenario, *, offset_s: float = 13.0) -> Run:
    net = network.crossing(arm_m=450.0) if scenario.scene == "crossing" else network.street(arm_m=200.0)
    vehicles = fleet.draw_fleet(net, scenario, rng=np.random.default_rng(scenario.seed))
    marks = net.marks_s(zones.gate_distances(net, local_stage(scenario)))
    states = traffic.simulate_traffic(net, vehicles, scenario, marks_s=marks, offset_s=offset_s)
    return Run(scenario, net, vehicles, states, offset_s)


@pytest.fixture(scope="module")
def fine() -> Run:
    """Two minutes seen every 0.2 s."""
    return drive(Scenario(seed=2, interval_s=0.2, duration_s=120.0, warm_up_s=120.0))


def bodies(run: Run, frame: int) -> np.ndarray:
    at = run.states.frame == frame
    vehicle, xy, ahead = run.states.vehicle[at], run.states.xy_m[at], run.states.forward[at]
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    half_l = run.fleet.looks.length_m[vehicle][:, None] / 2
    half_w = run.fleet.looks.width_m[vehicle][:, None] / 2
    corners = [xy + a * half_l * ahead + b * half_w * left for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    return shapely.polygons(np.stack(corners, axis=1))


def test_no_two_vehicles_ever_overlap(fine: Run) -> None:
    for frame in range(0, fine.scenario.frame_count, 3):
        shapes = bodies(fine, frame)
        pairs = shapely.STRtree(shapes).query(shapes, predicate="intersects")
        assert (pairs[0] == pairs[1]).all(), f"vehicles overlap in frame {frame}"


def test_speed_is_the_derivative_of_place(fine: Run) -> None:
    states, step = fine.states, fine.scenario.interval_s
    order = np.lexsort((states.frame, states.vehicle))
    vehicle, frame, xy = states.vehicle[order], states.frame[order], states.xy_m[order]
    centred = (vehicle[2:] == vehicle[:-2]) & (frame[2:] == frame[:-2] + 2)
    measured = (xy[2:] - xy[:-2])[centred] / (2 * step)
    stated = states.velocity_mps[order][1:-1][centred]
    error = np.hypot(*(measured - stated).T)
    assert 0 < np.median(error) < 0.01
    assert np.quantile(error, 0.99) < 0.25
    assert error.max() < 1.0


def test_accelerations_are_those_of_vehicles(fine: Run) -> None:
    accel = fine.states.accel_mps2
    assert 1.5 < accel.max() < 3.0
    assert -6.0 < accel.min() < -1.5
    assert np.quantile(accel, 0.001) > -4.5


def test_nobody_enters_on_red(fine: Run) -> None:
    mark = traffic.MARKS.index("edge_in")
    at = fine.states.passed_s[:, mark]
    passed = np.flatnonzero((at >= 0) & ~np.isnan(at))
    assert 40 < len(passed) < 300
    # the front passes the stop line before the centre passes the approach's edge, so look at the time of the front
    half = fine.fleet.looks.length_m[passed] / 2
    speed = np.maximum(fine.states.passed_mps[passed, mark], 1.0)
    lag = (half + network.STOP_M - network.EDGE_M) / speed
    clock = at[passed] - np.minimum(lag, 6.0) + 120.0
    group = np.array([fine.net.routes[k].group for k in fine.fleet.route])[passed]
    allowed = traffic.green_groups(fine.scenario, clock, offset_s=fine.offset_s)
    assert np.mean(allowed[np.arange(len(passed)), group]) > 0.99


def test_queues_build_and_empty(fine: Run) -> None:
    assert 30 < fine.states.standing_s.max() < 100
    speed = np.hypot(*fine.states.velocity_mps.T)
    assert 0.1 < np.mean(speed < 0.5) < 0.5
    assert 30 < np.median(speed[speed > 3] * 3.6) < 55


def test_demand_and_shares_come_out() -> None:
    scenario = Scenario(seed=5, duration_s=3600.0, warm_up_s=0.0, demand_vph=1000.0)
    net = network.crossing(arm_m=450.0)
    vehicles = fleet.draw_fleet(net, scenario, rng=np.random.default_rng(5))
    route = vehicles.route
    per_arm = np.bincount([network.ARMS.index(net.routes[k].origin) for k in route], minlength=4)
    assert (np.abs(per_arm - 1000) < 120).all()
    left = np.mean([net.routes[k].movement == "left" for k in route])
    right = np.mean([net.routes[k].movement == "right" for k in route])
    assert 0.12 < left < 0.175
    assert 0.13 < right < 0.19
    cars = np.mean(vehicles.looks.kind == 0)
    assert 0.79 < cars < 0.86


def test_routes_turn_the_way_they_say() -> None:
    for route in network.crossing(arm_m=200.0).routes:
        first, last = route.xy_m[1] - route.xy_m[0], route.xy_m[-1] - route.xy_m[-2]
        cross = (first[0] * last[1] - first[1] * last[0]) / (np.hypot(*first) * np.hypot(*last))
        assert cross == pytest.approx({"left": 1, "through": 0, "right": -1}[str(route.movement)], abs=0.02)
        steps = np.hypot(*np.diff(route.xy_m, axis=0).T)
        assert 0.0995 < steps.min() <= steps.max() < 0.1005


def test_no_demand_gives_an_empty_road() -> None:
    run = drive(Scenario(demand_vph=0.0, duration_s=3.0, warm_up_s=10.0))
    assert len(run.states.frame) == 0
    assert len(run.fleet) == 0


def test_street_runs_both_ways() -> None:
    run = drive(Scenario(scene="street", seed=3, duration_s=30.0, warm_up_s=60.0, demand_vph=600.0))
    vx, y = run.states.velocity_mps[:, 0], run.states.xy_m[:, 1]
    assert (vx > 0).any()
    assert (vx < 0).any()
    assert (np.sign(y) == -np.sign(vx)).all(), "traffic keeps to the right"
