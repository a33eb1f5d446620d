"""Vehicles that stand in the background picture itself: parked, or queued for most of the block.

No difference shows them. What the block's own moving vehicles look like does (``appearance``): it is learned twice, the
second time also from what was surely found standing, so that parked paint and shade are known. A standing vehicle is
there in every frame in which nothing else is found at its place: when it leaves, its hole differs from the background.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.background.learn import UNSEEN_TOLERANCE, Background
from vtrack_batch.detection.appearance import describe, learn_appearance
from vtrack_batch.detection.candidates import Candidates, grid_steps
from vtrack_batch.detection.examples import Examples
from vtrack_batch.detection.overlaps import stand_alone
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.detection.place import Place
from vtrack_batch.detection.plausible import Driven, driven_over, levels, plausible, visible
from vtrack_batch.detection.scan import scan
from vtrack_batch.model import homography
from vtrack_batch.model.flags import DetectionFlag
from vtrack_batch.model.homography import Array

_CELL_M = 0.5
_OTHERS = 4000
_SURE = 0.75
_DOUBTFUL = 0.15
_KEEP_CLEAR_M = 2.6
_SPREAD = np.array([0.7548776662466927, 0.5698402909980532, 0.3247179572447460])


@dataclass(frozen=True, eq=False)
class Standing:
    """Vehicles (n) in the background: ``boxes`` (n, 6) in reference px - centre, half axes along and across (x, y).

    ``colour`` (n, 3) mean levels 0-255, ``contrast`` (n,) levels from the surroundings, ``score`` (n,).
    """

    boxes: Array
    colour: Array
    contrast: Array
    score: Array

    def take(self, rows: NDArray[np.bool_]) -> Standing:
        """Return the vehicles *rows*."""
        return Standing(self.boxes[rows], self.colour[rows], self.contrast[rows], self.score[rows])


def find_standing(
    background: Background,
    examples: Examples,
    place: Place,
    driven: Sequence[Driven],
    *,
    metres_per_px: tuple[float, float],
    params: DetectionParams,
) -> Standing:
    """Find the vehicles that stand on or near the road in the picture of the *background*.

    *driven* tells of every frame, in order of time, what is seen in it: nothing stands where others drive. Nothing is
    found where no road was learned, or from fewer than ``fewest_examples``.
    """
    looks, sizes = examples.moving(place)
    if not (params.standing and place.learned) or len(looks) < params.fewest_examples:
        return _none()
    steps = grid_steps(params, metres_per_px)
    ground = background.ground(*steps)
    picture, seen = np.ascontiguousarray(ground[:, :, :3]), ground[:, :, 3] < UNSEEN_TOLERANCE
    px_per_m = (1 / metres_per_px[0] / steps[0], 1 / metres_per_px[1] / steps[1])
    near = _near_road(place, picture.shape[:2], px_per_m, params.standing_reach_m)
    if not near.any():
        return _none()
    places, axes = _anywhere(near, px_per_m)
    others = describe(picture, places, axes, px_per_m)
    first = learn_appearance(looks, others)
    size = np.median(sizes, axis=0)
    at, along, score = scan(picture, near, _CELL_M, px_per_m, looks=first, least=0.0)
    windows = describe(picture, at, along, px_per_m)
    alone = stand_alone(_boxes(at, along, size, px_per_m), score, px_per_m)
    sure = alone & (score >= _SURE)
    clear = _far_from(places, at[alone & (score >= _DOUBTFUL)], px_per_m)
    if sure.any() and clear.sum() > len(others) / 2:
        again = np.repeat(windows[sure], max(1, len(looks) // int(sure.sum())), axis=0)
        second = learn_appearance(np.concatenate([looks, again]), others[clear])
        score = second.score(windows)
    boxes = _boxes(at, along, size, px_per_m)
    good = (score >= params.standing_score) & (visible(seen, boxes) >= params.visible_share)
    good &= plausible(background, picture, place, boxes, score, px_per_m)
    boxes, score = boxes[good], score[good]
    alone = stand_alone(boxes, score, px_per_m)
    found = _measured(background, boxes[alone], score[alone], steps)
    return found.take(~driven_over(found.boxes, driven, (1 / metres_per_px[0], 1 / metres_per_px[1])))


def moving_boxes(candidates: Sequence[Candidates], poses: Sequence[Array], place: Place) -> list[Driven]:
    """Return of every frame the boxes of its *candidates*, and which of them belong to chains of *place*."""
    return [
        Driven(_moved(_boxes_of(found), pose), rows)
        for found, pose, rows in zip(candidates, poses, place.chained, strict=True)
    ]


def with_standing(
    found: Candidates,
    selected: NDArray[np.bool_],
    standing: Standing,
    frame_to_reference: Array,
    size_px: tuple[int, int],
    metres_per_px: tuple[float, float],
) -> Candidates:
    """Return the *selected* candidates of a frame of *size_px* (width, height), and what stands there.

    A standing vehicle is there if none of all candidates *found* lies on its place. Sorted by row, then column.
    """
    kept = found.take(selected)
    if len(standing.score) == 0:
        return kept
    boxes, seen = _in_frame(standing.boxes, frame_to_reference, size_px)
    both = np.concatenate([_boxes_of(found), boxes])
    rank = np.concatenate([np.full(len(found.score), 2.0), np.where(seen, 1.0, 0.0)])
    there = stand_alone(both, rank, (1 / metres_per_px[0], 1 / metres_per_px[1]))[len(found.score) :] & seen
    added = _candidates(standing, boxes, frame_to_reference, size_px, there)
    joined = kept.joined(added)
    return joined.take(np.lexsort((joined.col_px, joined.row_px)))


# looking --------------------------------------------------------------------------------------------------------------


def _none() -> Standing:
    return Standing(np.zeros((0, 6)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))


def _near_road(
    place: Place, shape: tuple[int, ...], px_per_m: tuple[float, float], reach_m: float
) -> NDArray[np.bool_]:
    """Return the cells of _CELL_M, from the picture's corner on, that lie within *reach_m* of the road."""
    rows, columns = (int(np.ceil(shape[k] / px_per_m[1 - k] / _CELL_M)) for k in range(2))
    road = place.on_grid((np.arange(columns) + 0.5) * _CELL_M, (np.arange(rows) + 0.5) * _CELL_M)
    if not road.any():
        return road
    away = cv2.distanceTransform((~road).astype(np.uint8), cv2.DIST_L2, 5) * _CELL_M
    return np.asarray(away <= reach_m)


def _anywhere(near: NDArray[np.bool_], px_per_m: tuple[float, float]) -> tuple[Array, Array]:
    """Return places in px and axes, spread evenly over the cells *near* and over all directions."""
    cells = np.argwhere(near)
    number = np.arange(min(_OTHERS, len(cells)))
    spread = (0.5 + number[:, None] * _SPREAD) % 1.0
    chosen = cells[(number * len(cells)) // max(1, len(number))]
    places = (chosen[:, ::-1] + spread[:, :2]) * _CELL_M * px_per_m - 0.5
    angle = np.pi * spread[:, 2]
    return places, np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _far_from(places: Array, others: Array, px_per_m: tuple[float, float]) -> NDArray[np.bool_]:
    """Return which *places* lie clear of all *others*, both in px."""
    away = np.linalg.norm((places[:, None] - others[None]) / px_per_m, axis=2)
    return np.asarray((away > _KEEP_CLEAR_M).all(axis=1))


def _boxes(at: Array, along: Array, size: Array, px_per_m: tuple[float, float]) -> Array:
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    return np.concatenate([at, along * (size[0] / 2) * px_per_m, across * (size[1] / 2) * px_per_m], axis=1)


def _measured(background: Background, boxes: Array, score: Array, steps: tuple[int, int]) -> Standing:
    """Take colour and contrast of *boxes*, in px of the reduced picture, and bring them to px of the reference."""
    picture = background.ground(*steps)[:, :, :3]
    inside = levels(picture, boxes, 0.7)
    around = levels(picture, boxes, 1.6)
    colour = np.median(inside, axis=1)
    contrast = np.abs(inside - np.median(around, axis=1)[:, None]).max(axis=2).mean(axis=1)
    scale = np.array(steps, float)
    boxes = boxes * np.tile(scale, 3)
    boxes[:, :2] += (scale - 1) / 2
    return Standing(boxes, colour, contrast, score)


# in a frame -----------------------------------------------------------------------------------------------------------


def _boxes_of(found: Candidates) -> Array:
    return np.stack([found.col_px, found.row_px, found.lx_px, found.ly_px, found.wx_px, found.wy_px], axis=1)


def _moved(boxes: Array, by: Array) -> Array:
    """Return *boxes* (n, 6) as the homography *by* maps them."""
    local = homography.jacobian(by, boxes[:, :2])
    axes = [np.einsum("nij,nj->ni", local, boxes[:, k : k + 2]) for k in (2, 4)]
    return np.concatenate([homography.apply(by, boxes[:, :2]), *axes], axis=1)


def _in_frame(boxes: Array, frame_to_reference: Array, size_px: tuple[int, int]) -> tuple[Array, NDArray[np.bool_]]:
    """Return *boxes* of the reference in the frame's px, and which have their centre there."""
    moved = _moved(boxes, np.asarray(np.linalg.inv(frame_to_reference), np.float64))
    seen = ((moved[:, :2] >= -0.5) & (moved[:, :2] < np.array(size_px) - 0.5)).all(axis=1)
    return moved, np.asarray(seen)


def _candidates(
    standing: Standing, boxes: Array, frame_to_reference: Array, size_px: tuple[int, int], there: NDArray[np.bool_]
) -> Candidates:
    boxes, colour = boxes[there], standing.colour[there]
    reach = np.abs(boxes[:, 2:4]) + np.abs(boxes[:, 4:6])
    over = ((boxes[:, :2] - reach < -0.5) | (boxes[:, :2] + reach > np.array(size_px) - 0.5)).any(axis=1)
    flags = np.where(over, int(DetectionFlag.TOUCHES_BORDER), 0) | int(DetectionFlag.IN_BACKGROUND)
    return Candidates(
        col_px=boxes[:, 0],
        row_px=boxes[:, 1],
        lx_px=boxes[:, 2],
        ly_px=boxes[:, 3],
        wx_px=boxes[:, 4],
        wy_px=boxes[:, 5],
        area_px=4 * np.abs(boxes[:, 2] * boxes[:, 5] - boxes[:, 3] * boxes[:, 4]),
        red=colour[:, 0],
        green=colour[:, 1],
        blue=colour[:, 2],
        contrast=standing.contrast[there],
        score=standing.score[there],
        flags=flags.astype(np.int32),
    )
