"""The ground without traffic: a procedural town around the roads, or an orthophoto, with parked cars."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation import roads, town
from vtrack_batch.simulation.canvas import Canvas, Float32, multiscale, new_canvas, shaded
from vtrack_batch.simulation.fleet import Looks, draw_looks
from vtrack_batch.simulation.network import Network
from vtrack_batch.simulation.paint import Sun, cast_shadows, paint_vehicles, sprites
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.stage import Stage, directions

LARGEST_FINE_PX = 6_000_000
"""Frames up to this size get a ground of twice their resolution."""


@dataclass(frozen=True)
class Parked:
    """Cars that never move: places (n, 2) and unit vectors (n, 2) in ground metres, and their looks."""

    xy_m: Array
    forward: Array
    looks: Looks


@dataclass(frozen=True)
class Ground:
    """``rgba`` (H, W, 4) uint8: colour, and the share of each pixel that lies in static shadow (0-255).

    ``to_reference`` (3, 3) takes pixels of this image to pixels of the reference frame.
    """

    rgba: NDArray[np.uint8]
    to_reference: Array


def town_ground(
    network: Network, scenario: Scenario, stage: Stage, light: Sun, *, rng: np.random.Generator
) -> tuple[Ground, Parked]:
    """Render the procedural ground with its parked cars, larger than the view by what the platform can wander."""
    canvas = _canvas(scenario, stage)
    lay = roads.layout(network)
    plots = town.plan(canvas, lay, light, rng=rng)
    image = _surfaces(canvas, lay, plots, rng)
    parked = _park(canvas, lay, plots, scenario.parked, rng)
    table = sprites(parked.looks, centre_px=parked.px, axes_px=parked.axes_px, forward=parked.forward, light=light)
    shade = np.zeros(canvas.shape, np.float32)
    if scenario.shadow:
        town.cast(canvas, plots, light, shade)
        cast_shadows(shade, table)
    shaded(image, shade)
    paint_vehicles(image, table)
    town.build(canvas, plots, light, image, rng=rng)
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.32 * canvas.px_per_frame_px), np.float32)
    rgba = np.dstack([np.clip(image + 0.5, 0, 255).astype(np.uint8), (shade * 255).astype(np.uint8)])
    return Ground(rgba, canvas.to_reference), Parked(parked.xy_m, parked.forward, parked.looks)


def photo_ground(rgb: NDArray[np.uint8], *, to_reference: Array) -> tuple[Ground, Parked]:
    """Take the orthophoto *rgb* (H, W, 3) as the ground; nobody parks on it but those it shows."""
    rgba = np.dstack([rgb, np.zeros(rgb.shape[:2], np.uint8)])
    nobody = draw_looks(0, None, rng=np.random.default_rng(0))
    return Ground(rgba, to_reference), Parked(np.zeros((0, 2)), np.zeros((0, 2)), nobody)


def _canvas(scenario: Scenario, stage: Stage) -> Canvas:
    fine = 2 if stage.width_px * stage.height_px <= LARGEST_FINE_PX else 1
    diagonal = float(np.hypot(stage.width_px, stage.height_px))
    wander = 2 * scenario.drift_px + 10 * scenario.jitter_px + np.deg2rad(2 * scenario.rotation_deg) * diagonal / 2
    wander += (0.008 + 2 * scenario.perspective_per_px * diagonal / 2) * diagonal / 2
    return new_canvas(stage, fine=fine, margin_px=int(np.ceil(wander)) + 24)


def _surfaces(canvas: Canvas, lay: roads.Layout, plots: town.Plots, rng: np.random.Generator) -> Float32:
    """Return land, pavement, parking and road with their textures and markings, unshaded."""
    image = town.land(canvas, rng=rng)
    grain = cv2.GaussianBlur(rng.standard_normal(canvas.shape, np.float32), (0, 0), 0.7) * 2.2
    for polygons, rgb, rough in (
        (lay.pavements, (150, 146, 140), 5.0),
        (plots.lots, (112, 111, 110), 5.0),
        (lay.bays, (116, 114, 113), 4.0),
        (lay.roads, (101, 101, 104), 4.0),
    ):
        mask = canvas.mask(polygons)
        texture = grain * rough / 2 + rough * multiscale(canvas, (1.5, 6.0, 40.0), rng)
        flat = texture[..., None] + np.array(rgb, np.float32)
        np.copyto(image, flat, where=(mask > 127)[..., None])
    roads.wear(canvas, lay, image, rng=rng)
    roads.markings(canvas, lay, plots.lot_lines, image, rng=rng)
    return image


@dataclass(frozen=True)
class _Rows:
    """Parked cars with their place in the canvas."""

    xy_m: Array
    forward: Array
    looks: Looks
    px: Array
    axes_px: Array


def _park(canvas: Canvas, lay: roads.Layout, plots: town.Plots, count: int, rng: np.random.Generator) -> _Rows:
    """Choose *count* of the parking spaces in the view and put a car on each, now and then a van."""
    spaces = np.vstack([lay.spaces, plots.spaces])
    inside = canvas.inside(spaces[:, :2], margin_m=-20.0)
    spaces = spaces[inside]
    spaces = spaces[np.sort(rng.permutation(len(spaces))[:count])]
    n = len(spaces)
    looks = draw_looks(n, (rng.random(n) < 0.08).astype(np.int64), rng=rng)
    scene = spaces[:, :2] + rng.normal(0, 0.15, (n, 2))
    turn = spaces[:, 2] + rng.normal(0, 0.02, n) + np.pi * rng.integers(0, 2, n)
    axes = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    left = np.stack([-axes[:, 1], axes[:, 0]], axis=1)
    to_px = canvas.scene_to_px
    axes_px = np.stack([directions(to_px, scene, axes), directions(to_px, scene, left)], axis=2)
    forward = directions(canvas.scene_to_ground, scene, axes)
    return _Rows(apply(canvas.scene_to_ground, scene), forward, looks, apply(to_px, scene), axes_px)
