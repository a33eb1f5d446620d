"""What a road network asks to be drawn: outlines of carriageways, pavements and rails, kerbs, marks, parking spaces."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation import polyline
from vtrack_batch.simulation.marks import road_marks
from vtrack_batch.simulation.roadnet import Lane, RoadNet

BAY_M, PAVEMENT_M = 2.4, 3.0
FAST_MPS = 20.0
"""Roads on which one drives faster than this have a hard shoulder, and neither pavement nor parked cars."""
_SHOULDER_M = 1.0
_CLEAR_OF_END_M, _SHORTEST_M = 24.0, 60.0
_PITCH_M = 6.4


@dataclass(frozen=True)
class Kerb:
    """The outer edge of one direction of a road: ``line`` (n, 2) in driving direction, the land to its right."""

    line: Array
    fast: bool
    walked: bool
    """Whether the network has a pavement of its own there."""


@dataclass(frozen=True)
class Layout:
    """Polygons (k, 2) in scene metres.

    ``lanes`` are centre lines with their widths, ``spaces`` (n, 3) x, y, direction in rad, ``kerbs`` the outer edges.
    """

    asphalt: list[Array]
    bays: list[Array]
    pavements: list[Array]
    walks: list[Array]
    rails: list[Array]
    lanes: list[tuple[Array, float]]
    marks: list[Array]
    kerbs: list[Kerb]
    spaces: Array


def layout(net: RoadNet) -> Layout:
    """Return what to draw for any network; lanes without length are left out."""
    usable = [(lane, line) for lane in net.lanes if len(line := _line(lane)) > 1]
    road = [(lane, line) for lane, line in usable if lane.traffic == "road"]
    foot = [(lane, line) for lane, line in usable if lane.traffic == "foot"]
    kerbs = _kerbs(net)
    asphalt = [polyline.ribbon(line, -lane.width_m / 2 - 0.2, lane.width_m / 2 + 0.2) for lane, line in road]
    asphalt += [junction.shape_m for junction in net.junctions if len(junction.shape_m) > 2]
    asphalt += [polyline.ribbon(kerb.line, -_SHOULDER_M, 0.5) for kerb in kerbs if kerb.fast]
    pavements = [_pavement(lane, line) for lane, line in foot]
    pavements += [polyline.ribbon(kerb.line, -BAY_M - PAVEMENT_M, 0.5) for kerb in kerbs if not kerb.fast]
    pavements += _corners(net)
    bays, spaces = _parking(kerbs)
    return Layout(
        asphalt,
        bays,
        pavements,
        [line for lane, line in foot if not lane.internal and polyline.lengths(line)[-1] > 15] + _paths(kerbs),
        [line for lane, line in usable if lane.traffic == "rail"],
        [(line, lane.width_m) for lane, line in road],
        road_marks(net),
        kerbs,
        spaces,
    )


def _line(lane: Lane) -> Array:
    return polyline.clean(np.asarray(lane.shape_m, float)) if len(lane.shape_m) > 1 else np.zeros((0, 2))


def _pavement(lane: Lane, line: Array) -> Array:
    """Return the outline of a lane on foot; SUMO gives walking areas at corners by their outline already."""
    if lane.internal and len(line) > 2:
        return line
    return polyline.ribbon(line, -lane.width_m / 2, lane.width_m / 2)


def _kerbs(net: RoadNet) -> list[Kerb]:
    """Return the right edge of the outermost road lane of each edge."""
    kerbs = []
    for edge in net.edges.values():
        lanes = [lane for lane in edge.lanes if lane.traffic == "road"]
        if lanes and len(line := _line(lanes[0])) > 1:
            walked = any(lane.traffic == "foot" for lane in edge.lanes)
            kerbs.append(Kerb(polyline.parallel(line, -lanes[0].width_m / 2), lanes[0].speed_mps > FAST_MPS, walked))
    return kerbs


def _corners(net: RoadNet) -> list[Array]:
    """Return the pavements round the junctions where slow roads meet: their hulls, made wider."""
    slow = {node for e in net.edges.values() if e.lanes[0].speed_mps <= FAST_MPS for node in (e.begin, e.end)}
    slow -= {node for ring in net.roundabouts for node in ring}
    corners = []
    for junction in net.junctions:
        if junction.id in slow and len(junction.shape_m) > 2:
            hull = cv2.convexHull(junction.shape_m.astype(np.float32)).reshape(-1, 2).astype(np.float64)
            corners.append(polyline.widened(hull, BAY_M + PAVEMENT_M))
    return corners


def _paths(kerbs: list[Kerb]) -> list[Array]:
    """Return the middle of the pavements that are drawn where the network itself has none."""
    long = [k for k in kerbs if not (k.fast or k.walked) and polyline.lengths(k.line)[-1] > 15]
    return [polyline.parallel(kerb.line, -BAY_M - PAVEMENT_M / 2) for kerb in long]


def _parking(kerbs: list[Kerb]) -> tuple[list[Array], Array]:
    """Return bays along the slow roads without pavements of their own, and the spaces in them."""
    bays, spaces = [], [np.zeros((0, 3))]
    for kerb in kerbs:
        length = float(polyline.lengths(kerb.line)[-1])
        if kerb.fast or kerb.walked or length < _SHORTEST_M:
            continue
        part = polyline.cut(kerb.line, _CLEAR_OF_END_M, length - _CLEAR_OF_END_M)
        bays.append(polyline.ribbon(part, -BAY_M, 0.0))
        at = np.arange(3.5, length - 2 * _CLEAR_OF_END_M - 3.0, _PITCH_M)
        xy, direction = polyline.along(polyline.parallel(part, -BAY_M / 2), at)
        spaces.append(np.column_stack([xy, np.arctan2(direction[:, 1], direction[:, 0])]))
    return bays, np.vstack(spaces)
