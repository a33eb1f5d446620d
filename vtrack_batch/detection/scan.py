"""Look for vehicles in a still picture: the learned score at every place near the road, in every direction."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.detection.appearance import CELL, LONG, REACH_PX, STEP_M, WIDE, Appearance, channels_of

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
    if len(at):
        for angle in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
            axis = np.array([np.cos(angle), np.sin(angle)])
            turn = np.array([axis, [-axis[1], axis[0]]])
            for corner in _tiles(at @ turn.T):
                xy_m, scores = _peaks(picture, turn, corner, px_per_m, looks, least)
                cell = np.floor(xy_m / near_cell_m).astype(int)
                inside = np.asarray((cell >= 0).all(axis=1) & (cell < near.shape[::-1]).all(axis=1))
                inside[inside] = near[cell[inside, 1], cell[inside, 0]]
                found.append((xy_m[inside] * px_per_m - 0.5, np.broadcast_to(axis, xy_m.shape)[inside], scores[inside]))
    places, axes, scores = (np.concatenate(part) for part in zip(*found, strict=True))
    return places, axes, scores


def _tiles(turned_m: Floats) -> Iterator[Floats]:
    """Yield the corners, in turned metres, of the tiles that hold any of the points *turned_m* (n, 2)."""
    side = _TILE_CELLS * CELL * STEP_M
    yield from np.unique(np.floor(turned_m / side), axis=0) * side


def _peaks(
    picture: NDArray[np.uint8],
    turn: Floats,
    corner: Floats,
    px_per_m: tuple[float, float],
    looks: Appearance,
    least: float,
) -> tuple[Floats, Floats]:
    """Return places (n, 2) in metres and scores (n,) of the peaks of one tile, drawn with the axis along its rows."""
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
    cells = channels_of(np.asarray(drawn, np.uint8))
    total = np.full(cells.shape[1:], looks.offset, np.float32)
    for channel, weights in zip(cells, looks.weights, strict=True):
        total += cv2.filter2D(channel, cv2.CV_32F, weights, anchor=(LONG // 2, WIDE // 2))
    inner = slice(_MARGIN_CELLS, -_MARGIN_CELLS)
    best = (total >= cv2.dilate(total, np.ones((3, 3), np.uint8))) & (total >= least)
    at = np.argwhere(best[inner, inner])
    scores = total[inner, inner][at[:, 0], at[:, 1]].astype(np.float64)
    # a window of an even number of cells is centred between two
    turned = corner + (at[:, ::-1] + np.array([0.5 - (LONG % 2 == 0) * 0.5, 0.5])) * cell_m
    return turned @ turn, scores
