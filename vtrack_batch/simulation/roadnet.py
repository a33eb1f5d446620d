"""A SUMO network as lanes and junctions: where there is road, rail and pavement, and what leads where."""

from __future__ import annotations

import gzip
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal
from xml.etree.ElementTree import Element, ParseError, parse

import numpy as np

from vtrack_batch.errors import ConfigError
from vtrack_batch.model.homography import Array

LANE_M = 3.2
"""Width of lanes that name none: SUMO's default."""

Traffic = Literal["road", "rail", "foot"]
_RAIL = frozenset({"tram", "rail", "rail_urban", "rail_electric", "rail_fast", "subway", "cable_car"})
_FOOT = frozenset({"pedestrian", "bicycle", "wheelchair"})


@dataclass(frozen=True)
class Lane:
    """One lane: ``shape_m`` (n, 2) its centre line in scene metres, x right, y up; ``index`` 0 = the outermost."""

    id: str
    edge: str
    index: int
    shape_m: Array
    width_m: float
    speed_mps: float
    internal: bool
    traffic: Traffic


@dataclass(frozen=True)
class Junction:
    """Where edges meet: ``shape_m`` (n, 2) is its outline in scene metres, without points where it has none."""

    id: str
    shape_m: Array
    signalised: bool


@dataclass(frozen=True)
class Edge:
    """One direction of a road between two junctions, with its lanes from the outermost one inwards."""

    id: str
    begin: str
    end: str
    lanes: tuple[Lane, ...]


@dataclass(frozen=True)
class RoadNet:
    """A whole network; ``edges`` are those between junctions, ``roundabouts`` the junctions on each ring.

    ``successors`` holds for each edge those that its connections lead to.
    """

    lanes: tuple[Lane, ...]
    junctions: tuple[Junction, ...]
    edges: Mapping[str, Edge] = field(default_factory=lambda: MappingProxyType({}))
    successors: Mapping[str, frozenset[str]] = field(default_factory=lambda: MappingProxyType({}))
    roundabouts: tuple[frozenset[str], ...] = ()

    @property
    def roads(self) -> dict[str, Edge]:
        """The edges between junctions that cars use, each with those of its lanes that they use."""
        cut = {name: tuple(lane for lane in edge.lanes if lane.traffic == "road") for name, edge in self.edges.items()}
        return {name: replace(self.edges[name], lanes=lanes) for name, lanes in cut.items() if lanes}

    @property
    def road_ends(self) -> tuple[list[str], list[str]]:
        """The edges by which roads come into the network, and those by which they leave it: but for the way back."""
        roads = self.roads
        before: dict[str, set[str]] = {name: set() for name in roads}
        for name in roads:
            for after in self.successors.get(name, frozenset()) & roads.keys():
                before[after].add(name)

        def only_back(name: str, others: set[str] | frozenset[str]) -> bool:
            ends = roads[name].begin, roads[name].end
            return all((roads[other].end, roads[other].begin) == ends for other in others)

        into = [name for name in sorted(roads) if only_back(name, before[name])]
        out_of = [name for name in sorted(roads) if only_back(name, self.successors[name] & roads.keys())]
        return into, out_of

    def reached_from(self, edge: str) -> list[str]:
        """Return the edges that one can drive to from *edge*, itself included, sorted."""
        roads, seen, waiting = self.roads, {edge}, [edge]
        while waiting:
            more = (self.successors[waiting.pop()] & roads.keys()) - seen
            seen |= more
            waiting += more
        return sorted(seen)

    def is_way_back(self, edge: str, other: str) -> bool:
        """Return whether *other* runs along the same road the other way."""
        one, two = self.edges[edge], self.edges[other]
        return (one.begin, one.end) == (two.end, two.begin)

    @property
    def middle_m(self) -> Array:
        """The middle (2,) of the box around all junctions of more than two roads; without any, around all roads."""
        beyond: dict[str, set[str]] = {}
        for edge in self.roads.values():
            beyond.setdefault(edge.begin, set()).add(edge.end)
            beyond.setdefault(edge.end, set()).add(edge.begin)
        shapes = [j.shape_m for j in self.junctions if len(beyond.get(j.id, ())) > 2 and len(j.shape_m)]
        shapes = shapes or [lane.shape_m for lane in self.lanes if lane.traffic == "road"] or [np.zeros((1, 2))]
        points = np.concatenate(shapes)
        return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)


def read_net(path: str | Path) -> RoadNet:
    """Read a SUMO network (``.net.xml``, also gzipped); raises ``ConfigError`` where it is none."""
    path = Path(path)
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as stream:
            root = parse(stream).getroot()  # noqa: S314
    except (OSError, ParseError) as problem:
        raise ConfigError(f"network {path}: cannot be read ({problem})") from None
    if root.tag != "net":
        raise ConfigError(f"network {path}: is no SUMO network (found <{root.tag}>); make one with netconvert")
    edges: dict[str, Edge] = {}
    lanes: list[Lane] = []
    for element in root.iter("edge"):
        made = tuple(_lane(element, lane) for lane in element.iter("lane"))
        lanes += made
        if element.get("function", "normal") == "normal" and made:
            name = element.get("id", "")
            edges[name] = Edge(name, element.get("from", ""), element.get("to", ""), made)
    junctions = tuple(_junctions(root))
    rings = tuple(frozenset(ring.get("nodes", "").split()) for ring in root.iter("roundabout"))
    return RoadNet(tuple(lanes), junctions, MappingProxyType(edges), MappingProxyType(_successors(root, edges)), rings)


def _lane(edge: Element, lane: Element) -> Lane:
    function = edge.get("function", "normal")
    return Lane(
        id=lane.get("id", ""),
        edge=edge.get("id", ""),
        index=int(lane.get("index", "0")),
        shape_m=_points(lane.get("shape", "")),
        width_m=float(lane.get("width", LANE_M)),
        speed_mps=float(lane.get("speed", "13.89")),
        internal=function != "normal",
        traffic="foot" if function in ("crossing", "walkingarea") else _traffic(lane),
    )


def _traffic(lane: Element) -> Traffic:
    """Return what a lane carries, by whom it allows; a lane that forbids most still carries cars unless it says so."""
    if allowed := set(lane.get("allow", "").split()):
        if allowed <= _RAIL:
            return "rail"
        return "foot" if allowed <= _FOOT else "road"
    forbidden = set(lane.get("disallow", "").split())
    return "foot" if "all" in forbidden or {"passenger", "bus", "truck"} <= forbidden else "road"


def _junctions(root: Element) -> Iterator[Junction]:
    for element in root.iter("junction"):
        kind = element.get("type", "")
        if kind != "internal":
            yield Junction(element.get("id", ""), _points(element.get("shape", "")), kind.startswith("traffic_light"))


def _successors(root: Element, edges: Mapping[str, Edge]) -> dict[str, frozenset[str]]:
    found: dict[str, set[str]] = {name: set() for name in edges}
    for link in root.iter("connection"):
        begin, end = link.get("from", ""), link.get("to", "")
        if begin in found and end in edges:
            found[begin].add(end)
    return {name: frozenset(after) for name, after in found.items()}


def _points(text: str) -> Array:
    """Return the points (n, 2) of a SUMO shape; heights are left out."""
    return np.array([[float(c) for c in point.split(",")[:2]] for point in text.split()], float).reshape(-1, 2)
