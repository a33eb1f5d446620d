"""What rises above the ground leans outwards as the platform sees it, sways in the wind and hides what is below."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation.patches import CROWNS, Atlas, AtlasMaker, crown, deck, roof, wall
from vtrack_batch.simulation.stage import directions
from vtrack_batch.simulation.town import Town

_COL, _ROW, _A11, _A12, _A21, _A22, _PATCH, _LIGHT = range(8)
_WALL_KINDS = 8
_CROWN_M = 3.0
_CROWN_SPREAD = 1.15
"""How much further than the mean radius the picture of a crown reaches."""


@dataclass(frozen=True)
class Standing:
    """Flat pieces at a height, in scene metres: n tops (roofs, decks, crowns) and m walls.

    ``middle``, ``u``, ``v`` (n, 2): centre and half axes of a piece; ``height_m``, ``patch``, ``light`` (n,);
    ``crown`` (n,) says which sway. ``wall_ends`` (m, 2, 2) with the outside to the right, ``wall_patch``,
    ``wall_light`` (m,), ``wall_of`` (m,) the top that they carry.
    """

    atlas: Atlas
    middle: Array
    u: Array
    v: Array
    height_m: Array
    patch: NDArray[np.int64]
    light: Array
    crown: NDArray[np.bool_]
    wall_ends: Array
    wall_patch: NDArray[np.int64]
    wall_light: Array
    wall_of: NDArray[np.int64]


def raise_town(town: Town, px_per_m: float, right_up: Array, sun: Array, *, rng: np.random.Generator) -> Standing:
    """Draw the pictures of all that stands in *town*, *px_per_m* fine.

    ``right_up`` (2, 2): the scene's unit vectors to the right and up in the frame, as columns; ``sun`` (2,): unit
    vector to the sun in the scene, zero where there are no shadows.
    """
    maker = AtlasMaker()
    blocks = np.vstack([town.buildings, town.decks])
    along, half, middle = blocks[:, 4:6], blocks[:, 2:4], blocks[:, :2]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    tops = []
    for k in range(len(blocks)):
        local = np.array([along[k] @ sun, across[k] @ sun])
        is_roof = k < len(town.buildings)
        tops.append(maker.add(roof(half[k], px_per_m, local, rng=rng) if is_roof else deck(half[k], px_per_m, rng=rng)))
    sun_image = (right_up.T @ sun) * [1, -1]
    crowns = [maker.add(crown(_CROWN_M * px_per_m, sun_image, rng=rng)) for _ in range(CROWNS)]
    walls = [maker.add(wall(rng=rng)) for _ in range(_WALL_KINDS)]
    trees, n = town.trees, len(town.trees)
    reach = trees[:, 2] * _CROWN_SPREAD
    ends, of = _walls(middle, along * half[:, :1], across * half[:, 1:], len(town.buildings))
    outward = ends[:, 1] - ends[:, 0]
    outward = np.stack([outward[:, 1], -outward[:, 0]], axis=1) / np.maximum(np.hypot(*outward.T), 1e-9)[:, None]
    return Standing(
        maker.atlas(),
        np.vstack([middle, trees[:, :2]]),
        np.vstack([along * half[:, :1], reach[:, None] * right_up[:, 0]]),
        np.vstack([across * half[:, 1:], reach[:, None] * right_up[:, 1]]),
        np.concatenate([blocks[:, 6], trees[:, 3] * 0.8]),
        np.concatenate([np.array(tops, np.int64), np.array(crowns)[rng.integers(0, CROWNS, n)]]),
        np.concatenate([np.ones(len(blocks)), rng.uniform(0.75, 1.2, n)]),
        np.arange(len(blocks) + n) >= len(blocks),
        ends,
        np.array(walls)[rng.integers(0, _WALL_KINDS, len(blocks))][of],
        np.where(outward @ sun > 0, 1.0, 0.55),
        of,
    )


def lean(at: Array, height_m: Array, nadir: Array, altitude_m: float) -> Array:
    """Return where points at *height_m* (n,) above *at* (n, 2) are seen on the ground, from above *nadir* (2,)."""
    return at + (at - nadir) * (height_m / np.maximum(altitude_m - height_m, 1.0))[:, None]


def in_frame(
    things: Standing, to_frame: Array, *, nadir: Array, altitude_m: float, sway: Array | None, size_px: tuple[int, int]
) -> Array:
    """Return the painter's table (k, 8) of the pieces in a frame, lower ones first, walls before what they carry.

    ``to_frame`` takes scene metres to the frame's pixels; ``sway`` (n, 6) shifts crowns by metres and bends their axes.
    """
    seen = lean(things.middle, things.height_m, nadir, altitude_m)
    grown = (altitude_m / np.maximum(altitude_m - things.height_m, 1.0))[:, None]
    u, v = things.u * grown, things.v * grown
    if sway is not None:
        seen = seen + sway[:, :2] * things.crown[:, None]
        u, v = u + sway[:, 2:3] * v * things.crown[:, None], v + sway[:, 3:4] * u * things.crown[:, None]
    tops = _table(seen, u, v, to_frame, things.patch, things.light)
    walls, shown = _walls_in_frame(things, to_frame, nadir, altitude_m)
    order = np.argsort(things.height_m, kind="stable")
    rank = np.empty(len(order))
    rank[order] = np.arange(len(order))
    key = np.concatenate([rank[things.wall_of[shown]] - 0.5, rank])
    table = np.vstack([walls, tops])[np.argsort(key, kind="stable")]
    reach = np.abs(table[:, [_A11, _A21]]) + np.abs(table[:, [_A12, _A22]]) + 2
    inside = (table[:, :2] + reach > 0).all(axis=1) & (table[:, :2] - reach < size_px).all(axis=1)
    return np.ascontiguousarray(table[inside])


def _walls(middle: Array, u: Array, v: Array, count: int) -> tuple[Array, NDArray[np.int64]]:
    """Return the four walls (4 count, 2, 2) of the first *count* blocks, counter-clockwise, and whose they are."""
    corners = np.stack([middle - u - v, middle + u - v, middle + u + v, middle - u + v], axis=1)[:count]
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)
    return ends.reshape(-1, 2, 2), np.repeat(np.arange(count), 4)


def _walls_in_frame(
    things: Standing, to_frame: Array, nadir: Array, altitude_m: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the table of the walls that face the platform, and which of all they are."""
    first, second = things.wall_ends[:, 0], things.wall_ends[:, 1]
    height = things.height_m[things.wall_of]
    along = second - first
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1)
    shown = ((first - nadir) * outward).sum(axis=1) < 0
    first, second, height = first[shown], second[shown], height[shown]
    tops = lean(first, height, nadir, altitude_m), lean(second, height, nadir, altitude_m)
    middle = (first + second + tops[0] + tops[1]) / 4
    u, v = (second - first + tops[1] - tops[0]) / 4, (tops[0] - first + tops[1] - second) / 4
    return _table(middle, u, v, to_frame, things.wall_patch[shown], things.wall_light[shown]), shown


def _table(middle: Array, u: Array, v: Array, to_frame: Array, patch: NDArray[np.int64], light: Array) -> Array:
    table = np.zeros((len(middle), 8))
    table[:, :2] = apply(to_frame, middle)
    across, up = directions(to_frame, middle, u), directions(to_frame, middle, v)
    table[:, _A11], table[:, _A21] = across[:, 0], across[:, 1]
    table[:, _A12], table[:, _A22] = up[:, 0], up[:, 1]
    table[:, _PATCH], table[:, _LIGHT] = patch, light
    return table


@njit(cache=True, nogil=True)
def paint_patches(image, rgba, index, table, first_row):  # type: ignore[no-untyped-def]
    """Lay the pieces of *table* over ``image`` (H, W, 3) float32, whose row 0 is row *first_row* of the frame."""
    height, width = image.shape[:2]
    to_patch = np.zeros(6)
    one = np.float32(1.0)
    for piece in table:
        reach_x = abs(piece[_A11]) + abs(piece[_A12])
        reach_y = abs(piece[_A21]) + abs(piece[_A22])
        x0, y0 = piece[_COL], piece[_ROW] - first_row
        top, bottom = max(0, int(y0 - reach_y) - 1), min(height, int(y0 + reach_y) + 3)
        number = int(piece[_PATCH])
        if top >= bottom or not _to_patch(piece, index[number], to_patch):
            continue
        begin, rows, cols = index[number, 0], index[number, 1], index[number, 2]
        light = np.float32(piece[_LIGHT])
        for row in range(top, bottom):
            first, last = _span(row - y0, to_patch, rows, cols, x0 - reach_x - 1, x0 + reach_x + 2, x0)
            for col in range(max(0, first), min(width, last)):
                pc = to_patch[0] * (col - x0) + to_patch[1] * (row - y0) + to_patch[2]
                pr = to_patch[3] * (col - x0) + to_patch[4] * (row - y0) + to_patch[5]
                if pc < 0.0 or pr < 0.0 or pc > cols - 1.001 or pr > rows - 1.001:
                    continue
                c, r = int(pc), int(pr)
                fc, fr = np.float32(pc - c), np.float32(pr - r)
                here = begin + 4 * (r * cols + c)
                below = here + 4 * cols
                w11, w12, w21, w22 = (one - fr) * (one - fc), (one - fr) * fc, fr * (one - fc), fr * fc
                alpha = w11 * rgba[here + 3] + w12 * rgba[here + 7] + w21 * rgba[below + 3] + w22 * rgba[below + 7]
                if alpha <= 0.0:
                    continue
                alpha /= np.float32(255.0)
                for k in range(3):
                    value = w11 * rgba[here + k] + w12 * rgba[here + 4 + k]
                    value += w21 * rgba[below + k] + w22 * rgba[below + 4 + k]
                    image[row, col, k] += alpha * (light * value - image[row, col, k])


@njit(cache=True, nogil=True)
def _span(y, to_patch, rows, cols, left, right, x0):  # type: ignore[no-untyped-def]
    """Return the columns, first and one past the last, in which a row *y* from a piece's centre can meet its patch."""
    for k, size in ((0, cols), (1, rows)):
        slope, offset = to_patch[3 * k], to_patch[3 * k + 1] * y + to_patch[3 * k + 2]
        if abs(slope) > 1e-9:
            one, other = -offset / slope + x0, (size - 1.0 - offset) / slope + x0
            left, right = max(left, min(one, other)), min(right, max(one, other))
    return int(np.floor(left)), int(np.ceil(right)) + 1


@njit(cache=True, nogil=True)
def uncovered(points, rgba, index, table):  # type: ignore[no-untyped-def]
    """Return the mean share (n,) of the *points* (n, k, 2) of the frame that no piece of *table* covers.

    The first point of a row is the middle of the others, the last one lies as far from it as any.
    """
    clear = np.ones(points.shape[:2])
    value = np.zeros(4, np.float32)
    to_patch = np.zeros(6)
    for piece in table:
        patch = index[int(piece[_PATCH])]
        if not _to_patch(piece, patch, to_patch):
            continue
        reach_x = abs(piece[_A11]) + abs(piece[_A12]) + 1
        reach_y = abs(piece[_A21]) + abs(piece[_A22]) + 1
        for i in range(points.shape[0]):
            far = abs(points[i, -1, 0] - points[i, 0, 0]) + abs(points[i, -1, 1] - points[i, 0, 1])
            if abs(points[i, 0, 0] - piece[_COL]) > reach_x + far or abs(points[i, 0, 1] - piece[_ROW]) > reach_y + far:
                continue
            for k in range(points.shape[1]):
                x, y = points[i, k, 0] - piece[_COL], points[i, k, 1] - piece[_ROW]
                if _sample(x, y, to_patch, patch, rgba, value):
                    clear[i, k] *= 1.0 - value[3]
    return clear.sum(axis=1) / max(points.shape[1], 1)


@njit(cache=True, nogil=True)
def _to_patch(piece, patch, to_patch):  # type: ignore[no-untyped-def]
    """Write into *to_patch* (6,) what takes offsets from a piece's centre to its patch's pixels; false if it is flat.

    A patch has a clear border of one pixel around what spans the piece from -1 to 1.
    """
    det = piece[_A11] * piece[_A22] - piece[_A12] * piece[_A21]
    if abs(det) < 1e-9:
        return False
    half_height, half_width = (patch[1] - 2) / 2, (patch[2] - 2) / 2
    to_patch[0] = piece[_A22] / det * half_width
    to_patch[1] = -piece[_A12] / det * half_width
    to_patch[2] = 0.5 + half_width
    to_patch[3] = piece[_A21] / det * half_height
    to_patch[4] = -piece[_A11] / det * half_height
    to_patch[5] = 0.5 + half_height
    return True


@njit(cache=True, nogil=True)
def _sample(x, y, to_patch, patch, rgba, value):  # type: ignore[no-untyped-def]
    """Write colour and opacity (0-1) at the offset (x, y) from a piece's centre into *value* (4,); false if clear."""
    pc = to_patch[0] * x + to_patch[1] * y + to_patch[2]
    pr = to_patch[3] * x + to_patch[4] * y + to_patch[5]
    height, width = patch[1], patch[2]
    if pc < 0.0 or pr < 0.0 or pc > width - 1.001 or pr > height - 1.001:
        return False
    c, r = int(pc), int(pr)
    fc, fr = np.float32(pc - c), np.float32(pr - r)
    here = patch[0] + 4 * (r * width + c)
    below = here + 4 * width
    for k in range(3, -1, -1):
        upper = rgba[here + k] + fc * (np.float32(rgba[here + 4 + k]) - rgba[here + k])
        lower = rgba[below + k] + fc * (np.float32(rgba[below + 4 + k]) - rgba[below + k])
        value[k] = upper + fr * (lower - upper)
        if k == 3:
            if value[3] <= 0.0:
                return False
            value[3] /= np.float32(255.0)
    return True
