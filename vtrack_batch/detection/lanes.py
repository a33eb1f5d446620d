"""Which way vehicles lie where, told by well-fitting boxes of some frames of the block.

Vehicles of a place lie along its lanes. Boxes aslant over a lorry and its shadow, or over the corner of a queue, fit
their pixels, but lie as nobody else does. Where enough boxes were seen, only directions that a good part of them have
are tried; elsewhere all are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.detection.boxes import Tried
from vtrack_batch.detection.candidates import Candidates
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.model import homography
from vtrack_batch.model.homography import Array

_CELL_M = 2.0


@dataclass(frozen=True, eq=False)
class Lanes:
    """Which directions are tried where.

    ``tried`` (rows, columns, directions) bool in cells of 2 m from the corner of the reference on, by the number of the
    direction in ``DetectionParams.directions``.
    """

    tried: NDArray[np.bool_]
    metres_per_px: tuple[float, float]

    def tried_in(self, frame_to_reference: Array) -> Tried:
        """Return what tells of places (n, 2) in px of a frame which directions (n, d) are tried there."""
        # A frame may be turned against the reference.
        across = frame_to_reference[:2, 0] * self.metres_per_px
        turned = round(float(np.arctan2(across[1], across[0])) / np.pi * self.tried.shape[2])
        last = np.array(self.tried.shape[1::-1]) - 1

        def tried(places: Array) -> NDArray[np.bool_]:
            metres = (homography.apply(frame_to_reference, places) + 0.5) * self.metres_per_px
            cell = np.clip((metres // _CELL_M).astype(int), 0, last)
            return np.ascontiguousarray(np.roll(self.tried[cell[:, 1], cell[:, 0]], -turned, axis=1))

        return tried


def learn_lanes(
    candidates: Sequence[Candidates],
    poses: Sequence[Array],
    shape: tuple[int, ...],
    *,
    metres_per_px: tuple[float, float],
    params: DetectionParams,
) -> Lanes:
    """Let the *candidates* of some frames that score ``lane_score`` vote for their direction in all cells around.

    *poses* take each frame's px to those of the reference, of *shape* (rows, columns) and *metres_per_px*. Directions
    that have ``lane_share`` of the votes around a cell are tried there, with their neighbours; all of them where there
    are fewer votes than ``lane_votes``.
    """
    scale = np.array(metres_per_px)
    size = np.ceil(np.array(shape[1::-1]) * scale / _CELL_M).astype(int)
    votes = np.zeros((size[1], size[0], params.directions), np.float32)
    for found, pose in zip(candidates, poses, strict=True):
        good = found.take(found.score >= params.lane_score)
        centre = np.stack([good.col_px, good.row_px], axis=1)
        along = np.stack([good.lx_px, good.ly_px], axis=1)
        axis = np.einsum("nij,nj->ni", homography.jacobian(pose, centre), along) * scale
        cell = ((homography.apply(pose, centre) + 0.5) * scale // _CELL_M).astype(int)
        inside = ((cell >= 0) & (cell < size)).all(axis=1)
        number = np.rint(np.arctan2(axis[:, 1], axis[:, 0]) / np.pi * params.directions).astype(int)
        np.add.at(votes, (cell[inside, 1], cell[inside, 0], number[inside] % params.directions), 1.0)
    return Lanes(_enough(votes, params), metres_per_px)


def _enough(votes: NDArray[np.float32], params: DetectionParams) -> NDArray[np.bool_]:
    """Return the directions (rows, columns, d) that have enough of the *votes* around."""
    sigma = params.lane_reach_m / _CELL_M
    around = np.stack(
        [
            cv2.GaussianBlur(np.ascontiguousarray(plane), (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
            for plane in np.moveaxis(votes, 2, 0)
        ],
        axis=2,
    )
    around = around * np.float32(2 * np.pi * sigma**2)
    # A lane may lie between two directions.
    around = 0.5 * around + 0.25 * (np.roll(around, 1, axis=2) + np.roll(around, -1, axis=2))
    total = around.sum(axis=2, keepdims=True)
    tried = around >= params.lane_share * total
    tried |= np.roll(tried, 1, axis=2) | np.roll(tried, -1, axis=2)
    return np.asarray(tried | (total < params.lane_votes) | ~tried.any(axis=2, keepdims=True))
