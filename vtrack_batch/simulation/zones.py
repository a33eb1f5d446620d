"""Gates and arms as a GeoJSON file that a survey can name, and as loop detectors for SUMO."""

from __future__ import annotations

import json
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation.places import Places
from vtrack_batch.simulation.stage import Stage

_COMPASS = {"N": "north", "E": "east", "S": "south", "W": "west"}


def zones_geojson(places: Places, stage: Stage) -> str:
    """Return the text of the zone file: a gate across each road that leaves the view, an approach on each arm."""
    features = []
    for gate in places.gates:
        # SUMO's roads and ours are drawn inwards from left to right
        more = {"inward": "right", "traffic": gate.traffic}
        features.append(_feature(gate.id, f"gate {_spoken(gate.id)}", "gate", gate.line, stage, more))
    for arm in places.arms:
        centre = apply(stage.scene_to_ground, arm.centre[None])[0].round(3).tolist()
        more = {"junction": arm.junction, "junction_centre_m": centre, "traffic": arm.traffic}
        ring = np.concatenate([arm.ring, arm.ring[:1]])
        features.append(_feature(arm.id, f"approach {_spoken(arm.id)}", "approach", ring, stage, more))
    whole: dict[str, Any] = {"type": "FeatureCollection"}
    if stage.crs is None:
        whole["vtrack_coordinates"] = "local_m"
    else:
        authority, code = stage.crs.split(":")
        whole["crs"] = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:{authority}::{code}"}}
    return json.dumps(whole | {"features": features}, indent=1) + "\n"


def loops_xml(places: Places, *, period_s: float) -> str:
    """Return SUMO's additional file with an induction loop on each lane below each gate, named GATE@LANE."""
    root = Element("additional")
    for gate in places.gates:
        for lane, at_m in gate.loops:
            loop = {"id": f"{gate.id}@{lane}", "lane": lane, "pos": f"{at_m:.2f}", "friendlyPos": "true"}
            SubElement(root, "inductionLoop", loop | {"period": f"{period_s:g}", "file": "loops.xml"})
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def _spoken(name: str) -> str:
    *junction, wind = name.rsplit("_", 1)
    return " ".join([*junction, _COMPASS.get(wind, wind)])


def _feature(zone: str, name: str, role: str, shape: Array, stage: Stage, more: dict[str, Any]) -> dict[str, Any]:
    xy = [[round(x, 3), round(y, 3)] for x, y in apply(stage.scene_to_ground, shape).tolist()]
    geometry = {"type": "LineString", "coordinates": xy} if len(xy) == 2 else {"type": "Polygon", "coordinates": [xy]}
    return {"type": "Feature", "properties": {"id": zone, "name": name, "role": role} | more, "geometry": geometry}
