"""Where things stand beside the roads: buildings, car parks, trees, bridges, none in another's way."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation import polyline
from vtrack_batch.simulation.canvas import Canvas, oblong
from vtrack_batch.simulation.roads import BAY_M, PAVEMENT_M, Layout
from vtrack_batch.simulation.view_params import GroundParams

_SAMPLE_M = 4.0
_BESIDE_M = BAY_M + PAVEMENT_M + 1.0
_LOT_HALF_M = np.array([17.0, 8.5])
_LOTS_PER_HA = 0.5
_SPACE_M = 2.7
_DECK_M = 5.5
_HEDGED = 0.4
_FAST_CLEAR_M, _UNBUILT = 18.0, 200
"""Land along fast roads and between their carriageways grows trees, but no houses."""
_WIDEST_M = 60.0


@dataclass(frozen=True)
class Town:
    """What stands on the land, in scene metres.

    ``buildings`` (n, 7): x, y, half length, half width, direction of the length (x, y), height.
    ``trees`` (n, 4): x, y, radius, height. ``decks`` (n, 7): bridges, as buildings without walls.
    ``yards`` (n, 7): pieces of land of one kind, as buildings, with a number 0-1 for the kind in place of the height.
    ``spaces`` (n, 3): x, y, direction (rad) of the spaces of the car parks ``lots`` with their ``lines``.
    """

    buildings: Array
    trees: Array
    decks: Array
    yards: Array
    lots: list[Array]
    lines: list[Array]
    spaces: Array


@dataclass
class _Land:
    """What is taken, on a coarse canvas: ``taken`` (H, W) uint8, of which ``road`` holds the carriageways alone.

    ``roads`` finds the nearest piece of a lane, ``heading`` is its unit vector.
    """

    canvas: Canvas
    taken: NDArray[np.uint8]
    road: NDArray[np.uint8]
    roads: cKDTree
    heading: Array

    def direction(self, at: Array) -> Array:
        """Return the unit vector (2,) along the nearest road."""
        return np.asarray(self.heading[self.roads.query(at)[1]])

    def claim(self, outline: Array, *, margin_m: float, whatever: bool = False) -> bool:
        """Take the convex *outline* (k, 2) if it lies wholly on the canvas and is free (or *whatever*); says if so."""
        middle = outline.mean(axis=0)
        reach = outline - middle
        wide = middle + reach * (1 + margin_m / np.maximum(np.hypot(*reach.T), 0.1))[:, None]
        px = np.round(apply(self.canvas.scene_to_px, wide)).astype(np.int32)
        low, high = px.min(axis=0), px.max(axis=0) + 1
        if (low < 0).any() or (high > self.canvas.shape[::-1]).any():
            return False
        view = self.taken[low[1] : high[1], low[0] : high[0]]
        wanted = cv2.fillConvexPoly(np.zeros(view.shape, np.uint8), px - low, 1)
        if not whatever and (view[wanted > 0] > 0).any():
            return False
        view[wanted > 0] = 255
        return True


def plan(canvas: Canvas, lay: Layout, params: GroundParams, *, rng: np.random.Generator) -> Town:
    """Lay out the land: lots and houses along the roads first, then houses behind them, then trees."""
    land = _free_land(canvas.coarser(1.0), lay)
    hectares = float(np.prod(np.array(land.canvas.shape, float) / land.canvas.px_per_m)) / 1e4
    low, high = canvas.extent_m()
    decks = _decks(land, lay, params.bridges, rng)
    lots = _lots(land, rng.uniform(low, high, (int(np.ceil(_LOTS_PER_HA * hectares)), 2)))
    houses = _houses_in_rows(land, lay, params.buildings_per_ha, rng)
    wanted = int(params.buildings_per_ha * hectares)
    houses += _houses_behind(land, rng.uniform(low, high, (wanted, 2)), rng)
    yards = _yards(rng.uniform(low, high, (int(8 * hectares), 2)), land, rng)
    trees = _trees(land, rng.uniform(low, high, (int(params.trees_per_ha * hectares), 2)), rng)
    parts = [_lot(corner, along) for corner, along in lots]
    return Town(
        np.array(houses, float).reshape(-1, 7),
        np.vstack(
            [trees, _hedges(land, yards, rng), _street_trees(canvas, lay, decks, params.street_trees_per_km, rng)]
        ),
        np.array(decks, float).reshape(-1, 7),
        yards,
        [oblong(middle, _LOT_HALF_M, along) for middle, along in lots],
        [line for lines, _ in parts for line in lines],
        np.vstack([np.zeros((0, 3)), *(spaces for _, spaces in parts)]),
    )


def _free_land(coarse: Canvas, lay: Layout) -> _Land:
    """Mark roads with what lies beside them as taken, and sample the lanes for their direction."""
    taken = np.zeros(coarse.shape, np.uint8)
    for kerb in lay.kerbs:
        if kerb.fast:
            coarse.add(taken, polyline.ribbon(kerb.line, -_FAST_CLEAR_M, _WIDEST_M), _UNBUILT)
    for outline in (*lay.asphalt, *lay.pavements):
        coarse.add(taken, outline)
    for kerb in lay.kerbs:
        coarse.add(taken, polyline.ribbon(kerb.line, -_BESIDE_M, 0.5))
    for rail in lay.rails:
        coarse.add(taken, polyline.ribbon(rail, -3.0, 3.0))
    points, headings = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for line, _ in lay.lanes:
        xy, heading = polyline.along(line, np.arange(0.0, polyline.lengths(line)[-1] + _SAMPLE_M, _SAMPLE_M))
        inside = coarse.inside(xy, margin_m=100.0)
        points.append(xy[inside])
        headings.append(heading[inside])
    at, heading = np.vstack(points), np.vstack(headings)
    if not len(at):
        at, heading = np.zeros((1, 2)), np.array([[1.0, 0.0]])
    return _Land(coarse, taken, coarse.mask(lay.asphalt), cKDTree(at), heading)


def _lots(land: _Land, middles: Array) -> list[tuple[Array, Array]]:
    found = []
    for middle in middles:
        along = land.direction(middle)
        if land.claim(oblong(middle, _LOT_HALF_M, along), margin_m=2.0):
            found.append((middle, along))
    return found


def _houses_in_rows(land: _Land, lay: Layout, per_ha: float, rng: np.random.Generator) -> list[list[float]]:
    """Put houses along the slow roads, closer together the more of them are wanted."""
    houses: list[list[float]] = []
    if per_ha <= 0:
        return houses
    for kerb in lay.kerbs:
        length, s = float(polyline.lengths(kerb.line)[-1]), float(rng.uniform(5, 15))
        while not kerb.fast and s < length:
            half = np.array([rng.uniform(5, 14), rng.uniform(4.5, 7.5)])
            (at,), (ahead,) = polyline.along(kerb.line, s + half[0])
            setback = _BESIDE_M + 1.5 + rng.gamma(2.0, 2.0) + half[1]
            houses += _house(land, at + setback * np.array([ahead[1], -ahead[0]]), half, ahead, rng)
            s += 2 * half[0] + (0.3 if rng.random() < 0.35 else rng.gamma(2.0, 60.0 / per_ha))
    return houses


def _houses_behind(land: _Land, middles: Array, rng: np.random.Generator) -> list[list[float]]:
    houses: list[list[float]] = []
    for middle in middles:
        half = rng.uniform((4.5, 4.0), (12, 8) if rng.random() < 0.85 else (28, 16))
        along = land.direction(middle)
        turned = along if rng.random() < 0.6 else np.array([-along[1], along[0]])
        houses += _house(land, middle, half, turned, rng)
    return houses


def _house(land: _Land, middle: Array, half: Array, along: Array, rng: np.random.Generator) -> list[list[float]]:
    height = float(rng.uniform(5.0, 8.0) if half.prod() < 60 else rng.uniform(6.0, 16.0))
    if not land.claim(oblong(middle, half, along), margin_m=0.1):
        return []
    return [[*middle, *half, *along, height]]


def _yards(middles: Array, land: _Land, rng: np.random.Generator) -> Array:
    """Return lawns, drives, beds and gravel: rectangles along the roads, one over the other."""
    rows = []
    for middle in middles:
        along = land.direction(middle)
        col, row = np.round(apply(land.canvas.scene_to_px, middle[None])[0]).astype(int)
        height, width = land.canvas.shape
        if not (0 <= col < width and 0 <= row < height) or land.taken[row, col] == _UNBUILT:
            continue
        rows.append([*middle, *rng.gamma(2.0, (4.0, 2.5)) + 1.0, *along, rng.random()])
    return np.array(rows, float).reshape(-1, 7)


def _hedges(land: _Land, yards: Array, rng: np.random.Generator) -> Array:
    """Return rows of bushes along one side of some of the *yards*, as small trees."""
    rows = [np.zeros((0, 4))]
    for x, y, half, other, along_x, along_y, _ in yards[rng.random(len(yards)) < _HEDGED]:
        along, across = np.array([along_x, along_y]), np.array([-along_y, along_x])
        at = np.arange(-half, half, 1.0)
        xy = [x, y] + other * across + at[:, None] * along + rng.normal(0, 0.12, (len(at), 2))
        col, row = np.round(apply(land.canvas.scene_to_px, xy)).astype(int).T
        height, width = land.canvas.shape
        free = (col >= 0) & (row >= 0) & (col < width) & (row < height)
        free[free] = land.taken[row[free], col[free]] == 0
        radius = rng.uniform(0.5, 1.0, len(at))
        rows.append(np.column_stack([xy, radius, 1.2 * radius + 0.6])[free])
    return np.vstack(rows)


def _trees(land: _Land, middles: Array, rng: np.random.Generator) -> Array:
    """Return trees on free land, in clumps: each stands near the last one as often as not."""
    rows: list[list[float]] = []
    for chance in middles:
        middle = chance
        if rows and rng.random() < 0.55:
            middle = np.array(rows[int(rng.integers(max(0, len(rows) - 3), len(rows)))][:2]) + rng.normal(0, 4.5, 2)
        radius = float(np.clip(rng.lognormal(0.8, 0.45), 0.8, 6.5))
        px = np.round(apply(land.canvas.scene_to_px, middle[None])[0]).astype(int)
        if (px < 0).any() or (px >= land.canvas.shape[::-1]).any():
            continue
        reach = max(1, int(radius * 0.7 * land.canvas.px_per_m))
        around = land.taken[max(0, px[1] - reach) : px[1] + reach + 1, max(0, px[0] - reach) : px[0] + reach + 1]
        if not (around == 255).any():
            rows.append([*middle, radius, float(rng.uniform(1.5, 2.4) * radius + 1.5)])
    return np.array(rows, float).reshape(-1, 4)


def _street_trees(
    canvas: Canvas, lay: Layout, decks: list[list[float]], per_km: float, rng: np.random.Generator
) -> Array:
    """Return trees in rows at the outer edge of the parking bays; the larger crowns reach over the carriageway."""
    rows = [np.zeros((0, 4))]
    for kerb in lay.kerbs:
        length = float(polyline.lengths(kerb.line)[-1])
        if kerb.fast or length < 40 or per_km <= 0:
            continue
        at = np.sort(rng.uniform(15, length - 15, rng.poisson(per_km * (length - 30) / 1000)))
        xy, _ = polyline.along(polyline.parallel(kerb.line, -BAY_M - 0.8), at)
        radius = rng.uniform(2.0, 5.2, len(at))
        rows.append(np.column_stack([xy, radius, 1.6 * radius + 4.0])[canvas.inside(xy, margin_m=0.0)])
    trees = np.vstack(rows)
    bridges = np.array(decks, float).reshape(-1, 7)
    apart = np.hypot(*(trees[:, None, :2] - bridges[None, :, :2]).transpose(2, 0, 1)) > bridges[:, 2] + 5
    return np.asarray(trees[apart.all(axis=1)])


def _decks(land: _Land, lay: Layout, count: int, rng: np.random.Generator) -> list[list[float]]:
    """Return *count* footbridges over roads, each square to its road and as long as that is wide and a little more."""
    places = [np.zeros((0, 4))]
    for kerb in lay.kerbs:
        length = float(polyline.lengths(kerb.line)[-1])
        xy, ahead = polyline.along(kerb.line, np.arange(45.0, max(length - 45.0, 45.0), 10.0))
        inside = land.canvas.inside(xy, margin_m=-40.0)
        places.append(np.column_stack([xy, -ahead[:, 1], ahead[:, 0]])[inside])
    found = np.vstack(places)
    decks: list[list[float]] = []
    across_m = np.arange(1.0, _WIDEST_M)
    for x, y, over_x, over_y in found[rng.permutation(len(found))]:
        over = np.array([over_x, over_y])
        px = np.round(apply(land.canvas.scene_to_px, [x, y] + across_m[:, None] * over)).astype(int)
        col, row = np.clip(px, 0, np.array(land.canvas.shape[::-1]) - 1).T
        open_m = float(across_m[np.argmin(land.road[row, col] > 0)]) if (land.road[row, col] == 0).any() else _WIDEST_M
        half = np.array([open_m / 2 + BAY_M + PAVEMENT_M + 2.0, rng.uniform(1.5, 3.5)])
        middle = np.array([x, y]) + over * open_m / 2
        apart = all(np.hypot(*(middle - other[:2])) > _WIDEST_M for other in decks)
        if len(decks) < count and apart:
            decks.append([*middle, *half, *over, _DECK_M])
            land.claim(oblong(middle, half, over), margin_m=1.0, whatever=True)
    return decks


def _lot(middle: Array, along: Array) -> tuple[list[Array], Array]:
    """Return the lines and the spaces of a car park: two rows of cars, nose to the edge."""
    across = np.array([-along[1], along[0]])
    count = int(2 * _LOT_HALF_M[0] / _SPACE_M)
    at = (np.arange(count) + 0.5 - count / 2) * _SPACE_M
    turn = float(np.arctan2(across[1], across[0]))
    lines, spaces = [], []
    for sign in (-1, 1):
        row = sign * (_LOT_HALF_M[1] - 2.6)
        for a in at:
            spaces.append([*(middle + a * along + row * across), turn])
            edge = middle + (a + _SPACE_M / 2) * along + row * across
            lines.append(oblong(edge, np.array([0.06, 2.3]), along))
    return lines, np.array(spaces, float).reshape(-1, 3)
