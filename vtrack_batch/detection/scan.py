"""Look for vehicles in a still picture: the learned score at every place near the road, in every direction."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.detection.appearance import CELL, CHANNELS, LONG, REACH_PX, STEP_M, Appearance, channels_of

Floats = NDArray[np.float64]

DIRECTIONS = 12
_TILE_CELLS = 192
_MARGIN_CELLS = REACH_PX // CELL + LONG // 2


def scan(
    picture: NDArray[np.uint8],
    near: NDArray[np.bool_],
    near_cell_m: float,
    px_per_m: tuple[float, float],
    *,
    looks: Appearance,
    least: float,
) -> tuple[Floats, Floats, Floats]:
    """Return places (n, 2) in px, axes (n, 2) on the ground and scores (n,) of the best windows of *picture*.

    Those are peaks among their neighbours of one direction that score *least*; their centres lie where *near* (rows,
    columns) bool is, in cells of *near_cell_m* that begin at the picture's corner.
    """
    at = np.argwhere(near)[:, ::-1] * near_cell_m + near_cell_m / 2
    found = [(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))]
    upright = Appearance(looks.weights[[1, 0, *range(2, CHANNELS)]].transpose(0, 2, 1)[:, :, ::-1], looks.offset)
    for angle in np.pi * np.arange(DIRECTIONS // 2) / DIRECTIONS if len(at) else ():
        axis = np.array([np.cos(angle), np.sin(angle)])
        turn = np.array([axis, [-axis[1], axis[0]]])
        for corner in _tiles(at @ turn.T):
            wanted = _wanted(near, turn, corner, near_cell_m)
            cells = _drawn(picture, turn, corner, px_per_m, wanted)
            # What is drawn along an axis is drawn across another.
            for along, own in zip(turn, (looks, upright), strict=True):
                turned_m, scores = _peaks(cells, wanted, corner, own, least)
                xy_m = turned_m @ turn
                cell = np.floor(xy_m / near_cell_m).astype(int)
                inside = np.asarray((cell >= 0).all(axis=1) & (cell < near.shape[::-1]).all(axis=1))
                inside[inside] = near[cell[inside, 1], cell[inside, 0]]
                found.append(
                    (xy_m[inside] * px_per_m - 0.5, np.broadcast_to(along, xy_m.shape)[inside], scores[inside])
                )
    places, axes, scores = (np.concatenate(part) for part in zip(*found, strict=True))
    return places, axes, scores


def _tiles(turned_m: Floats) -> Iterator[Floats]:
    """Yield the corners, in turned metres, of the tiles that hold any of the points *turned_m* (n, 2)."""
    side = _TILE_CELLS * CELL * STEP_M
    tile = np.floor(turned_m / side).astype(np.int64)
    first = tile.min(axis=0)
    held = np.zeros(tile.max(axis=0) - first + 1, np.bool_)
    held[*(tile - first).T] = True
    yield from (np.argwhere(held) + first) * side


def _wanted(near: NDArray[np.bool_], turn: Floats, corner: Floats, near_cell_m: float) -> NDArray[np.uint8]:
    """Return which cells (rows, columns) of one tile, and some around it, lie in *near* or beside: 1, else 0."""
    cell_m, side = CELL * STEP_M, _TILE_CELLS + 2 * _MARGIN_CELLS
    first = corner - (_MARGIN_CELLS - 0.5) * cell_m
    to_near = np.column_stack([turn.T * cell_m / near_cell_m, turn.T @ first / near_cell_m - 0.5])
    how = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    there = cv2.warpAffine(near.astype(np.uint8), to_near, (side, side), flags=how)
    return np.asarray(cv2.dilate(there, np.ones((5, 5), np.uint8)), np.uint8)


def _drawn(
    picture: NDArray[np.uint8],
    turn: Floats,
    corner: Floats,
    px_per_m: tuple[float, float],
    wanted: NDArray[np.uint8],
) -> NDArray[np.float32]:
    """Return what the cells of one tile, and some around it, show (channels, rows, columns), drawn with *turn*.

    What is told of others than those of windows around the *wanted* ones is not to be relied on.
    """
    cell_m, side = CELL * STEP_M, CELL * (_TILE_CELLS + 2 * _MARGIN_CELLS)
    first = corner - _MARGIN_CELLS * cell_m + STEP_M / 2
    scale = np.diag(px_per_m)
    to_picture = np.column_stack([scale @ turn.T * STEP_M, scale @ turn.T @ first - 0.5])
    drawn = cv2.warpAffine(
        picture,
        to_picture,
        (side, side),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REFLECT,
    )
    shown = cv2.dilate(wanted, np.ones((LONG + 1, LONG + 1), np.uint8))
    return channels_of(np.asarray(drawn, np.uint8), np.asarray(shown, np.uint8))


def _peaks(
    cells: NDArray[np.float32], wanted: NDArray[np.uint8], corner: Floats, looks: Appearance, least: float
) -> tuple[Floats, Floats]:
    """Return places (n, 2) in turned metres and scores (n,) of the peaks of one tile; all of those *wanted*."""
    high, wide = looks.weights.shape[1:]
    total = np.full(cells.shape[1:], -np.inf, np.float32)
    _score(cells, np.ascontiguousarray(looks.weights), np.float32(looks.offset), wanted, total)
    inner = slice(_MARGIN_CELLS, -_MARGIN_CELLS)
    best = (total >= cv2.dilate(total, np.ones((3, 3), np.uint8))) & (total >= least)
    at = np.argwhere(best[inner, inner])
    scores = total[inner, inner][at[:, 0], at[:, 1]].astype(np.float64)
    # a window of an even number of cells is centred between two
    middle = 0.5 - 0.5 * (np.array([wide, high]) % 2 == 0)
    return corner + (at[:, ::-1] + middle) * CELL * STEP_M, scores


@njit(cache=True, nogil=True)
def _score(cells, weights, offset, wanted, total):  # type: ignore[no-untyped-def]
    """Fill *total* (rows, columns) float32, row by row from the first to the last *wanted* place, with scores.

    Those are of the windows of *cells* (channels, rows, columns) in the middle of which the places lie.
    """
    channels, high, wide = weights.shape
    up, left = high // 2, wide // 2
    for r in range(up, total.shape[0] - high + up + 1):
        places = np.flatnonzero(wanted[r, left : total.shape[1] - wide + left + 1])
        if len(places) == 0:
            continue
        sums = total[r, left + places[0] : left + places[-1] + 1]
        sums[:] = offset
        for k in range(channels):
            for i in range(high):
                row = cells[k, r - up + i]
                for j in range(wide):
                    weight, part = weights[k, i, j], row[places[0] + j :]
                    for c in range(len(sums)):
                        sums[c] += weight * part[c]
