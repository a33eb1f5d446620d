"""The place: where traffic runs, learned from fast straight chains; weak candidates count there and nowhere else.

False alarms are mostly roofs and facades seen from a moving platform. They are as strong as vehicles, but they are not
where fast things run. Source: two-round detection, measured on real frames; no frame is decoded twice, because weak
candidates are kept with their score.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.detection.candidates import Candidates
from vtrack_batch.detection.chains import Chains, Sightings, find_chains, kinds_of, supported
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.model import homography
from vtrack_batch.model.flags import DetectionFlag
from vtrack_batch.model.homography import Array

_CELL_M = 0.5
_MANY_CHAINS = 40
_PLACES_A_LINK = 12
# Levels in L*a*b* by which grounds of one kind may differ in hue: asphalt in shade and sun, concrete, gravel.
_SAME_HUE, _SAME_SHARE = 10.0, 0.75
# How much of a vehicle's half length must lie on the road.
_SPAN = 0.75


@dataclass(frozen=True, eq=False)
class Place:
    """What candidates told of the place.

    ``road`` (rows, columns) bool in cells of 0.5 m, the first at ``origin_m`` of the reference's metres; ``learned`` =
    enough chains were found; ``trusted_elsewhere`` = strict candidates count off the road too; ``chained`` = for every
    frame the rows of candidates that belong to chains.
    """

    road: NDArray[np.bool_]
    origin_m: Array
    metres_per_px: tuple[float, float]
    learned: bool
    trusted_elsewhere: bool
    chained: tuple[NDArray[np.int64], ...]

    def on_road(self, xy_m: Array) -> NDArray[np.bool_]:
        """Return which points (n, 2), in the reference's metres, lie on the road."""
        cell = np.floor((xy_m - self.origin_m) / _CELL_M).astype(int)
        inside = (cell >= 0).all(axis=1) & (cell < self.road.shape[::-1]).all(axis=1)
        on = np.zeros(len(xy_m), np.bool_)
        on[inside] = self.road[cell[inside, 1], cell[inside, 0]]
        return on

    def on_grid(self, x_m: NDArray[Any], y_m: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which points (rows, columns) of a grid at *y_m* (rows,) and *x_m* (columns,) lie on the road."""
        row, column = (
            np.floor((own - first) / _CELL_M).astype(int)
            for own, first in ((y_m, self.origin_m[1]), (x_m, self.origin_m[0]))
        )
        down, across = (row >= 0) & (row < self.road.shape[0]), (column >= 0) & (column < self.road.shape[1])
        on = np.zeros((len(row), len(column)), np.bool_)
        on[np.ix_(down, across)] = self.road[np.ix_(row[down], column[across])]
        return on


def learn_place(
    candidates: Sequence[Candidates],
    poses: Sequence[Array],
    times_s: Array,
    *,
    metres_per_px: tuple[float, float],
    params: DetectionParams,
    ground: NDArray[np.uint8] | None = None,
) -> Place:
    """Learn the road from the strict candidates of all frames of a block.

    *poses* take each frame's px to the reference's, *times_s* (n,) are seconds from any start; *ground* (H, W, 3 or
    more) uint8 is the picture of the reference without traffic, for chains over roofs are told by its hue. With fewer
    than ``fewest_chains`` chains the place counts as not learned.
    """
    strict = [np.nonzero(found.score >= params.chain_score)[0] for found in candidates]
    seen = [
        _sightings(f.take(rows), pose, metres_per_px) for f, rows, pose in zip(candidates, strict, poses, strict=True)
    ]
    times = np.asarray(times_s, float)
    kinds = kinds_of(times, params)
    chains = [find_chains(seen, times, kind, params=params) for kind in kinds]
    if ground is not None:
        chains = _of_one_hue(chains, ground, metres_per_px)
    chains = supported(chains, seen, times, params=params)
    loose = sum(len(chain.rows) for chain, kind in zip(chains, kinds, strict=True) if kind.loose)
    members = [np.unique(np.concatenate([kind.rows[kind.frames == i] for kind in chains])) for i in range(len(seen))]
    chained = tuple(rows[chosen] for rows, chosen in zip(strict, members, strict=True))
    if sum(len(kind.rows) for kind in chains) < params.fewest_chains:
        return Place(np.zeros((1, 1), np.bool_), np.zeros(2), metres_per_px, False, True, chained)
    road, origin = _draw(chains, len(seen), 1 if loose < _MANY_CHAINS else 2, params)
    place = Place(road, origin, metres_per_px, True, False, chained)
    return replace(place, trusted_elsewhere=_is_tidy(place, candidates, poses, params))


def _of_one_hue(kinds: Sequence[Chains], ground: NDArray[np.uint8], metres_per_px: tuple[float, float]) -> list[Chains]:
    """Return the chains over ground of the hue that most chains run over, however lit: the others are over roofs."""
    if not sum(len(kind.lines) for kind in kinds):
        return list(kinds)
    part = np.linspace(0, 1, _PLACES_A_LINK, endpoint=False)[:, None]
    last = np.array(ground.shape[1::-1]) - 1
    found = []
    for kind in kinds:
        start, end = kind.lines[:, :-1, None], kind.lines[:, 1:, None]
        points = np.clip(np.rint((start + part * (end - start)) / metres_per_px).astype(int), 0, last)
        levels = ground[points[..., 1], points[..., 0], :3].reshape(len(points), points.shape[1] * points.shape[2], 3)
        lab = cv2.cvtColor(levels, cv2.COLOR_RGB2LAB) if levels.size else levels
        found.append(lab[:, :, 1:].astype(np.float64))
    usual = np.median(np.concatenate([np.median(hues, axis=1) for hues in found]), axis=0)
    alike = [np.linalg.norm(hues - usual, axis=2) <= _SAME_HUE for hues in found]
    return [kind.take(same.mean(axis=1) >= _SAME_SHARE) for kind, same in zip(kinds, alike, strict=True)]


def _is_tidy(place: Place, candidates: Sequence[Candidates], poses: Sequence[Array], params: DetectionParams) -> bool:
    """Whether strict candidates lie on the road, but for few: then those few are on roads nobody drove fast on."""
    strict = off = 0
    for found, pose, chained in zip(candidates, poses, place.chained, strict=True):
        strong = found.score >= params.strict_score
        strict += int(strong.sum())
        strong[chained] = False
        off += int((strong & ~place.on_road(_centres_m(found, pose, place))).sum())
    return off <= params.clutter_share * strict


def select(
    candidates: Candidates, frame_to_reference: Array, place: Place, *, frame: int, params: DetectionParams
) -> NDArray[np.bool_]:
    """Return which candidates (n,) bool of the frame with number *frame* in ``learn_place`` are taken for vehicles.

    On the road weak ones count, if front and back lie there too; elsewhere those that belong to a chain, and strict
    ones unless most of them lie off the road. Where nothing was learned, strict ones count everywhere. Long ones that
    reach over the frame's border count if they belong to a chain: how they end is not seen, and roofs lie there too.
    """
    taken = candidates.score >= (params.strict_score if place.trusted_elsewhere else np.inf)
    chained = np.isin(np.arange(len(taken)), place.chained[frame])
    centre = _centres_m(candidates, frame_to_reference, place)
    front = _fronts_m(candidates, frame_to_reference, place.metres_per_px)
    on_road = place.on_road(centre) & place.on_road(centre + _SPAN * front) & place.on_road(centre - _SPAN * front)
    taken |= on_road & (candidates.score >= params.weak_score)
    cut = (candidates.flags & int(DetectionFlag.TOUCHES_BORDER)) > 0
    taken &= ~cut | (2 * np.linalg.norm(front, axis=1) <= params.cut_length_m)
    return np.asarray(taken | chained)


def flag_outside(candidates: Candidates, frame_to_reference: Array, place: Place) -> Candidates:
    """Return *candidates* with ``OUTSIDE_ROAD`` set for those off the road, where one was learned."""
    if not place.learned:
        return candidates
    outside = ~place.on_road(_centres_m(candidates, frame_to_reference, place))
    bit = np.int32(DetectionFlag.OUTSIDE_ROAD)
    return replace(candidates, flags=np.where(outside, candidates.flags | bit, candidates.flags & ~bit))


def _centres_m(candidates: Candidates, frame_to_reference: Array, place: Place) -> Array:
    centre = np.stack([candidates.col_px, candidates.row_px], axis=1)
    return homography.apply(frame_to_reference, centre) * place.metres_per_px


def _fronts_m(candidates: Candidates, pose: Array, metres_per_px: tuple[float, float]) -> Array:
    """Return from the middle of each candidate to its front, in the reference's metres."""
    centre = np.stack([candidates.col_px, candidates.row_px], axis=1)
    along = np.stack([candidates.lx_px, candidates.ly_px], axis=1)
    return np.asarray(np.einsum("nij,nj->ni", homography.jacobian(pose, centre), along) * metres_per_px)


def _sightings(candidates: Candidates, pose: Array, metres_per_px: tuple[float, float]) -> Sightings:
    centre = np.stack([candidates.col_px, candidates.row_px], axis=1)
    axis = _fronts_m(candidates, pose, metres_per_px)
    half_length = np.maximum(np.linalg.norm(axis, axis=1), 1e-9)
    axis /= half_length[:, None]
    colour = np.stack([candidates.red, candidates.green, candidates.blue], axis=1)
    return Sightings(homography.apply(pose, centre) * metres_per_px, axis, 2 * half_length, colour)


def _draw(
    kinds: Sequence[Chains], frames: int, needed: int, params: DetectionParams
) -> tuple[NDArray[np.bool_], Array]:
    """Return the road as cells, and the corner of the first: chains, as wide as a lane and a bit.

    At every place chains that begin at so many different frames as *needed*.
    """
    lines = [_extended(kind.lines, params.road_ahead_m) for kind in kinds]
    everything = np.concatenate([line.reshape(-1, 2) for line in lines])
    origin = everything.min(axis=0) - 2 * params.road_reach_m
    extent = np.ceil((everything.max(axis=0) + 2 * params.road_reach_m - origin) / _CELL_M).astype(int)
    width = max(1, round(2 * params.road_reach_m / _CELL_M))
    count = np.zeros((extent[1], extent[0]), np.uint8)
    for frame in range(frames):
        drawn = np.zeros_like(count)
        for kind, line in zip(kinds, lines, strict=True):
            points = np.rint((line[kind.frames[:, 0] == frame] - origin) / _CELL_M - 0.5).astype(np.int32)
            cv2.polylines(drawn, list(points), False, 1, thickness=width)
        count = cv2.add(count, drawn)
    return count >= needed, origin


def _extended(lines: Array, by_m: float) -> Array:
    """Return *lines* (m, n, 2) with a straight piece of *by_m* before and after each."""
    first, last = lines[:, 0] - lines[:, 1], lines[:, -1] - lines[:, -2]
    # A chain may end with a stop: there is no way to go on.
    before = lines[:, 0] + first * by_m / np.maximum(np.linalg.norm(first, axis=1), 1e-9)[:, None]
    after = lines[:, -1] + last * by_m / np.maximum(np.linalg.norm(last, axis=1), 1e-9)[:, None]
    return np.concatenate([before[:, None], lines, after[:, None]], axis=1)
