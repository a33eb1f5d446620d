"""A small lopsided network, drawn by hand, and frames of it without anything random in them."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import numpy as np

from vtrack_batch.simulation.fleet import Looks
from vtrack_batch.simulation.flight import fly
from vtrack_batch.simulation.render import Camera
from vtrack_batch.simulation.roadnet import Edge, Junction, Lane, RoadNet
from vtrack_batch.simulation.scenery import procedural
from vtrack_batch.simulation.stage import local_stage
from vtrack_batch.simulation.view import View
from vtrack_batch.simulation.view_params import CameraParams, GroundParams, LightParams

STILL = {
    "drift_px": 0.0,
    "jitter_px": 0.0,
    "rotation_deg": 0.0,
    "scale_drift": 0.0,
    "perspective_per_px": 0.0,
    "noise_dn": 0.0,
}
CALM = {"exposure_drift": 0.0, "cloud": 0.0, "haze": 0.0}


def lane(name: str, index: int, points: list[tuple[float, float]], **more: Any) -> Lane:
    rest = {"width_m": 3.0, "speed_mps": 14.0, "internal": False, "traffic": "road"} | more
    return Lane(id=f"{name}_{index}", edge=name, index=index, shape_m=np.array(points, float), **rest)


def network(*, speed_mps: float = 14.0) -> RoadNet:
    """Two lanes east, one lane west, meeting a signal at x = 0; a single one-way lane leaves it to the north."""
    east = [lane("east", i, [(-200, -4.5 + 3 * i), (-9, -4.5 + 3 * i)], speed_mps=speed_mps) for i in (0, 1)]
    west = [lane("west", 0, [(-9, 1.5), (-200, 1.5)], speed_mps=speed_mps)]
    north = [lane("north", 0, [(1.5, 9), (1.5, 150)], speed_mps=speed_mps)]
    edges = {
        "east": Edge("east", "a", "x", tuple(east)),
        "west": Edge("west", "x", "a", tuple(west)),
        "north": Edge("north", "x", "b", tuple(north)),
    }
    box = np.array([(-9, -6), (5, -6), (5, 9), (-2, 9), (-9, 3)], float)
    junctions = (
        Junction("x", box, True),
        Junction("a", np.zeros((0, 2)), False),
        Junction("b", np.zeros((0, 2)), False),
    )
    return RoadNet((*east, *west, *north), junctions, MappingProxyType(edges))


def view(*, frames: int = 3, seed: int = 4, camera: Any = (), ground: Any = (), light: Any = ()) -> View:
    size = {"width_px": 420, "height_px": 250, "gsd_m": 0.4, "azimuth_deg": 0.0}
    return View(
        CameraParams(**(size | STILL | dict(camera))),
        GroundParams(**({"parked": 9, "pedestrians_per_km": 0.0} | dict(ground))),
        LightParams(**(CALM | dict(light))),
        seed,
        1.5,
        frames,
    )


def camera_of(seen: View, net: RoadNet | None = None, *, picture: bool = True) -> Camera:
    stage = local_stage(seen.camera, middle_m=(-40.0, 10.0))
    flight = fly(seen, size_px=(stage.width_px, stage.height_px), rigid=False)
    return Camera(seen, stage, flight, procedural(seen, stage, net or network(), picture=picture))


def cars(count: int, *, rgb: tuple[float, float, float] = (220.0, 30.0, 30.0)) -> Looks:
    paint = np.tile(np.array(rgb), (count, 1))
    sizes = np.full(count, 4.5), np.full(count, 1.8), np.full(count, 1.5)
    return Looks(np.zeros(count, np.int64), *sizes, paint, paint, np.ones(count))
