"""What may be a vehicle that stands: solid, on paved ground that leads to the road, and nobody drives through it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.background.learn import Background
from vtrack_batch.detection.overlaps import stand_alone
from vtrack_batch.detection.place import Place
from vtrack_batch.model.homography import Array

_DRIVEN_OVER = _THERE = 2  # frames: once may be a mistake
_WAY_AHEAD, _ASLANT = 2.5, 0.87  # half lengths that a moving vehicle's way is known, cosine of what lies across it
_SAME_HUE, _PAVED_SHARE, _SHADED_SHARE = 6.0, 0.6, 0.6
_WAY_SHARE = 0.01  # of the road's ground: patches with less of it are no part of it
_RING = np.array([k for k in range(81) if max(abs(k // 9 - 4), abs(k % 9 - 4)) == 4])
_DIFFERENT, _SOLID_SHARE = 14.0, 0.4
_GREENER, _YELLOWER, _SURE_IN_LEAVES = -2.0, 3.0, 0.65  # levels of a*, b*; likeness that green things must have


@dataclass(frozen=True, eq=False)
class Driven:
    """What is seen in a frame: ``boxes`` (m, 6) in reference px, and which rows of it are ``moving`` vehicles."""

    boxes: Array
    moving: NDArray[np.int64]


def plausible(
    background: Background,
    picture: NDArray[np.uint8],
    place: Place,
    boxes: Array,
    score: Array,
    px_per_m: tuple[float, float],
) -> NDArray[np.bool_]:
    """Return which *boxes* (n, 6) in px of the *picture* of the ground may be vehicles, which they are like by *score*.

    They are no shadows, no markings, no gaps between others, and no trees; and ground of the road's hue around leads to
    the road: no lawns, no roofs.
    """
    good = _solid(picture, boxes) & ((score >= _SURE_IN_LEAVES) | ~_leafy(picture, boxes))
    return np.asarray(good & _paved_and_lit(background, picture, place, boxes, px_per_m))


def _paved_and_lit(
    background: Background, picture: NDArray[np.uint8], place: Place, boxes: Array, px_per_m: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return which *boxes* have ground of the road's hue around that leads to it, and are not only darker than it."""
    hues = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2LAB)[:, :, 1:], np.uint8)
    rows, columns = np.mgrid[1 : picture.shape[0] : 4, 1 : picture.shape[1] : 4].reshape(2, -1)
    road = place.on_road((np.stack([columns, rows], axis=1) + 0.5) / px_per_m)
    if not road.any():
        return np.zeros(len(boxes), np.bool_)
    hue, colour = (np.median(part[rows[road], columns[road]], axis=0) for part in (hues, picture))
    alike = np.linalg.norm(hues - hue, axis=2) <= _SAME_HUE
    joined = np.asarray(cv2.connectedComponents(alike.astype(np.uint8), connectivity=4)[1])
    ways = np.bincount(joined[rows[road], columns[road]], minlength=int(joined.max()) + 1) >= _WAY_SHARE * road.sum()
    ways[0] = False
    paved = levels(ways[joined][:, :, None], boxes, 1.6)[:, _RING, 0].mean(axis=1) >= _PAVED_SHARE
    if background.shadows.ratio is None:
        return np.asarray(paved)
    ratio = (levels(picture, boxes, 0.8) + 2) / (colour + 2)
    band = background.shadows.band
    shaded = ((ratio >= band[:, 0]) & (ratio <= band[:, 1])).all(axis=2)
    return np.asarray(paved & (shaded.mean(axis=1) < _SHADED_SHARE))


def _solid(picture: NDArray[np.uint8], boxes: Array) -> NDArray[np.bool_]:
    """Return which *boxes* differ inside from what is usual around them: no gaps between vehicles, no markings."""
    usual = np.median(levels(picture, boxes, 1.7)[:, _RING], axis=1)
    differs = np.abs(levels(picture, boxes, 0.85) - usual[:, None]).max(axis=2) > _DIFFERENT
    return np.asarray(differs.mean(axis=1) >= _SOLID_SHARE)


def _leafy(picture: NDArray[np.uint8], boxes: Array) -> NDArray[np.bool_]:
    """Return which *boxes* are greener and yellower inside than around: trees beside the road, or green paint."""
    hues = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2LAB)[:, :, 1:], np.uint8)
    inside = np.median(levels(hues, boxes, 0.7), axis=1)
    greener = inside - np.median(levels(hues, boxes, 1.7)[:, _RING], axis=1)
    return np.asarray((greener[:, 0] <= _GREENER) & (greener[:, 1] >= _YELLOWER))


def driven_over(boxes: Array, driven: Sequence[Driven], px_per_m: tuple[float, float]) -> NDArray[np.bool_]:
    """Return which *boxes* others drove over while they were there, or whose middle lies across the way of others.

    What stands is there while nothing else is seen at its place. Before it came and after it left others drive there.
    """
    if not (len(boxes) and len(driven)):
        return np.zeros(len(boxes), np.bool_)
    over, across, free = (np.zeros((len(driven), len(boxes)), np.bool_) for _ in range(3))
    for frame, seen in enumerate(driven):
        moving = seen.boxes[seen.moving]
        over[frame] = _reached(boxes, moving, 1.0).any(axis=1)
        across[frame] = (_reached(boxes, moving, _WAY_AHEAD) & (_parallel(boxes, moving) < _ASLANT)).any(axis=1)
        rank = np.repeat([1.0, 0.0], [len(seen.boxes), len(boxes)])
        both = np.concatenate([seen.boxes, boxes])
        free[frame] = stand_alone(both, rank, px_per_m)[len(seen.boxes) :]
    so_far, there = np.cumsum(free, axis=0), free.sum(axis=0)
    meanwhile = over & ((np.minimum(so_far, there - so_far) >= _THERE) | (there == 0))
    return np.asarray((meanwhile.sum(axis=0) >= _DRIVEN_OVER) | across.any(axis=0))


# helpers --------------------------------------------------------------------------------------------------------------


def levels(picture: NDArray[Any], boxes: Array, reach: float) -> Array:
    """Return the levels (n, points, channels) of *picture* at points spread over boxes of *reach* times their size."""
    side = (np.arange(9) - 4) / 4 * reach
    along, across = (part.ravel() for part in np.meshgrid(side, side))
    at = boxes[:, None, :2] + along[:, None] * boxes[:, None, 2:4] + across[:, None] * boxes[:, None, 4:6]
    last = np.array(picture.shape[1::-1]) - 1
    column, row = np.moveaxis(np.clip(np.rint(at), 0, last).astype(int), 2, 0)
    return np.asarray(picture[row, column].astype(np.float64))


def _reached(boxes: Array, others: Array, ahead: float) -> NDArray[np.bool_]:
    """Return which middles of *boxes* (n,) lie in which of *others* (m,), made longer by the factor *ahead*."""
    away = boxes[:, None, :2] - others[None, :, :2]
    along, across = (
        np.abs((away * others[:, k : k + 2]).sum(axis=2)) / np.maximum((others[:, k : k + 2] ** 2).sum(axis=1), 1e-9)
        for k in (2, 4)
    )
    return np.asarray((along <= ahead) & (across <= 1))


def _parallel(boxes: Array, others: Array) -> Array:
    """Return the cosine (n, m) of the angle between *boxes* (n,) and *others* (m,)."""
    one, other = (
        part[:, 2:4] / np.maximum(np.linalg.norm(part[:, 2:4], axis=1), 1e-9)[:, None] for part in (boxes, others)
    )
    return np.asarray(np.abs(one @ other.T))
