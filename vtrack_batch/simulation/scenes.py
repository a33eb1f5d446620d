"""The built-in scenes as plain networks: nodes, edges, lane connections and signals, and who drives between which."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation.params import DemandParams, Scenario

ARMS = ("E", "N", "W", "S")
_CROSSING_ARM_M, _ROUNDABOUT_ARM_M = 450.0, 400.0
_RING_M = 20.0
_BLOCK_M = 150.0
_LINKS = ("right", "through", "through", "left")

Attributes = dict[str, Any]


@dataclass(frozen=True)
class Flow:
    """Vehicles per hour from one edge to another."""

    origin: str
    destination: str
    vph: float


@dataclass(frozen=True)
class Plan:
    """A network in SUMO's plain terms: attributes of the elements that netconvert reads, and the demand."""

    nodes: list[Attributes]
    edges: list[Attributes]
    flows: list[Flow]
    connections: Sequence[Attributes] = ()
    programs: Sequence[tuple[Attributes, list[Attributes]]] = ()


def plan(scenario: Scenario, *, reach_m: float, rng: np.random.Generator) -> Plan:
    """Return the plan of the built-in scene; roads of ``street`` reach *reach_m* from the middle to both sides."""
    if scenario.scene == "street":
        return _street(scenario.traffic, scenario.demand_vph, reach_m)
    if scenario.scene == "crossing":
        return _crossing(scenario.traffic, scenario.demand_vph, float(rng.uniform(0, 100)))
    makers: dict[str, Callable[[DemandParams, float], Plan]] = {
        "road": lambda traffic, vph: _road(traffic, vph, exit_mps=None),
        "congested": lambda traffic, vph: _road(traffic, vph, exit_mps=24 / 3.6),
        "roundabout": _roundabout,
        "motorway": _motorway,
        "grid": lambda traffic, vph: _grid(traffic, vph, 5),
        "city": lambda traffic, vph: _grid(traffic, vph, 22),
    }
    return makers[scenario.scene](scenario.traffic, scenario.demand_vph)


def plain_xml(made: Plan) -> dict[str, str]:
    """Return the plain files of a plan by the kind that netconvert gives them: nod, edg, con, tll."""
    files = {"nod": _xml("nodes", "node", made.nodes), "edg": _xml("edges", "edge", made.edges)}
    signalled = [link for link in made.connections if "tl" in link]
    if made.connections:
        bare = [{k: v for k, v in link.items() if k not in ("tl", "linkIndex")} for link in made.connections]
        files["con"] = _xml("connections", "connection", bare)
    if made.programs:
        root = Element("tlLogics")
        for logic, phases in made.programs:
            element = SubElement(root, "tlLogic", _texts(logic))
            for phase in phases:
                SubElement(element, "phase", _texts(phase))
        for link in signalled:
            SubElement(root, "connection", _texts(link))
        files["tll"] = _text(root)
    return files


def _xml(root: str, tag: str, rows: Sequence[Attributes]) -> str:
    element = Element(root)
    for row in rows:
        SubElement(element, tag, _texts(row))
    return _text(element)


def _texts(row: Attributes) -> dict[str, str]:
    return {key: f"{value:.2f}" if isinstance(value, float) else str(value) for key, value in row.items()}


def _text(element: Element) -> str:
    indent(element)
    return tostring(element, encoding="unicode") + "\n"


def _node(name: str, x: float, y: float, kind: str = "priority") -> Attributes:
    return {"id": name, "x": float(x), "y": float(y), "type": kind}


def _edge(name: str, begin: str, end: str, lanes: int, speed: float, **more: Any) -> Attributes:
    return {"id": name, "from": begin, "to": end, "numLanes": lanes, "speed": float(speed), **more}


def _shape(xy: Array) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in xy.tolist())


def _street(traffic: DemandParams, vph: float, reach_m: float) -> Plan:
    speed = traffic.speed_limit_mps or 13.9
    nodes = [_node("A", -reach_m, 0), _node("B", reach_m, 0)]
    edges = [_edge("AB", "A", "B", 1, speed), _edge("BA", "B", "A", 1, speed)]
    return Plan(nodes, edges, [Flow("AB", "AB", vph), Flow("BA", "BA", vph)])


def _road(traffic: DemandParams, vph: float, *, exit_mps: float | None) -> Plan:
    """One way, two lanes, two gentle bends; the congested one leaves over a slow kilometre."""
    speed = traffic.speed_limit_mps or 18.0
    x = np.linspace(-1000, 700, 69)
    xy = np.stack([x, 38.0 * np.sin(x / 260.0)], axis=1)
    parts = {"e0": xy[:60], "e1": xy[59:]}
    nodes = [_node(f"n{k}", *xy[at]) for k, at in enumerate((0, 59, 68))]
    edges = [
        _edge(name, f"n{k}", f"n{k + 1}", 2, (exit_mps or speed) if name == "e1" else speed, shape=_shape(part))
        for k, (name, part) in enumerate(parts.items())
    ]
    return Plan(nodes, edges, [Flow("e0", "e1", vph)])


def _crossing(traffic: DemandParams, vph: float, offset_s: float) -> Plan:
    """Four legs, three lanes in (right and through, through, left), two out, and a fixed-time signal of four groups."""
    speed = traffic.speed_limit_mps or 15.3
    nodes = [_node("c", 0, 0, "traffic_light")]
    edges, links, flows = [], [], []
    shares = {1: traffic.right_share, 2: 1 - traffic.left_share - traffic.right_share, 3: traffic.left_share}
    for k, arm in enumerate(ARMS):
        angle = k * np.pi / 2
        nodes.append(_node(arm, _CROSSING_ARM_M * np.cos(angle), _CROSSING_ARM_M * np.sin(angle)))
        edges += [_edge(f"{arm}i", arm, "c", 3, speed), _edge(f"{arm}o", "c", arm, 2, speed)]
        for n, (lane, to_lane, quarter) in enumerate(((0, 0, 1), (0, 0, 2), (1, 1, 2), (2, 1, 3))):
            link = {"from": f"{arm}i", "to": f"{ARMS[(k + quarter) % 4]}o", "fromLane": lane, "toLane": to_lane}
            links.append(link | {"tl": "c", "linkIndex": 4 * k + n})
        flows += [Flow(f"{arm}i", f"{ARMS[(k + q) % 4]}o", vph * share) for q, share in shares.items()]
    logic = {"id": "c", "type": "static", "programID": "0", "offset": offset_s}
    return Plan(nodes, edges, flows, links, [(logic, _phases(traffic))])


def _phases(traffic: DemandParams) -> list[Attributes]:
    """Return the phases of the crossing: east and west before north and south, each through and right before left."""
    phases = []
    for arms in ((0, 2), (1, 3)):
        for movements, green_s in ((("right", "through"), traffic.green_through_s), (("left",), traffic.green_left_s)):
            on = [k in arms and link in movements for k in range(4) for link in _LINKS]
            for sign, duration in (("G", green_s), ("y", traffic.amber_s), ("r", traffic.all_red_s)):
                if duration > 0:
                    phases.append({"duration": duration, "state": "".join(sign if green else "r" for green in on)})
    return phases


def _roundabout(traffic: DemandParams, vph: float) -> Plan:
    """Four single-lane arms on a ring of one lane, driven counter-clockwise."""
    speed = traffic.speed_limit_mps or 13.9
    nodes, edges, flows = [], [], []
    for k, arm in enumerate(ARMS):
        out = np.array([np.cos(k * np.pi / 2), np.sin(k * np.pi / 2)])
        nodes += [_node(arm, *(_ROUNDABOUT_ARM_M * out)), _node(f"r{arm}", *(_RING_M * out))]
        edges += [_edge(f"{arm}i", arm, f"r{arm}", 1, speed, priority=1)]
        edges += [_edge(f"{arm}o", f"r{arm}", arm, 1, speed, priority=1)]
        t = np.linspace(k, k + 1, 9) * np.pi / 2
        ring = _RING_M * np.stack([np.cos(t), np.sin(t)], axis=1)
        edges.append(_edge(f"ring{arm}", f"r{arm}", f"r{ARMS[(k + 1) % 4]}", 1, 8.3, priority=9, shape=_shape(ring)))
        for quarter, share in ((1, 0.25), (2, 0.5), (3, 0.25)):
            flows.append(Flow(f"{arm}i", f"{ARMS[(k + quarter) % 4]}o", vph * share))
    return Plan(nodes, edges, flows)


def _motorway(traffic: DemandParams, vph: float) -> Plan:
    """Two carriageways of three lanes; eastbound a ramp in, a ramp out, and a lane less beyond, where a jam begins."""
    speed = traffic.speed_limit_mps or 30.0
    places = {"m0": -1800, "m1": -220, "m2": 0, "m3": 60, "m4": 230, "m5": 420, "m6": 1200}
    nodes = [_node(name, x, 0) for name, x in places.items()]
    nodes += [_node("r0", -650, -110), _node("r1", 640, -110), _node("w0", 1200, 24), _node("w1", -1800, 24)]
    lanes = {"a": 3, "in": 4, "b": 3, "out": 4, "c": 3, "d": 2}
    edges = [
        _edge(name, *ends, lanes[name], speed if name != "d" else 0.25 * speed)
        for name, ends in zip(lanes, pairwise(places), strict=True)
    ]
    bend = np.array([[-650, -110], [-450, -60], [-300, -18], [-220, 0]], float)
    edges.append(_edge("ramp_in", "r0", "m1", 1, 16.7, shape=_shape(bend)))
    edges.append(_edge("ramp_out", "m4", "r1", 1, 16.7, shape=_shape(bend[::-1] * [-1, 1] + [10, 0])))
    edges.append(_edge("west", "w0", "w1", 3, speed))
    links = [{"from": "a", "to": "in", "fromLane": k, "toLane": k + 1} for k in range(3)]
    links += [{"from": "ramp_in", "to": "in", "fromLane": 0, "toLane": 0}]
    links += [{"from": "in", "to": "b", "fromLane": k + 1, "toLane": k} for k in range(3)]
    links += [{"from": "b", "to": "out", "fromLane": k, "toLane": k + 1} for k in range(3)]
    links += [{"from": "b", "to": "out", "fromLane": 0, "toLane": 0}]
    links += [{"from": "out", "to": "c", "fromLane": k + 1, "toLane": k} for k in range(3)]
    links += [{"from": "out", "to": "ramp_out", "fromLane": 0, "toLane": 0}]
    links += [{"from": "c", "to": "d", "fromLane": k + 1, "toLane": k} for k in range(2)]
    flows = [Flow("a", "d", 0.85 * vph), Flow("a", "ramp_out", 0.15 * vph), Flow("west", "west", 0.75 * vph)]
    return Plan(nodes, edges, [*flows, Flow("ramp_in", "d", 0.12 * vph), Flow("ramp_in", "ramp_out", 20.0)], links)


def _grid(traffic: DemandParams, vph: float, size: int) -> Plan:
    """Signals at all crossings of *size* streets each way; everybody drives from one end of a street to another."""
    speed = traffic.speed_limit_mps or 13.9
    half = (size - 1) / 2
    nodes = []
    for i in range(-1, size + 1):
        for j in range(-1, size + 1):
            inner = (0 <= i < size) + (0 <= j < size)
            if inner:
                kind = "traffic_light" if inner == 2 else "priority"
                nodes.append(_node(f"{i + 1}_{j + 1}", (i - half) * _BLOCK_M, (j - half) * _BLOCK_M, kind))
    names = {node["id"] for node in nodes}
    ends = sorted(name for name in names if not {0, size + 1}.isdisjoint(map(int, name.split("_"))))
    edges = []
    for i in range(size + 2):
        for j in range(size + 2):
            for other in (f"{i + 1}_{j}", f"{i}_{j + 1}"):
                here = f"{i}_{j}"
                if {here, other} <= names and not {here, other} <= set(ends):
                    edges += [_edge(f"{a}.{b}", a, b, 2, speed) for a, b in ((here, other), (other, here))]
    into = {name: next(edge["id"] for edge in edges if edge["from"] == name) for name in ends}
    out_of = {name: next(edge["id"] for edge in edges if edge["to"] == name) for name in ends}
    flows = [Flow(into[a], out_of[b], vph / (len(ends) - 1)) for a in ends for b in ends if a != b]
    return Plan(nodes, edges, flows)
