"""Where to count on any network: gates where roads leave the view, and the arms of the junctions in view."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from vtrack_batch.model.homography import Array, apply, corners
from vtrack_batch.simulation.roadnet import Edge, Lane, RoadNet
from vtrack_batch.simulation.stage import Stage, compass_deg

_INSET_M, _INSET_SHARE, _MORE_M = 30.0, 0.15, (0.0, 6.0, 12.0, 18.0, 24.0)
_FROM_END_M, _FROM_END_S = 8.0, 0.7
"""Distance of gates from a road's end: half a vehicle, and the way that a fast one goes between two samples."""
_BESIDE_M = 1.2
_SAME_ROAD_M = 25.0
_ARMS_M, _OFF_JUNCTION_M = (35.0, 25.0, 18.0, 12.0), 0.5
_ACROSS_M = 60.0
_THROUGH_DEG, _U_TURN_DEG = 45.0, 155.0
_COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")


@dataclass(frozen=True)
class Gate:
    """A line across a road: ``line`` (2, 2) in scene metres, inwards = from its left to its right as drawn.

    ``loops`` are the places of its lanes as SUMO knows them: lane, and metres from the lane's begin.
    """

    id: str
    line: Array
    traffic: str
    loops: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Arm:
    """One arm of a junction: its area (4, 2) in scene metres, whose first side ``ring[:2]`` is the junction's border.

    To the junction is from the left to the right of that side as drawn. ``lanes_in`` lead to it.
    """

    id: str
    junction: str
    ring: Array
    centre: Array
    traffic: str
    lanes_in: tuple[str, ...]

    @property
    def length_m(self) -> float:
        """How far the area reaches from the junction."""
        return float(np.hypot(*(self.ring[:2].mean(axis=0) - self.ring[2:].mean(axis=0))))


@dataclass(frozen=True)
class Places:
    """All gates and arms of a view."""

    gates: tuple[Gate, ...]
    arms: tuple[Arm, ...]

    def movement(self, entry: Arm, leaving: Arm) -> str:
        """Return what going from one arm of a junction to another is called, by the bearings of the arms."""
        exits = [arm for arm in self.arms if arm.junction == entry.junction and arm.traffic != "in"]
        names = {arm.id: _turn(entry, arm) for arm in exits}
        alike = Counter(names.values())[names[leaving.id]] > 1 and names[leaving.id] != "u_turn"
        return f"exit:{leaving.id}" if alike else names[leaving.id]


@dataclass(frozen=True)
class _Cut:
    """Where an edge crosses the border of the view: the point, the edge's direction there, whether it leads in."""

    edge: Edge
    at: Array
    along: Array
    inward: bool


def find_places(net: RoadNet, stage: Stage) -> Places:
    """Return the gates and arms of *net* (scene metres) in the view of *stage*.

    Gates stand where roads cross the border of the view, moved inwards by what the platform may wander, and just inside
    where roads end in the view. Arms belong to junctions with more than two roads, of which one leads to a choice; a
    roundabout is one junction.
    """
    roads = net.roads
    view = _view(net, stage)
    groups = _same_road(_cuts(net, roads, view))
    gates = [_gate(group, roads) for group in groups]
    names = _names([gate.line.mean(axis=0) for gate in gates], stage.centre_m, stage)
    named = [Gate(name, gate.line, gate.traffic, gate.loops) for name, gate in zip(names, gates, strict=True)]
    arms = [arm for junction in _junctions(net, roads) for arm in _arms(junction, roads, view, stage)]
    return Places(tuple(sorted(named, key=lambda gate: gate.id)), tuple(sorted(arms, key=lambda arm: arm.id)))


def _view(net: RoadNet, stage: Stage) -> shapely.Polygon:
    """Return the view in scene metres, a little smaller than the frame and with no junction on its border."""
    inner = [shapely.LineString(lane.shape_m) for lane in net.lanes if lane.internal and len(lane.shape_m) > 1]
    side_m = stage.gsd_m * min(stage.width_px, stage.height_px)
    views = []
    for more_m in _MORE_M:
        inset_px = (min(_INSET_M, _INSET_SHARE * side_m) + more_m) / stage.gsd_m
        outline = corners(stage.width_px, stage.height_px)
        middle = outline.mean(axis=0)
        half = np.maximum(np.abs(outline - middle) - inset_px, 1.0)
        to_scene = np.linalg.inv(stage.scene_to_ground) @ stage.reference_to_ground
        view = shapely.Polygon(apply(to_scene, middle + np.sign(outline - middle) * half))
        if not shapely.intersects(view.boundary, inner).any():
            return view
        views.append(view)
    return views[0]


def _cuts(net: RoadNet, roads: dict[str, Edge], view: shapely.Polygon) -> Iterator[_Cut]:
    into, out_of = net.road_ends
    for name in sorted(roads):
        lanes = roads[name].lanes
        line = shapely.LineString(lanes[len(lanes) // 2].shape_m)
        if not line.intersects(view):
            continue
        inset = min(_FROM_END_M + _FROM_END_S * lanes[0].speed_mps, 0.4 * line.length)
        first, last = inset * (name in into), line.length - inset * (name in out_of)
        at_border = shapely.get_coordinates(shapely.intersection(line, view.boundary))
        for s in sorted(float(line.project(shapely.Point(point))) for point in at_border):
            inward = bool(view.contains(line.interpolate(s + 1.0)))
            if inward != bool(view.contains(line.interpolate(max(s - 1.0, 0.0)))):
                # vehicles come into being, and vanish, as a whole: their centres never pass the very end
                yield _cut(roads[name], line, float(np.clip(s, first, last)), inward)
        if name in into and view.contains(line.interpolate(0.0)):
            yield _cut(roads[name], line, first, True)
        if name in out_of and view.contains(line.interpolate(line.length)):
            yield _cut(roads[name], line, last, False)


def _cut(edge: Edge, line: shapely.LineString, s: float, inward: bool) -> _Cut:
    return _Cut(edge, np.array(line.interpolate(s).coords[0]), _direction(line, s), inward)


def _direction(line: shapely.LineString, s: float) -> Array:
    """Return the unit vector (2,) along *line* at *s*, over two metres."""
    a, b = line.interpolate(max(s - 1.0, 0.0)), line.interpolate(min(s + 1.0, line.length))
    along = np.array([b.x - a.x, b.y - a.y])
    return np.asarray(along / np.hypot(*along))


def _same_road(cuts: Iterable[_Cut]) -> list[list[_Cut]]:
    """Group the two directions of one road."""
    groups: list[list[_Cut]] = []
    for cut in cuts:
        for group in groups:
            first = group[0]
            back = (first.edge.begin, first.edge.end) == (cut.edge.end, cut.edge.begin)
            if back and np.hypot(*(first.at - cut.at)) < _SAME_ROAD_M and len(group) == 1:
                group.append(cut)
                break
        else:
            groups.append([cut])
    return groups


def _gate(group: Sequence[_Cut], roads: dict[str, Edge]) -> Gate:
    first = group[0]
    lanes = [lane for cut in group for lane in roads[cut.edge.id].lanes]
    line, passed = _across(lanes, first.at, first.along if first.inward else -first.along)
    traffic = "both" if len(group) > 1 else ("in" if first.inward else "out")
    loops = [(lane.id, float(shapely.LineString(lane.shape_m).project(shapely.Point(at)))) for lane, at in passed]
    return Gate("", line, traffic, tuple(loops))


def _across(lanes: Sequence[Lane], at: Array, along: Array) -> tuple[Array, list[tuple[Lane, Array]]]:
    """Return the line (2, 2) across *lanes* through *at* with *along* leading from its left to its right.

    With it come the lanes that it crosses, and where.
    """
    side = np.array([-along[1], along[0]])
    whole = shapely.LineString([at + _ACROSS_M * side, at - _ACROSS_M * side])
    passed, extent = [], [0.0]
    for lane in lanes:
        found = shapely.get_coordinates(shapely.intersection(shapely.LineString(lane.shape_m), whole))
        if len(found):
            nearest = found[np.argmin(np.hypot(*(found - at).T))]
            passed.append((lane, nearest))
            offset = float((nearest - at) @ side)
            extent += [offset - lane.width_m / 2, offset + lane.width_m / 2]
    left, right = max(extent) + _BESIDE_M, min(extent) - _BESIDE_M
    return np.stack([at + right * side, at + left * side]), passed


@dataclass(frozen=True)
class _Crossing:
    """Edges of one junction by the road they belong to: ``legs`` maps the node beyond to edges in and edges out."""

    id: str
    centre: Array
    legs: dict[str, tuple[list[str], list[str]]]


def _junctions(net: RoadNet, roads: dict[str, Edge]) -> Iterator[_Crossing]:
    """Yield junctions with more than two roads of which at least one leaves a choice; rings as a whole."""
    ring_of = {node: ring for ring in net.roundabouts for node in ring}
    shapes = {junction.id: junction.shape_m for junction in net.junctions}
    done: set[frozenset[str]] = set()
    for junction in net.junctions:
        nodes = ring_of.get(junction.id, frozenset({junction.id}))
        if nodes in done:
            continue
        done.add(nodes)
        legs: dict[str, tuple[list[str], list[str]]] = {}
        for edge in roads.values():
            if (edge.begin in nodes) != (edge.end in nodes):
                inward = edge.end in nodes
                legs.setdefault(edge.begin if inward else edge.end, ([], []))[not inward].append(edge.id)
        ways_out = sum(bool(out) for _, out in legs.values())
        ways_in = sum(bool(into) for into, _ in legs.values())
        if len(legs) > 2 and ways_out > 1 and ways_in > 1:
            middles = [_middle(shapes[node]) for node in sorted(nodes) if len(shapes[node])]
            yield _Crossing(_short(sorted(nodes)), np.mean(middles, axis=0), legs)


def _middle(shape: Array) -> Array:
    return np.array(shapely.MultiPoint(shape).convex_hull.centroid.coords[0])


def _short(nodes: Sequence[str]) -> str:
    return nodes[0] if len(nodes) == 1 else "ring_" + nodes[0]


def _arms(junction: _Crossing, roads: dict[str, Edge], view: shapely.Polygon, stage: Stage) -> list[Arm]:
    """Return the arms of a junction, as long as there is room in the view; none unless all of them are in it."""
    for depth_m in _ARMS_M:
        rings = [_ring(roads, *edges, depth_m) for edges in junction.legs.values()]
        if view.contains(shapely.MultiPoint(np.concatenate(rings))):
            break
    else:
        return []
    centre_m = apply(stage.scene_to_ground, junction.centre[None])[0]
    names = _names([ring[2:].mean(axis=0) for ring in rings], centre_m, stage)
    return [
        Arm(
            f"{junction.id}_{name}",
            junction.id,
            ring,
            junction.centre,
            _traffic(*edges),
            tuple(lane.id for edge in edges[0] for lane in roads[edge].lanes),
        )
        for name, ring, edges in zip(names, rings, junction.legs.values(), strict=True)
    ]


def _traffic(into: list[str], out: list[str]) -> str:
    return "both" if into and out else ("in" if into else "out")


def _ring(roads: dict[str, Edge], into: list[str], out: list[str], depth_m: float) -> Array:
    """Return the area of an arm (4, 2), its side at the junction first, with the way in from left to right of it."""
    lanes = [lane for name in (*into, *out) for lane in roads[name].lanes]
    lane = roads[into[0]].lanes[0] if into else roads[out[0]].lanes[0]
    line = shapely.LineString(lane.shape_m if into else lane.shape_m[::-1])
    near_s = line.length - min(_OFF_JUNCTION_M, 0.1 * line.length)
    far_s = line.length - min(depth_m, 0.45 * line.length)
    near, _ = _across(lanes, np.array(line.interpolate(near_s).coords[0]), _direction(line, near_s))
    far, _ = _across(lanes, np.array(line.interpolate(far_s).coords[0]), _direction(line, far_s))
    return np.concatenate([near, far[::-1]])


def _names(points: Sequence[Array], centre_m: Array, stage: Stage) -> list[str]:
    """Return a name for each of the *points* by its bearing from *centre_m* on the ground, numbered where shared."""
    if not points:
        return []
    bearing = compass_deg(apply(stage.scene_to_ground, np.stack(points)) - centre_m)
    winds = [_COMPASS[round(b / 45) % 8] for b in bearing.tolist()]
    order = sorted(range(len(winds)), key=lambda k: (bearing[k] + 22.5) % 360)
    seen: Counter[str] = Counter()
    names = [""] * len(winds)
    for k in order:
        seen[winds[k]] += 1
        names[k] = winds[k] if winds.count(winds[k]) == 1 else f"{winds[k]}{seen[winds[k]]}"
    return names


def _turn(entry: Arm, leaving: Arm) -> str:
    if entry.id == leaving.id:
        return "u_turn"
    into, out = (arm.ring.mean(axis=0) - arm.centre for arm in (entry, leaving))
    turn = (np.rad2deg(np.arctan2(out[0], out[1]) - np.arctan2(into[0], into[1])) % 360) - 180
    if abs(turn) >= _U_TURN_DEG:
        return "u_turn"
    return "through" if abs(turn) < _THROUGH_DEG else ("left" if turn < 0 else "right")
