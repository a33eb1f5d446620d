"""All that the camera can see beside the traffic: the ground, what stands on it, who walks there, the tram."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation import polyline
from vtrack_batch.simulation.canvas import Canvas, new_canvas
from vtrack_batch.simulation.fleet import draw_looks
from vtrack_batch.simulation.ground import Ground, Parked, Rows, bare_ground, draw_ground, park, photo_ground
from vtrack_batch.simulation.paint import Sun, sun
from vtrack_batch.simulation.roadnet import RoadNet
from vtrack_batch.simulation.roads import Layout, layout
from vtrack_batch.simulation.stage import Stage
from vtrack_batch.simulation.standing import Standing, raise_town
from vtrack_batch.simulation.surface import ASPHALT_RGB
from vtrack_batch.simulation.town import plan
from vtrack_batch.simulation.view import GROUND_SEED, PEOPLE_SEED, View
from vtrack_batch.simulation.walkers import People, Tram, draw_people, draw_tram

LARGEST_FINE_PX = 6_000_000
"""Frames up to this size get a ground of twice their resolution."""
_RESERVE_PX = 24


@dataclass(frozen=True)
class Scenery:
    """``standing`` is null on a photograph, whose houses and trees are part of the ground; so is ``tram`` at times."""

    ground: Ground
    parked: Parked
    standing: Standing | None
    people: People
    tram: Tram | None


def procedural(view: View, stage: Stage, net: RoadNet, *, picture: bool = True) -> Scenery:
    """Make a town around the roads of *net*, larger than the view by what the platform can wander.

    Without *picture* the ground stays plain: enough to say what hides or shades a vehicle, and quickly made.
    """
    canvas, rng, params = _canvas(view, stage), view.rng(GROUND_SEED), view.ground
    tram = _tram(view, stage)
    lay = _visible(layout(net), canvas, tram)
    town = plan(canvas, lay, params, rng=rng)
    light = sun_of(view) if view.light.shadow else None
    parked = park(canvas, lay, town, params.parked, rng=rng)
    seed = int(rng.integers(1 << 30))
    if picture:
        ground = draw_ground(canvas, lay, town, parked, light, seed=seed)
    else:
        ground = bare_ground(canvas, town, light, rgb=ASPHALT_RGB)
    return Scenery(
        ground,
        parked.on_ground(canvas),
        raise_town(town, canvas.px_per_m, _right_up(canvas), _sun_in_scene(canvas, light), rng=rng),
        draw_people(lay.walks, canvas, params.pedestrians_per_km, rng=view.rng(PEOPLE_SEED)),
        tram,
    )


def photographed(
    view: View, stage: Stage, net: RoadNet, rgb: NDArray[np.uint8], *, photo_to_reference: Array
) -> Scenery:
    """Take the picture *rgb* (H, W, 3) as the ground; nobody parks on it but those it shows."""
    canvas, empty = _canvas(view, stage), np.zeros((0, 2))
    nobody = draw_looks(0, None, rng=np.random.default_rng(0))
    walks = layout(net).walks
    people = draw_people(walks, canvas, view.ground.pedestrians_per_km, rng=view.rng(PEOPLE_SEED))
    ground = photo_ground(rgb, to_reference=photo_to_reference)
    return Scenery(ground, Rows(empty, empty, nobody).on_ground(canvas), None, people, _tram(view, stage))


def sun_of(view: View) -> Sun:
    """Return the sun of the scenario."""
    return sun(view.light.sun_azimuth_deg, view.light.sun_elevation_deg)


def _canvas(view: View, stage: Stage) -> Canvas:
    camera = view.camera
    fine = 2 if stage.width_px * stage.height_px <= LARGEST_FINE_PX else 1
    diagonal = float(np.hypot(stage.width_px, stage.height_px))
    wander = 2 * camera.drift_px + 10 * camera.jitter_px + np.deg2rad(2 * camera.rotation_deg) * diagonal / 2
    wander += (2 * camera.scale_drift + 2 * camera.perspective_per_px * diagonal / 2) * diagonal / 2
    return new_canvas(stage, fine=fine, margin_px=int(np.ceil(wander)) + _RESERVE_PX)


def _visible(lay: Layout, canvas: Canvas, tram: Tram | None) -> Layout:
    """Leave out what lies far from the canvas, and put the tram's line among the rails."""

    def near(outline: Array) -> bool:
        low, high = outline.min(axis=0), outline.max(axis=0)
        return bool((high > box[0]).all() and (low < box[1]).all())

    box = canvas.extent_m() + np.array([[-60.0], [60.0]])
    return replace(
        lay,
        asphalt=[o for o in lay.asphalt if near(o)],
        bays=[o for o in lay.bays if near(o)],
        pavements=[o for o in lay.pavements if near(o)],
        walks=[o for o in lay.walks if near(o)],
        rails=[o for o in [*lay.rails, *([tram.line] if tram else [])] if near(o)],
        lanes=[(line, width) for line, width in lay.lanes if near(line)],
        marks=[o for o in lay.marks if near(o)],
        kerbs=[kerb for kerb in lay.kerbs if near(kerb.line)],
    )


def _tram(view: View, stage: Stage) -> Tram | None:
    if view.ground.tram is None:
        return None
    to_scene = np.asarray(np.linalg.inv(stage.ground_to_reference @ stage.scene_to_ground), np.float64)
    line = polyline.clean(apply(to_scene, np.array(view.ground.tram, float)))
    return draw_tram(line, view.ground.tram_every_s, rng=view.rng(PEOPLE_SEED, 1))


def _right_up(canvas: Canvas) -> Array:
    """Return the scene's unit vectors to the right and up on the canvas, as columns (2, 2)."""
    axes = np.linalg.inv(canvas.scene_to_px[:2, :2]) @ np.diag([1.0, -1.0])
    return np.asarray(axes / np.hypot(*axes))


def _sun_in_scene(canvas: Canvas, light: Sun | None) -> Array:
    if light is None:
        return np.zeros(2)
    towards = np.linalg.solve(canvas.scene_to_ground[:2, :2], light.towards)
    return np.asarray(towards / np.hypot(*towards))
