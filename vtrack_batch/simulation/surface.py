"""Colours of the bare ground: fields, lawns, yards, pavements, asphalt with its wear, rails and paint."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation import polyline
from vtrack_batch.simulation.canvas import Canvas, Float32, lay, oblong
from vtrack_batch.simulation.roads import Layout
from vtrack_batch.simulation.texture import fractal, octaves
from vtrack_batch.simulation.town import Town

ASPHALT_RGB = (110.0, 110.0, 112.0)
_PAVEMENT_RGB = (148.0, 145.0, 140.0)
_BAY_RGB = (122.0, 120.0, 118.0)
_LOT_RGB = (118.0, 117.0, 116.0)
_PAINT_RGB = (206.0, 205.0, 200.0)
_GRASS, _DRY, _SOIL = np.array([[74, 86, 58], [112, 110, 84], [138, 126, 106]], np.float32)
_YARDS = np.array([(76, 90, 60), (88, 98, 70), (132, 128, 120), (150, 145, 136), (110, 106, 100), (66, 76, 54)], float)
_RAIL_GAUGE_M = 1.435
_LAND, _ROUGH, _FINE, _ROAD, _WORN, _TONE = range(1, 7)


def surfaces(strip: Canvas, roads: Layout, town: Town, *, seed: int) -> Float32:
    """Return one strip of the ground (H, W, 3) float32, unshaded; strips of one seed fit together."""
    image = _land(strip, seed)
    for row in town.yards:
        rgb = _YARDS[int(row[6] * len(_YARDS)) % len(_YARDS)] * (0.9 + 0.2 * (row[6] * 97 % 1))
        strip.fill(image, oblong(row[:2], row[2:4], row[4:6]), rgb)
    paved = np.zeros(strip.shape, np.uint8)
    for polygons, colour in (
        (roads.pavements, _PAVEMENT_RGB),
        (town.lots, _LOT_RGB),
        (roads.bays, _BAY_RGB),
        (_beds(roads), _PAVEMENT_RGB),
        (roads.asphalt, ASPHALT_RGB),
    ):
        mask = strip.mask(polygons)
        lay(image, mask, np.array(colour, np.float32))
        np.maximum(paved, mask, out=paved)
    tone = _wear(strip, roads, seed)
    _texture(strip, image, paved, tone, seed)
    _paint(strip, image, [*roads.marks, *town.lines], seed)
    for rail in roads.rails:
        for side in (-_RAIL_GAUGE_M / 2, _RAIL_GAUGE_M / 2):
            outline = polyline.ribbon(polyline.parallel(rail, side), -0.06, 0.06)
            strip.fill(image, outline, (92, 88, 86))
    return image


def _land(strip: Canvas, seed: int) -> Float32:
    """Return grass, dry grass and soil, mixed by the place."""
    green = 1 / (1 + np.exp(-3.0 * _noise(strip, 12.0, 160.0, seed + _LAND)))
    bare = 1 / (1 + np.exp(5.0 - 5.0 * _noise(strip, 6.0, 90.0, seed + _ROUGH)))
    image = np.empty((*strip.shape, 3), np.float32)
    for c in range(3):
        image[..., c] = _DRY[c] + green * (_GRASS[c] - _DRY[c])
        image[..., c] += bare * (_SOIL[c] - image[..., c])
    return image


def _texture(strip: Canvas, image: Float32, paved: NDArray[np.uint8], tone: Float32, seed: int) -> None:
    """Vary brightness on all scales, land more than what is paved, and put the roads' wear on top."""
    fine = _noise(strip, 0.15, 5.0, seed + _FINE)
    wide = _noise(strip, 5.0, 80.0, seed + _TONE)
    hard = paved.astype(np.float32) / np.float32(255)
    change = (11.0 - 7.6 * hard) * fine + (6.0 - 1.5 * hard) * wide + hard * tone
    for c, share in enumerate((1.0, 0.98, 0.92)):
        image[..., c] += change * np.float32(share)


def _noise(strip: Canvas, finest_m: float, coarsest_m: float, seed: int) -> Float32:
    cells = octaves(strip.px_per_m, finest_m, coarsest_m)
    return fractal(strip.shape, cells_px=cells, seed=seed, first_row=strip.first_row)


def _beds(roads: Layout) -> list[Array]:
    return [polyline.ribbon(rail, -1.5, 1.5) for rail in roads.rails]


def _wear(strip: Canvas, roads: Layout, seed: int) -> Float32:
    """Return what wheels, oil, patches and cracks add to the roads (H, W)."""
    # 128 is nothing: fills of bytes are smooth at their edges and cost a quarter of those of floats
    levels = np.full(strip.shape, 128, np.uint8)
    rng = np.random.default_rng([seed, _WORN])
    for line, width in roads.lanes:
        age = float(np.clip(rng.normal(0, 3.5), -7, 7))
        strip.add(levels, polyline.ribbon(line, -width / 2, width / 2), round(128 + age))
        for offset, half, level in ((0.8, 0.28, 4.0), (-0.8, 0.28, 4.0), (0.0, 0.4, -5.0)):
            track = polyline.parallel(line, offset)
            strip.add(levels, polyline.ribbon(track, -half, half), round(128 + age + level))
    tone = np.asarray(cv2.GaussianBlur(levels, (0, 0), max(0.3, 0.3 * strip.px_per_m)), np.float32)
    levels[:] = 128
    for line, width in roads.lanes:
        length = float(polyline.lengths(line)[-1])
        for _ in range(rng.poisson(length / 22.0)):
            begin, size, level = rng.uniform(0, length), rng.uniform(1.0, 14.0), rng.normal(0, 7)
            side, wide = rng.uniform(-0.3, 0.3) * width, rng.uniform(0.3, 0.8)
            part = polyline.cut(polyline.parallel(line, side), begin, begin + size)
            if len(part):
                strip.add(levels, polyline.ribbon(part, -wide, wide), round(np.clip(128 + level, 90, 160)))
        for _ in range(rng.poisson(length / 30.0)):
            (at,), _ = polyline.along(line, rng.uniform(0, length))
            crack = at + np.cumsum(rng.normal(0, 0.7, (7, 2)), axis=0)
            strip.add(levels, polyline.ribbon(crack, -0.05, 0.05), 112)
    return np.asarray(tone + levels.astype(np.float32) - 256, np.float32)


def _paint(strip: Canvas, image: Float32, outlines: list[Array], seed: int) -> None:
    """Paint the marks, worn in places."""
    mask = strip.mask(outlines)
    worn = np.clip(0.62 + 0.2 * _noise(strip, 0.4, 25.0, seed + _WORN), 0.1, 0.92)
    lay(image, (mask * worn).astype(np.uint8), np.array(_PAINT_RGB, np.float32))
