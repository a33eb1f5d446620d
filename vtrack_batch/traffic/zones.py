"""Zones to and from GeoJSON.

RFC 7946 means WGS 84: longitude, latitude. A ``crs`` member (from before the RFC) is honoured. A survey without a CRS
has zones in its local metres, as has any file that says ``"vtrack_coordinates": "local_m"`` at the top.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import pyproj
import shapely
from shapely.geometry import mapping, shape
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from vtrack_batch.errors import ConfigError
from vtrack_batch.model.zones import ROLES, Zone

WGS84 = "EPSG:4326"
_SHAPES = {
    "gate": ("LineString",),
    "zone": ("Polygon",),
    "approach": ("Polygon", "LineString"),
    "lane": ("Polygon", "LineString"),
    "exclusion": ("Polygon",),
}
_RESERVED = ("unknown", "parked", "all")
_NUMBERS = ("width_m", "length_m")
_CHOICES = {"inward": ("left", "right"), "traffic": ("in", "out", "both")}
_KNOWN = ("id", "name", "role", "junction", "junction_centre_m", *_NUMBERS, *_CHOICES)
_ROUNDED_DEG, _ROUNDED_M = 7, 3
Transform = Callable[[np.ndarray], np.ndarray]


def parse_zones(text: str, *, crs: str | None, source: str) -> list[Zone]:
    """Return the zones of a GeoJSON FeatureCollection in the metres of the survey, in the order of the file.

    *crs* is the survey's projected CRS (``EPSG:...``), None for local metres; *source* names the file in messages.
    Raises ``ConfigError`` with one line per problem: where, what was expected, what was found.
    """
    collection = _collection(text, source)
    to_ground = _to_ground(collection, crs, source)
    problems: list[str] = []
    zones: list[Zone] = []
    seen: dict[str, int] = {}
    for index, feature in enumerate(collection["features"]):
        found: list[str] = []
        zone = _zone(feature, to_ground, found)
        name = _feature_name(index, feature)
        if zone is not None and zone.id in seen:
            found.append(f"id {zone.id!r} is already that of feature {seen[zone.id]}; ids must differ")
        if zone is not None:
            seen.setdefault(zone.id, index)
            zones.append(zone)
        problems += [f"{source}: {name}: {problem}" for problem in found]
    if problems:
        raise ConfigError("\n".join(problems))
    return zones


def doubtful_properties(zones: Sequence[Zone]) -> list[str]:
    """Return a line for each property that is none of ours but looks like one misspelt; others may stand."""
    lines = []
    for zone in zones:
        for key in zone.properties:
            near = difflib.get_close_matches(key.lower(), _KNOWN, n=1, cutoff=0.75) if key not in _KNOWN else []
            if near and near[0] not in zone.properties:
                lines.append(f'zone {zone.id}: the property "{key}" is not read; did you mean "{near[0]}"?')
    return lines


def zones_to_geojson(zones: Sequence[Zone], crs: str | None) -> dict[str, Any]:
    """Return the zones as a FeatureCollection that ``parse_zones`` reads back: WGS 84; without *crs*, local metres."""
    to_file: Transform = (lambda xy: xy) if crs is None else _transform(crs, WGS84)
    digits = _ROUNDED_M if crs is None else _ROUNDED_DEG
    features = []
    for zone in zones:
        geometry = shapely.transform(zone.geometry, to_file)
        if geometry.geom_type == "Polygon":
            geometry = orient(geometry)
        geometry = shapely.transform(geometry, lambda xy: np.round(xy, digits))
        about = {"id": zone.id, "name": zone.name, "role": zone.role, **zone.properties}
        if zone.junction is not None:
            about["junction"] = zone.junction
        features.append({"type": "Feature", "id": zone.id, "properties": about, "geometry": mapping(geometry)})
    local = {"vtrack_coordinates": "local_m"} if crs is None else {}
    return {"type": "FeatureCollection", **local, "features": features}


def _collection(text: str, source: str) -> dict[str, Any]:
    try:
        collection = json.loads(text)
    except json.JSONDecodeError as error:
        raise ConfigError(f"{source}:{error.lineno}:{error.colno}: not valid JSON: {error.msg}") from error
    kind = collection.get("type") if isinstance(collection, dict) else type(collection).__name__
    if kind != "FeatureCollection" or not isinstance(collection.get("features"), list):
        raise ConfigError(f"{source}: expected a GeoJSON FeatureCollection with features, found {kind!r}")
    return dict(collection)


def _to_ground(collection: dict[str, Any], crs: str | None, source: str) -> Transform:
    """Return the map from the file's coordinates to the survey's metres, or say why there is none."""
    unit = collection.get("vtrack_coordinates")
    if unit == "local_m":
        return lambda xy: xy
    if unit is not None:
        raise ConfigError(f'{source}: "vtrack_coordinates": expected "local_m", found {unit!r}')
    file_crs = _file_crs(collection, source)
    xy = _numbers([feature.get("geometry") for feature in collection["features"] if isinstance(feature, dict)])
    degrees = bool(len(xy)) and bool((np.abs(xy[:, 0]) <= 180).all() and (np.abs(xy[:, 1]) <= 90).all())
    if crs is None:
        tiny = degrees and bool(np.ptp(xy, axis=0).max() < 1.0)
        if file_crs is not None or tiny:
            what = f"in {file_crs}" if file_crs is not None and file_crs != WGS84 else "in degrees"
            raise ConfigError(
                f"{source}: the zones are {what}, but the survey has no CRS: set georeference.crs to a projected EPSG "
                'code, or draw the zones in local metres and add "vtrack_coordinates": "local_m" at the top of the file'
            )
        return lambda xy: xy
    if len(xy) and not degrees and (file_crs or WGS84) == WGS84:
        raise ConfigError(
            f"{source}: expected longitude and latitude in degrees (RFC 7946), found coordinates like "
            f'{xy[0, 0]:g}, {xy[0, 1]:g}: add a "crs" member with their EPSG code, or "vtrack_coordinates": "local_m" '
            f"if they are metres of the survey's {crs}"
        )
    return _transform(file_crs or WGS84, crs)


def _file_crs(collection: dict[str, Any], source: str) -> str | None:
    """Return what the ``crs`` member names as ``EPSG:n``, None without one."""
    member = collection.get("crs")
    if member is None:
        return None
    properties = member.get("properties") if isinstance(member, dict) else None
    name = str(properties.get("name")) if isinstance(properties, dict) else str(member)
    if name.upper().endswith("CRS84"):
        return WGS84
    code = re.search(r"EPSG:(?:[^:]*:)?(\d+)$", name, re.IGNORECASE)
    try:
        return pyproj.CRS.from_epsg(int(code[1])).to_string() if code else _unknown_crs(name)
    except pyproj.exceptions.CRSError as error:
        raise ConfigError(f'{source}: "crs": expected an EPSG code or CRS84, found {name!r}') from error


def _unknown_crs(name: str) -> str:
    raise pyproj.exceptions.CRSError(name)


def _transform(from_crs: str, to_crs: str) -> Transform:
    transformer = pyproj.Transformer.from_crs(from_crs, to_crs, always_xy=True)
    return lambda xy: np.stack(transformer.transform(xy[:, 0], xy[:, 1]), axis=1)


def _numbers(geometries: list[Any]) -> np.ndarray:
    """Return all coordinates (n, 2) of whatever of the geometries can be read."""
    found = [shape_of for geometry in geometries if (shape_of := _shape(geometry)) is not None]
    return shapely.get_coordinates(found)


def _shape(geometry: Any) -> BaseGeometry | None:
    try:
        return shapely.force_2d(shape(geometry))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, shapely.errors.ShapelyError):
        return None


def _zone(feature: Any, to_ground: Transform, problems: list[str]) -> Zone | None:
    """Return the zone of one feature, None where *problems* were added that leave nothing to go on with."""
    if not isinstance(feature, dict) or feature.get("type") != "Feature":
        found = feature.get("type") if isinstance(feature, dict) else type(feature).__name__
        problems.append(f"expected an object of type Feature, found {found!r}")
        return None
    properties = feature.get("properties") or {}
    if not isinstance(properties, dict):
        problems.append(f"properties: expected an object, found {type(properties).__name__}")
        return None
    name = _id(properties.get("id", feature.get("id")), problems)
    role = properties.get("role")
    if role not in ROLES:
        problems.append(f"role: expected one of {', '.join(ROLES)}, found {role!r}")
    junction = properties.get("junction")
    if role == "approach" and junction is None:
        problems.append('junction: an approach needs the property "junction", the name of the junction it leads to')
    _check_properties(properties, problems)
    geometry = _ground_shape(feature.get("geometry"), str(role), to_ground, problems)
    if geometry is None or name is None or role not in ROLES:
        return None
    rest = {key: value for key, value in properties.items() if key not in ("id", "name", "role", "junction")}
    return Zone(
        id=name,
        name=str(properties.get("name") or name),
        role=role,
        geometry=geometry,
        junction=None if junction is None else str(junction),
        properties=MappingProxyType(rest),
    )


def _id(value: Any, problems: list[str]) -> str | None:
    if value is None or isinstance(value, bool | list | dict) or not str(value).strip():
        problems.append(f"id: expected a text or number in properties.id or in the feature's id, found {value!r}")
        return None
    if str(value) in _RESERVED:
        problems.append(f"id: {value!r} has a meaning of its own in the tables; choose another")
    return str(value)


def _check_properties(properties: dict[str, Any], problems: list[str]) -> None:
    for key in _NUMBERS:
        value = properties.get(key)
        if value is not None and not (_is_number(value) and value > 0):
            problems.append(f"{key}: expected a number above 0, found {value!r}")
    centre = properties.get("junction_centre_m")
    if centre is not None and not (isinstance(centre, list) and len(centre) == 2 and all(map(_is_number, centre))):
        problems.append(f"junction_centre_m: expected [x, y] in the survey's metres, found {centre!r}")
    for key, choices in _CHOICES.items():
        if properties.get(key) is not None and properties[key] not in choices:
            problems.append(f"{key}: expected one of {', '.join(choices)}, found {properties[key]!r}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _ground_shape(geometry: Any, role: str, to_ground: Transform, problems: list[str]) -> BaseGeometry | None:
    """Return the geometry in ground metres, or add what is wrong with it to *problems*."""
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    expected = _SHAPES.get(role)
    if expected is not None and kind not in expected:
        hint = "; draw one feature for each part" if str(kind).startswith("Multi") else ""
        problems.append(f"geometry: a {role} is a {' or '.join(expected)}, found {kind}{hint}")
        return None
    drawn = _shape(geometry)
    if drawn is None or drawn.is_empty:
        problems.append(f"geometry: {'empty' if drawn is not None else 'malformed'} {kind}; draw it anew")
        return None
    ground = shapely.transform(drawn, to_ground)
    if not np.isfinite(shapely.get_coordinates(ground)).all():
        problems.append("geometry: some coordinates have no place in the survey's CRS; is the file's `crs` right?")
    elif not ground.is_valid:
        problems.append(f"geometry: {_explained(ground)}")
    elif ground.length == 0 or (kind == "Polygon" and ground.area == 0):
        problems.append(f"geometry: a {kind} without extent")
    else:
        return ground
    return None


def _explained(ground: BaseGeometry) -> str:
    reason = shapely.is_valid_reason(ground)
    if reason.startswith("Self-intersection"):
        return f"the border crosses itself ({reason}); draw the corners in order around the area"
    return f"not valid ({reason})"


def _feature_name(index: int, feature: Any) -> str:
    properties = feature.get("properties") if isinstance(feature, dict) else None
    name = (properties or {}).get("id", feature.get("id")) if isinstance(properties, dict) else None
    return f"feature {index}" + (f" (id {name!r})" if name is not None else "")
