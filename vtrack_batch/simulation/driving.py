"""The drive: which network, who drives on it, and SUMO's run of both."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vtrack_batch.errors import ConfigError
from vtrack_batch.simulation import sumo
from vtrack_batch.simulation.fleet import Fleet, draw_demand, fleet_of_types
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.places import Places
from vtrack_batch.simulation.roadnet import RoadNet
from vtrack_batch.simulation.scenes import Flow, plan
from vtrack_batch.simulation.traffic import Motion, motion
from vtrack_batch.simulation.zones import loops_xml

LOOP_PERIOD_S = 60.0
"""Length of the bins of SUMO's induction loops below the gates."""
_PLAN, _FLEET = 0, 1


def network(scenario: Scenario, folder: Path, *, base: Path, reach_m: float) -> Path:
    """Return the network's file: the user's own, or the built-in scene's, made in *folder*.

    Roads of the scene ``street`` reach *reach_m* from the middle. Raises ``ConfigError`` where netconvert refuses.
    """
    if scenario.network is not None:
        return (base / scenario.network).resolve()
    rng = np.random.default_rng([scenario.seed, _PLAN])
    return sumo.build_net(plan(scenario, reach_m=reach_m, rng=rng), folder)


def drive(
    scenario: Scenario, folder: Path, *, base: Path, net: RoadNet, net_file: Path, places: Places
) -> tuple[Fleet, Motion]:
    """Let SUMO drive the user's routes, or a demand drawn here; return who drove, and how.

    Raises ``ConfigError`` where SUMO refuses the network or the routes.
    """
    rng = np.random.default_rng([scenario.seed, _FLEET])
    loops = loops_xml(places, period_s=LOOP_PERIOD_S)
    if scenario.routes is not None:
        own = (base / scenario.routes).resolve()
        types = sumo.vehicle_types(own)
        driven = sumo.drive(scenario, folder, net=net_file, routes=own, loops=loops)
        each = driven.samples.drop_duplicates("name")[["name", "type"]].astype(str)
        fleet = fleet_of_types(each["name"].tolist(), each["type"].tolist(), types, rng=rng)
    else:
        end_s = scenario.warm_up_s + scenario.duration_s
        text, fleet = draw_demand(_flows(scenario, net), scenario.traffic, end_s=end_s, rng=rng)
        (folder / "routes.rou.xml").write_text(text, encoding="utf-8")
        driven = sumo.drive(scenario, folder, net=net_file, routes=folder / "routes.rou.xml", loops=loops)
    return fleet, motion(driven.samples, fleet, net, period_s=driven.period_s)


def _flows(scenario: Scenario, net: RoadNet) -> list[Flow]:
    """Return who drives from where to where: the scene's flows, or on a user's network from each end to all others."""
    if scenario.network is None:
        return plan(scenario, reach_m=1.0, rng=np.random.default_rng(0)).flows
    into, out_of = net.road_ends
    flows = []
    for origin in into:
        reached = [name for name in net.reached_from(origin) if name in out_of and not net.is_way_back(origin, name)]
        flows += [Flow(origin, name, scenario.demand_vph / len(reached)) for name in reached]
    if not flows:
        raise ConfigError("network: no road leads from one end to another; give routes of your own as `routes`")
    return flows
