"""Drawn zones made ready for measuring: each place is a line to cross or an area to be in, and knows its inside."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon

from vtrack_batch.model.zones import Zone
from vtrack_batch.traffic.params import TrafficParams


@dataclass(frozen=True)
class Place:
    """A gate, zone, approach or lane.

    ``length_m`` is the length along the road that Edie's definitions divide by (areas only). ``inward`` is +1 where
    crossing the line from its left to its right leads inwards, else -1 (lines only).
    """

    id: str
    role: str
    shape: LineString | Polygon
    is_line: bool
    length_m: float
    inward: int
    junction: str | None
    traffic: str
    """Which traffic an arm carries: in, out or both."""


def places_of(zones: Iterable[Zone], *, site_centre: Point | None, params: TrafficParams) -> tuple[Place, ...]:
    """Return the places among the zones, sorted by id; exclusions are none.

    The inside of a gate is the side that its property ``inward`` (left, right) names; else the side of its junction's
    centre; else the side of the mean centre of all other places; else that of *site_centre*.
    """
    drawn = sorted((zone for zone in zones if zone.role != "exclusion"), key=lambda zone: zone.id)
    return tuple(_place(zone, _inside(zone, drawn, site_centre), params) for zone in drawn)


def trip_ends(places: Sequence[Place]) -> list[int]:
    """Return the places at which trips begin and end: gates and zones, or approaches where there are neither."""
    chosen = [i for i, place in enumerate(places) if place.role in ("gate", "zone")]
    return chosen or [i for i, place in enumerate(places) if place.role == "approach"]


def names_of(places: Sequence[Place]) -> dict[int, str]:
    """Return the ids of the places by their number."""
    return dict(enumerate(place.id for place in places))


def mean_centre(shapes: Iterable[LineString | Polygon]) -> Point | None:
    """Return the mean of the shapes' centroids, none for no shapes."""
    centres = [shape.centroid for shape in shapes]
    if not centres:
        return None
    return Point(np.mean([centre.x for centre in centres]), np.mean([centre.y for centre in centres]))


def _inside(zone: Zone, drawn: list[Zone], site_centre: Point | None) -> Point | None:
    others = [other for other in drawn if other.id != zone.id]
    arms = [other.geometry for other in others if zone.junction is not None and other.junction == zone.junction]
    return mean_centre(arms) or mean_centre(other.geometry for other in others) or site_centre


def _place(zone: Zone, inside: Point | None, params: TrafficParams) -> Place:
    shape, length_m, properties = zone.geometry, 0.0, zone.properties
    if isinstance(shape, LineString) and zone.role != "gate" and (zone.role == "lane" or _leads_to(shape, inside)):
        usual = params.lane_width_m if zone.role == "lane" else params.approach_width_m
        length_m = shape.length
        shape = shape.buffer(_number(properties.get("width_m"), usual) / 2, cap_style="flat")
    elif isinstance(shape, Polygon):
        length_m = _road_length(shape, properties.get("width_m"))
    return Place(
        id=zone.id,
        role=zone.role,
        shape=shape,
        is_line=isinstance(shape, LineString),
        length_m=_number(properties.get("length_m"), length_m),
        inward=_inward(shape, properties.get("inward"), inside) if isinstance(shape, LineString) else 0,
        junction=zone.junction,
        traffic=str(properties.get("traffic", "both")),
    )


def _road_length(area: Polygon, width_m: Any) -> float:
    """Return the length of road in an area: area over width where that is given, else its longer side."""
    if width_m is not None:
        return float(area.area / width_m)
    box = shapely.get_coordinates(shapely.minimum_rotated_rectangle(area))
    return float(np.hypot(*np.diff(box, axis=0).T).max())


def _leads_to(line: LineString, inside: Point | None) -> bool:
    """Return whether an arm drawn as a line runs along its road (towards the inside) rather than across it."""
    if inside is None:
        return False
    (x0, y0), (x1, y1) = line.coords[0][:2], line.coords[-1][:2]
    along = np.array([x1 - x0, y1 - y0])
    towards = np.array([inside.x - (x0 + x1) / 2, inside.y - (y0 + y1) / 2])
    return bool(abs(along @ towards) > np.sqrt(0.5) * np.linalg.norm(along) * np.linalg.norm(towards))


def _inward(line: LineString, side: Any, inside: Point | None) -> int:
    if side in ("left", "right"):
        return 1 if side == "right" else -1
    if inside is None:
        return 1
    (x0, y0), (x1, y1) = line.coords[0][:2], line.coords[-1][:2]
    left = (x1 - x0) * (inside.y - y0) - (y1 - y0) * (inside.x - x0) > 0
    return -1 if left else 1


def _number(value: Any, otherwise: float) -> float:
    return otherwise if value is None else float(value)
