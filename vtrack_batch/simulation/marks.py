"""Paint on the road, from the lanes of a network: lane lines, edge and centre lines, stop lines, zebras, arrows."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation import polyline
from vtrack_batch.simulation.roadnet import Edge, Lane, RoadNet

LINE_M = 0.16
_DASH_M, _PITCH_M = 3.0, 9.0
_STOP_M = 0.5
_BEFORE_STOP_M = 22.0
_SHORTEST_M = 8.0


def road_marks(net: RoadNet) -> list[Array]:
    """Return the outlines (k, 2) of all paint in scene metres."""
    signalised = {junction.id for junction in net.junctions if junction.signalised}
    two_way = {(edge.begin, edge.end) for edge in net.edges.values()}
    marks: list[Array] = []
    for edge in net.edges.values():
        lanes = [lane for lane in edge.lanes if lane.traffic == "road" and len(lane.shape_m) > 1]
        lines = [polyline.clean(np.asarray(lane.shape_m, float)) for lane in lanes]
        if not lines or polyline.lengths(lines[0])[-1] < _SHORTEST_M:
            continue
        held = edge.end in signalised
        marks += _between(lanes, lines, held)
        marks += _edges(lanes, lines, opposite=(edge.end, edge.begin) in two_way)
        if held:
            for lane, line in zip(lanes, lines, strict=True):
                marks += _at_the_stop(lane, line)
    return marks + _zebras(net.edges.values(), net.lanes)


def _between(lanes: list[Lane], lines: list[Array], held: bool) -> list[Array]:
    """Return the lines between neighbouring lanes: dashes, solid for the last metres before a stop line."""
    marks = []
    for lane, line in zip(lanes[:-1], lines[:-1], strict=True):
        side = polyline.parallel(line, lane.width_m / 2)
        length = float(polyline.lengths(side)[-1])
        solid = _BEFORE_STOP_M if held and length > 2 * _BEFORE_STOP_M else 0.0
        open_part = polyline.cut(side, 1.0, length - solid - 1.0)
        if len(open_part):
            marks += polyline.dashes(open_part, dash_m=_DASH_M, pitch_m=_PITCH_M, width_m=LINE_M)
        if solid:
            marks += _solid(polyline.cut(side, length - solid, length))
    return marks


def _edges(lanes: list[Lane], lines: list[Array], *, opposite: bool) -> list[Array]:
    """Return the solid line at the kerb and the one towards the middle of the road.

    Both directions of a two-way road draw the one between them; with a lane each it is dashed.
    """
    outer = polyline.parallel(lines[0], -lanes[0].width_m / 2 + 0.2)
    if not opposite:
        return _solid(outer) + _solid(polyline.parallel(lines[-1], lanes[-1].width_m / 2 - 0.2))
    inner = polyline.parallel(lines[-1], lanes[-1].width_m / 2)
    if len(lanes) > 1:
        return _solid(outer) + _solid(polyline.parallel(lines[-1], lanes[-1].width_m / 2 - 0.18))
    # both directions lay their dashes from the middle of the road, so that they fall on one another
    length = float(polyline.lengths(inner)[-1])
    parts = [polyline.cut(inner, s, s + _DASH_M) for s in _from_the_middle(length)]
    return _solid(outer) + [polyline.ribbon(part, -LINE_M / 2, LINE_M / 2) for part in parts if len(part)]


def _from_the_middle(length_m: float) -> Array:
    """Return where dashes begin that lie symmetrically about the middle of a line."""
    count = int((length_m / 2 - _DASH_M) / _PITCH_M)
    return np.asarray(length_m / 2 + np.arange(-count, count + 1) * _PITCH_M - _DASH_M / 2, float)


def _solid(line: Array) -> list[Array]:
    """Return a line as quadrilaterals, which fill rightly however it bends."""
    right, left = polyline.parallel(line, -LINE_M / 2), polyline.parallel(line, LINE_M / 2)
    return [np.stack([right[a], right[b], left[b], left[a]]) for a, b in pairwise(range(len(line)))]


def _at_the_stop(lane: Lane, line: Array) -> list[Array]:
    """Return the stop line of one lane and the arrows before it."""
    length = float(polyline.lengths(line)[-1])
    half = lane.width_m / 2
    marks = [polyline.ribbon(polyline.cut(line, length - _STOP_M, length), -half + 0.1, half - 0.1)]
    for before in (12.0, 34.0):
        if length > before + 10:
            shaft = polyline.cut(line, length - before, length - before + 2.6)
            (tip,), (ahead,) = polyline.along(line, length - before + 4.2)
            across = np.array([-ahead[1], ahead[0]])
            marks.append(polyline.ribbon(shaft, -0.09, 0.09))
            marks.append(np.stack([shaft[-1] - 0.35 * across, shaft[-1] + 0.35 * across, tip]))
    return marks


def _zebras(edges: Iterable[Edge], lanes: Iterable[Lane]) -> list[Array]:
    """Return the bars of the crossings for people: internal lanes of the network that are on foot and no corner."""
    known = {lane.id for edge in edges for lane in edge.lanes}
    marks = []
    for lane in lanes:
        if lane.traffic == "foot" and lane.internal and lane.id not in known and len(lane.shape_m) == 2:
            line = polyline.clean(np.asarray(lane.shape_m, float))
            if len(line) > 1:
                marks += polyline.dashes(line, dash_m=0.5, pitch_m=1.0, width_m=lane.width_m)
    return marks
