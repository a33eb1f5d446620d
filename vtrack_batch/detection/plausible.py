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
_UNEVEN, _SURE_IF_EVEN = 4.0, 0.65  # levels of lightness; likeness that things without windows must have
_GREENER, _YELLOWER, _GOES_ON = -3.0, 5.0, 0.25  # levels of a*, b* from the road; share of the sides as green by half
_WIDER = np.array([1.0, 1.0, 0.8, 0.8, 2.2, 2.2])
_SIDES = np.array([k for k in range(81) if abs(k // 9 - 4) >= 3])  # beside boxes so much wider

Places = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Rows and columns of a picture."""


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

    They are no shadows, no markings, no gaps between others, no trees, and, unless they surely look like vehicles, not
    all of one colour; and ground of the road's hue around leads to the road: no lawns, no roofs.
    """
    rows, columns = np.mgrid[1 : picture.shape[0] : 4, 1 : picture.shape[1] : 4].reshape(2, -1)
    on_road = place.on_road((np.stack([columns, rows], axis=1) + 0.5) / px_per_m)
    if not on_road.any():
        return np.zeros(len(boxes), np.bool_)
    road = rows[on_road], columns[on_road]
    lab = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2LAB), np.uint8)
    good = _solid(picture, boxes) & ~_leafy(lab, road, boxes) & ((score >= _SURE_IF_EVEN) | ~_even(lab, boxes))
    return np.asarray(good & _paved(lab, road, boxes) & ~_shaded(background, picture, road, boxes))


def _paved(lab: NDArray[np.uint8], road: Places, boxes: Array) -> NDArray[np.bool_]:
    """Return which *boxes* have ground of the road's hue around that leads to it."""
    hues = lab[:, :, 1:]
    alike = np.linalg.norm(hues - np.median(hues[road], axis=0), axis=2) <= _SAME_HUE
    joined = np.asarray(cv2.connectedComponents(alike.astype(np.uint8), connectivity=4)[1])
    ways = np.bincount(joined[road], minlength=int(joined.max()) + 1) >= _WAY_SHARE * len(road[0])
    ways[0] = False
    return np.asarray(levels(ways[joined][:, :, None], boxes, 1.6)[:, _RING, 0].mean(axis=1) >= _PAVED_SHARE)


def _shaded(background: Background, picture: NDArray[np.uint8], road: Places, boxes: Array) -> NDArray[np.bool_]:
    """Return which *boxes* are only darker than the road, as shadows are."""
    if background.shadows.ratio is None:
        return np.zeros(len(boxes), np.bool_)
    ratio = (levels(picture, boxes, 0.8) + 2) / (np.median(picture[road], axis=0) + 2)
    band = background.shadows.band
    inside = ((ratio >= band[:, 0]) & (ratio <= band[:, 1])).all(axis=2)
    return np.asarray(inside.mean(axis=1) >= _SHADED_SHARE)


def _solid(picture: NDArray[np.uint8], boxes: Array) -> NDArray[np.bool_]:
    """Return which *boxes* differ inside from what is usual around them: no gaps between vehicles, no markings."""
    usual = np.median(levels(picture, boxes, 1.7)[:, _RING], axis=1)
    differs = np.abs(levels(picture, boxes, 0.85) - usual[:, None]).max(axis=2) > _DIFFERENT
    return np.asarray(differs.mean(axis=1) >= _SOLID_SHARE)


def _even(lab: NDArray[np.uint8], boxes: Array) -> NDArray[np.bool_]:
    """Return which *boxes* are of one lightness inside: ground between shadows or kerbs, which has no windows."""
    return np.asarray(levels(lab[:, :, :1], boxes, 0.7)[..., 0].std(axis=1) < _UNEVEN)


def _leafy(lab: NDArray[np.uint8], road: Places, boxes: Array) -> NDArray[np.bool_]:
    """Return which *boxes* are darker than around, greener and yellower than the road, and so are their sides: crowns.

    Green paint ends where the vehicle does; a lawn beside it is lighter.
    """
    off = lab.astype(np.float32) - (0.0, *np.median(lab[road][:, 1:], axis=0))
    told = np.dstack([off, off[:, :, 2] - off[:, :, 1]])
    inside = np.median(levels(told, boxes, 0.7), axis=1)
    light = np.median(levels(told[:, :, :1], boxes, 1.7)[:, _RING, 0], axis=1)
    green = (inside[:, 0] < light) & (inside[:, 1] <= _GREENER) & (inside[:, 2] >= _YELLOWER)
    beside = levels(told, boxes * _WIDER, 1.0)[:, _SIDES]
    alike = beside[:, :, 3] >= inside[:, 3:] / 2
    alike &= beside[:, :, 0] <= (inside[:, 0] + light)[:, None] / 2
    return np.asarray(green & (alike.mean(axis=1) >= _GOES_ON))


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
    column, row = np.moveaxis(np.clip(_spread(boxes, reach), 0, np.array(picture.shape[1::-1]) - 1), 2, 0)
    return np.asarray(picture[row, column].astype(np.float64))


def visible(seen: NDArray[np.bool_], boxes: Array) -> Array:
    """Return the share (n,) of *boxes* that lies inside the picture, on ground that was *seen* (rows, columns)."""
    at = _spread(boxes, 1.0)
    inside = ((at >= 0) & (at < seen.shape[::-1])).all(axis=2)
    return np.asarray((inside & (levels(seen[:, :, None], boxes, 1.0)[..., 0] > 0)).mean(axis=1))


def _spread(boxes: Array, reach: float) -> NDArray[np.int64]:
    """Return places (n, 81, 2), column and row, spread over *boxes* of *reach* times their size."""
    side = (np.arange(9) - 4) / 4 * reach
    along, across = (part.ravel() for part in np.meshgrid(side, side))
    at = boxes[:, None, :2] + along[:, None] * boxes[:, None, 2:4] + across[:, None] * boxes[:, None, 4:6]
    return np.asarray(np.rint(at), np.int64)


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
