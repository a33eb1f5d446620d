"""The ground without traffic, seen from straight above: land, roads with their paint, parked cars, shadows."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation.canvas import Canvas, Float32, oblong, shaded
from vtrack_batch.simulation.fleet import Looks, draw_looks
from vtrack_batch.simulation.paint import SHADOW_RATIO, Sun, cast_shadows, moved_up, paint_vehicles, sprites
from vtrack_batch.simulation.roads import Layout
from vtrack_batch.simulation.stage import directions
from vtrack_batch.simulation.surface import surfaces
from vtrack_batch.simulation.town import Town

STRIP_ROWS = 1024
_HALO_ROWS = 12
_BLUR = 0.32


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


@dataclass(frozen=True)
class Rows:
    """Parked cars with their places in the scene."""

    scene_m: Array
    axes: Array
    looks: Looks

    def on_ground(self, canvas: Canvas) -> Parked:
        """Return the cars in ground metres."""
        forward = directions(canvas.scene_to_ground, self.scene_m, self.axes)
        return Parked(apply(canvas.scene_to_ground, self.scene_m), forward, self.looks)


def draw_ground(canvas: Canvas, lay: Layout, town: Town, parked: Rows, light: Sun | None, *, seed: int) -> Ground:
    """Draw the ground strip by strip, so that memory is needed for little more than the result.

    Without *light* nothing casts a shadow.
    """
    height, width = canvas.shape
    rgba = np.empty((height, width, 4), np.uint8)
    table = _painter_table(canvas, parked, light)
    shadows = town_shadows(town, canvas, light) if light else None
    for first in range(0, height, STRIP_ROWS):
        last = min(first + STRIP_ROWS, height)
        # a few rows more on both sides, so that the blur does not see the strip's ends
        halo = canvas.rows(max(0, first - _HALO_ROWS), min(height, last + _HALO_ROWS))
        image, shade = _strip(halo, lay, town, moved_up(table, halo.first_row), shadows, seed)
        keep = slice(first - halo.first_row, last - halo.first_row)
        rgba[first:last, :, :3] = np.clip(image[keep] + 0.5, 0, 255)
        rgba[first:last, :, 3] = shade[keep] * 255
    return Ground(rgba, canvas.to_reference)


def bare_ground(canvas: Canvas, town: Town, light: Sun | None, *, rgb: tuple[float, float, float]) -> Ground:
    """Return a plain ground, coarse, with the shadows of the town alone: what truth without frames needs to know."""
    coarse = canvas.coarser(2.0)
    image = np.zeros((*coarse.shape, 4), np.uint8)
    image[..., :3] = np.round(rgb)
    if light:
        image[..., 3] = coarse.mask(town_shadows(town, coarse, light))
        image[..., :3] = image[..., :3] * (1 - (1 - SHADOW_RATIO) * (image[..., 3:] / 255.0))
    return Ground(image, coarse.to_reference)


def photo_ground(rgb: NDArray[np.uint8], *, to_reference: Array) -> Ground:
    """Take the picture *rgb* (H, W, 3) as the ground."""
    return Ground(np.dstack([rgb, np.zeros(rgb.shape[:2], np.uint8)]), to_reference)


def filled(rgb: NDArray[np.uint8], valid: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3) whose nearest *valid* (H, W) colours go on where it has no data of its own."""
    if valid.all():
        return rgb
    nearest = distance_transform_edt(~valid, return_distances=False, return_indices=True)
    return np.ascontiguousarray(rgb[tuple(nearest)])


def park(canvas: Canvas, lay: Layout, town: Town, count: int, *, rng: np.random.Generator) -> Rows:
    """Choose *count* of the parking spaces in the view and put a car on each, now and then a van."""
    spaces = np.vstack([lay.spaces, town.spaces])
    spaces = spaces[canvas.inside(spaces[:, :2], margin_m=-20.0)]
    spaces = spaces[np.sort(rng.permutation(len(spaces))[:count])]
    n = len(spaces)
    looks = draw_looks(n, (rng.random(n) < 0.08).astype(np.int64), rng=rng)
    turn = spaces[:, 2] + rng.normal(0, 0.02, n) + np.pi * rng.integers(0, 2, n)
    axes = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return Rows(spaces[:, :2] + rng.normal(0, 0.15, (n, 2)), axes, looks)


def town_shadows(town: Town, canvas: Canvas, light: Sun) -> list[Array]:
    """Return the outlines of what buildings, trees and bridges shade, in scene metres."""
    away = np.linalg.solve(canvas.scene_to_ground[:2, :2], light.away_m)
    outlines = []
    for row in town.buildings:
        base = oblong(row[:2], row[2:4], row[4:6])
        hull = cv2.convexHull(np.vstack([base, base + away * row[6]]).astype(np.float32))
        outlines.append(hull.reshape(-1, 2).astype(np.float64))
    outlines += [oblong(row[:2], row[2:4], row[4:6]) + away * row[6] for row in town.decks]
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    for k, (x, y, radius, height) in enumerate(town.trees):
        # a ragged crown, stretched along the sun's line by its own depth
        ragged = circle * (radius * (0.93 + 0.1 * np.sin(5 * turn + k) * np.cos(3 * turn + 2 * k)))[:, None]
        deep = np.vstack([ragged * size + away * height * up for up, size in ((0.25, 0.8), (0.6, 1.0), (0.95, 0.6))])
        deep += np.array([x, y])
        outlines.append(cv2.convexHull(deep.astype(np.float32)).reshape(-1, 2).astype(np.float64))
    return outlines


def _strip(
    strip: Canvas, lay: Layout, town: Town, table: Array, shadows: list[Array] | None, seed: int
) -> tuple[Float32, Float32]:
    """Return the colours (H, W, 3) and the shadow (H, W), 0-1, of one strip; without *shadows* nothing casts one."""
    image = surfaces(strip, lay, town, seed=seed)
    shade = np.zeros(strip.shape, np.float32)
    if shadows is not None:
        soft = cv2.GaussianBlur(strip.mask(shadows), (0, 0), max(0.3, 0.15 * strip.px_per_m))
        shade = np.asarray(soft, np.float32) / np.float32(255)
        cast_shadows(shade, table)
        shaded(image, shade)
    paint_vehicles(image, table)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), _BLUR * strip.px_per_frame_px), np.float32), shade


def _painter_table(canvas: Canvas, parked: Rows, light: Sun | None) -> Array:
    left = np.stack([-parked.axes[:, 1], parked.axes[:, 0]], axis=1)
    to_px, at = canvas.scene_to_px, parked.scene_m
    axes_px = np.stack([directions(to_px, at, parked.axes), directions(to_px, at, left)], axis=2)
    forward = directions(canvas.scene_to_ground, at, parked.axes)
    sun = light or Sun(np.zeros(2), np.array([0.0, 1.0]))
    return sprites(parked.looks, centre_px=apply(to_px, at), axes_px=axes_px, forward=forward, light=sun)
