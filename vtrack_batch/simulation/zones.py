"""Gates and approaches of a scene, as a GeoJSON file that a survey can name."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation.network import ARMS, EDGE_M, LANE_M, Network
from vtrack_batch.simulation.stage import Stage

JUNCTION = "crossing"
_GATE_INSET_M, _INSET_SHARE = 30.0, 0.25
_APPROACH_M = 35.0
_BESIDE_M = 1.2
_NAMES = {"E": "east", "N": "north", "W": "west", "S": "south", "A": "begin", "B": "end"}


def gate_distances(network: Network, stage: Stage) -> dict[str, float]:
    """Return how far from the middle of the scene each arm's gate lies: some way inside the border of the frame."""
    distances = {}
    for origin in network.origins:
        reach = _reach(_direction(origin), stage)
        distances[origin] = reach - min(_GATE_INSET_M, _INSET_SHARE * reach)
    return distances


def approach_depth_m(gate_m: float) -> float:
    """Return how far from the middle of the scene an approach area begins whose arm has its gate at *gate_m*."""
    return min(EDGE_M + _APPROACH_M, gate_m - 2.0)


def zones_geojson(network: Network, stage: Stage) -> str:
    """Return the text of the zone file: a gate across each arm, and at a crossing an approach area on each."""
    features = []
    for origin, distance in gate_distances(network, stage).items():
        along = _direction(origin)
        side = np.array([-along[1], along[0]])
        low, high = _width(network)
        # drawn so that inwards is from the left to the right
        gate = np.stack([along * distance + side * high, along * distance + side * low])
        more = {"inward": "right"} | ({"junction": JUNCTION} if network.routes[0].movement else {})
        features.append(_feature(origin, f"gate {_NAMES[origin]}", "gate", gate, stage, more))
    if network.routes[0].movement:
        for origin, distance in gate_distances(network, stage).items():
            along = _direction(origin)
            side = np.array([-along[1], along[0]])
            near, far = EDGE_M, approach_depth_m(distance)
            low, high = _width(network)
            ring = [along * a + side * b for a, b in ((near, low), (far, low), (far, high), (near, high), (near, low))]
            more = {
                "junction": JUNCTION,
                "junction_centre_m": apply(stage.scene_to_ground, np.zeros((1, 2)))[0].tolist(),
            }
            features.append(_feature(f"approach_{origin}", f"approach {_NAMES[origin]}", "approach",
                                     np.array(ring), stage, more))  # fmt: skip
    whole: dict[str, Any] = {"type": "FeatureCollection"}
    if stage.crs is None:
        whole["vtrack_coordinates"] = "local_m"
    else:
        authority, code = stage.crs.split(":")
        whole["crs"] = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:{authority}::{code}"}}
    return json.dumps(whole | {"features": features}, indent=1) + "\n"


def _width(network: Network) -> tuple[float, float]:
    """Return the extent of the road to both sides of an arm's axis, seen from the middle outwards."""
    if network.routes[0].movement:
        return -2 * LANE_M - _BESIDE_M, 3 * LANE_M + _BESIDE_M
    return -LANE_M - _BESIDE_M, LANE_M + _BESIDE_M


def _direction(origin: str) -> Array:
    """Return the unit vector (2,) from the middle of the scene along the arm, in scene coordinates."""
    if origin in ARMS:
        quarter = ARMS.index(origin)
        return np.array(((1, 0), (0, 1), (-1, 0), (0, -1))[quarter], float)
    return np.array((-1.0, 0.0) if origin == "A" else (1.0, 0.0))


def _reach(along: Array, stage: Stage) -> float:
    """Return how far from the middle of the scene one can go *along* (2,) before leaving the reference frame."""
    to_frame = stage.ground_to_reference @ stage.scene_to_ground
    metres = np.arange(0.0, 1e5 * stage.gsd_m, stage.gsd_m)
    px = apply(to_frame, metres[:, None] * along)
    inside = (px > -0.5).all(axis=1) & (px[:, 0] < stage.width_px - 0.5) & (px[:, 1] < stage.height_px - 0.5)
    return float(metres[np.argmin(inside)])


def _feature(zone: str, name: str, role: str, shape: Array, stage: Stage, more: dict[str, Any]) -> dict[str, Any]:
    xy = [[round(x, 3), round(y, 3)] for x, y in apply(stage.scene_to_ground, shape).tolist()]
    geometry = {"type": "LineString", "coordinates": xy} if len(xy) == 2 else {"type": "Polygon", "coordinates": [xy]}
    return {"type": "Feature", "properties": {"id": zone, "name": name, "role": role} | more, "geometry": geometry}
