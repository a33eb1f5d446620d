"""What stands beside the roads: land, buildings, trees and car parks, and the shadows that they cast."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation.canvas import Canvas, Float32, multiscale, rectangle
from vtrack_batch.simulation.paint import Sun
from vtrack_batch.simulation.roads import Layout

_ROOFS = np.array(
    [(168, 96, 74), (150, 84, 70), (176, 120, 92), (128, 98, 84), (92, 90, 94), (138, 138, 142), (196, 198, 194)],
    float,
)
_LOT_M = (34.0, 17.0)
_SPACE_M = 2.7


@dataclass(frozen=True)
class Building:
    """An upright box: middle and half size in scene metres, height, roof colour, whether it has a ridge."""

    middle: Array
    half: Array
    height_m: float
    roof: Array
    gable: bool


@dataclass(frozen=True)
class Plots:
    """All that stands on the land, in scene metres; ``trees`` (n, 4) x, y, radius, height; ``spaces`` (n, 3)."""

    buildings: list[Building]
    trees: Array
    lots: list[Array]
    lot_lines: list[Array]
    spaces: Array
    sun_scene: Array
    """Shift (2,) of a shadow per metre of height, in scene coordinates."""


def plan(canvas: Canvas, lay: Layout, light: Sun, *, rng: np.random.Generator) -> Plots:
    """Lay out buildings, car parks and trees on the land so that none touch another or a road."""
    low, high = canvas.extent_m()
    tries = int(np.prod(high - low) / 160)
    taken: list[Array] = []
    lots, buildings = [], []
    for k in range(tries):
        middle = rng.uniform(low, high)
        if k < 12:
            half = np.array(_LOT_M if rng.random() < 0.5 else _LOT_M[::-1]) / 2
        else:
            half = rng.uniform((4, 4), (12, 8) if rng.random() < 0.8 else (20, 14))
            half = half if rng.random() < 0.5 else half[::-1]
        if not _free(middle, half, lay, taken):
            continue
        taken.append(np.concatenate([middle, half]))
        if k < 12:
            lots.append((middle, half))
        else:
            buildings.append(_building(middle, half, rng))
    linear = canvas.scene_to_ground[:2, :2]
    parts = [_lot(middle, half) for middle, half in lots]
    return Plots(
        buildings,
        _trees(low, high, lay, taken, rng),
        [rectangle((m[0] - h[0], m[0] + h[0]), (m[1] - h[1], m[1] + h[1])) for m, h in lots],
        [line for lines, _ in parts for line in lines],
        np.vstack([np.zeros((0, 3)), *(spaces for _, spaces in parts)]),
        np.asarray(np.linalg.solve(linear, light.away_m)),
    )


def land(canvas: Canvas, *, rng: np.random.Generator) -> Float32:
    """Return the bare land (H, W, 3): grass, soil and paved yards, with texture of several scales."""
    kind = multiscale(canvas, (30.0, 75.0), rng)
    grass, soil = np.array([86, 102, 66], np.float32), np.array([142, 126, 102], np.float32)
    part = (1 / (1 + np.exp(-2.5 * kind)))[..., None]
    image = grass * part + soil * (1 - part)
    texture = 5 * multiscale(canvas, (0.7, 2.0), rng) + 6 * multiscale(canvas, (5.0, 14.0), rng)
    texture += cv2.GaussianBlur(rng.standard_normal(canvas.shape, np.float32), (0, 0), 0.8) * 8
    return np.asarray(image + texture[..., None] * np.array([1.0, 0.97, 0.85], np.float32), np.float32)


def cast(canvas: Canvas, plots: Plots, light: Sun, shade: Float32) -> None:
    """Raise *shade* (H, W), 0-1, by the shadows of buildings and trees."""
    polygons = []
    for building in plots.buildings:
        walls = _outline(building)
        roof = walls + plots.sun_scene * building.height_m
        polygons.append(cv2.convexHull(np.vstack([walls, roof]).astype(np.float32)).reshape(-1, 2).astype(float))
    for x, y, radius, height in plots.trees:
        round_ = _circle(np.array([x, y]), radius * 0.95)
        polygons.append(round_ + plots.sun_scene * height * 0.6)
        polygons.append(round_ + plots.sun_scene * height)
    mask = cv2.GaussianBlur(canvas.mask(polygons), (0, 0), 0.12 * canvas.px_per_m)
    np.maximum(shade, mask.astype(np.float32) / 255, out=shade)


def build(canvas: Canvas, plots: Plots, light: Sun, image: Float32, *, rng: np.random.Generator) -> None:
    """Draw roofs and tree crowns over *image*."""
    for building in plots.buildings:
        _draw_roof(canvas, building, -plots.sun_scene, image, rng)
    for tree in plots.trees:
        _draw_tree(canvas, tree, -plots.sun_scene, image, rng)


def _free(middle: Array, half: Array, lay: Layout, taken: list[Array]) -> bool:
    for axis in lay.axes:
        if abs(middle[1 - axis]) - half[1 - axis] < lay.clear_m:
            return False
    others = np.array(taken).reshape(-1, 4)
    return bool((np.abs(middle - others[:, :2]) > half + others[:, 2:] + 3.0).any(axis=1).all())


def _building(middle: Array, half: Array, rng: np.random.Generator) -> Building:
    roof = _ROOFS[rng.integers(len(_ROOFS))] + rng.normal(0, 10) + rng.normal(0, 4, 3)
    large = half.min() > 9
    return Building(middle, half, float(rng.uniform(5, 13)), roof, bool(not large and rng.random() < 0.75))


def _trees(low: Array, high: Array, lay: Layout, taken: list[Array], rng: np.random.Generator) -> Array:
    rows, others = [], np.array(taken).reshape(-1, 4)
    for _ in range(int(np.prod(high - low) / 320)):
        middle, radius = rng.uniform(low, high), rng.uniform(1.2, 4.2)
        beside_roads = all(abs(middle[1 - axis]) > lay.clear_m - 2 + radius for axis in lay.axes)
        if beside_roads and (np.abs(middle - others[:, :2]) > others[:, 2:] + 0.6 * radius).any(axis=1).all():
            rows.append([*middle, radius, rng.uniform(1.2, 2.0) * radius + 1])
    return np.array(rows, float).reshape(-1, 4)


def _lot(middle: Array, half: Array) -> tuple[list[Array], Array]:
    """Return the lines and the spaces of a car park: two rows of cars, nose to the edge."""
    long = int(half[1] > half[0])
    count = int(2 * half[long] / _SPACE_M)
    at = (np.arange(count) + 0.5 - count / 2) * _SPACE_M
    lines, spaces = [], []
    for sign in (-1, 1):
        across = sign * (half[1 - long] - 2.6)
        for a in at:
            place = np.array([a, across] if long == 0 else [across, a]) + middle
            spaces.append([*place, np.pi / 2 if long == 0 else 0.0])
            edge = a + _SPACE_M / 2
            x, y = (edge - 0.06, edge + 0.06), (across - 2.3, across + 2.3)
            lines.append((rectangle(x, y) if long == 0 else rectangle(y, x)) + middle)
    return lines, np.array(spaces, float).reshape(-1, 3)


def _outline(building: Building) -> Array:
    return rectangle((-building.half[0], building.half[0]), (-building.half[1], building.half[1])) + building.middle


def _circle(middle: Array, radius: float) -> Array:
    a = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    return np.asarray(middle + radius * np.stack([np.cos(a), np.sin(a)], axis=1))


def _draw_roof(canvas: Canvas, building: Building, sun: Array, image: Float32, rng: np.random.Generator) -> None:
    half, middle, roof = building.half, building.middle, building.roof
    long = int(half[1] > half[0])
    sun = sun / max(float(np.hypot(*sun)), 1e-9)
    for sign in (-1.0, 1.0):
        # two slopes on both sides of the ridge; a flat roof has the same light on both
        light = 1.0 + (0.16 * sign * sun[1 - long] if building.gable else 0.0)
        span = (0.0, half[1 - long]) if sign > 0 else (-half[1 - long], 0.0)
        whole = (-half[long], half[long])
        part = rectangle(whole, span) if long == 0 else rectangle(span, whole)
        canvas.fill(image, part + middle, roof * light)
        if building.gable:
            for t in np.arange(0.6, half[1 - long], 1.2):
                row = (sign * t - 0.1, sign * t + 0.1)
                tile = rectangle(whole, row) if long == 0 else rectangle(row, whole)
                canvas.fill(image, tile + middle, roof * light * 0.93)
    for _ in range(int(rng.integers(2, 3 + int(half.prod() / 18)))):
        at = middle + rng.uniform(-0.85, 0.85, 2) * half
        size = rng.uniform(0.4, 1.1, 2) if building.gable else rng.uniform(0.5, 2.0, 2)
        level = rng.choice([60.0, 110.0, 205.0]) + rng.normal(0, 10)
        canvas.fill(image, rectangle((-size[0], size[0]), (-size[1], size[1])) + at + _roof_shadow(sun), (40, 40, 42))
        canvas.fill(image, rectangle((-size[0], size[0]), (-size[1], size[1])) + at, (level, level, level * 1.02))


def _roof_shadow(sun: Array) -> Array:
    """Return the small shift (2,) of a shadow on a roof, away from the *sun*."""
    return np.asarray(-0.5 * sun)


def _draw_tree(canvas: Canvas, tree: Array, sun: Array, image: Float32, rng: np.random.Generator) -> None:
    middle, radius = tree[:2], tree[2]
    sun = sun / max(float(np.hypot(*sun)), 1e-9)
    base = np.array([62, 84, 48]) * rng.uniform(0.75, 1.15) + rng.normal(0, 4, 3)
    canvas.fill(image, _circle(middle, radius * 0.9), base * 0.72)
    for _ in range(int(8 + 4 * radius)):
        a, far = rng.uniform(0, 2 * np.pi), radius * np.sqrt(rng.random()) * 0.85
        offset = far * np.array([np.cos(a), np.sin(a)])
        lit = 0.95 + 0.30 * float(offset @ sun) / radius + rng.normal(0, 0.1)
        canvas.fill(image, _circle(middle + offset, radius * rng.uniform(0.12, 0.32)), base * lit)
