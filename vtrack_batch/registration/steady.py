"""Which patches of a reference lie on the ground: those that stay where the pose puts them, frame after frame.

Roofs, masts and trees lean as the platform drifts, each by its height, and vehicles leave; the ground alone agrees with
itself. So the patches with the smallest residuals over several frames are kept, the poses fitted anew to these, and so
on with fewer and fewer: the pose settles on the plane of the ground even where most patches lie on roofs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model import homography
from vtrack_batch.registration.alignment import Registration, cell_of
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.pose import refit_pose
from vtrack_batch.registration.reference import Reference, spread

_SHARES = (0.8, 0.65, 0.5, 0.4)
_ROUNDS_AT_LAST = 3
_FEWEST_FRAMES = 3
_FEWEST_PATCHES = 60
_SEEN_SHARE = 0.6

Matrices = list[NDArray[np.float64]]


def steady_patches(
    reference: Reference, laid: Sequence[Registration], *, params: RegistrationParams
) -> tuple[Reference, Matrices]:
    """Return *reference* with the steadiest of its patches only, and the poses (3, 3) of the frames *laid* on it.

    With few frames or patches all patches stay, and poses are as they were. ``params.steady_share`` of the patches
    remain.
    """
    poses = [frame.frame_to_reference for frame in laid]
    places = np.array([frame.patches_px for frame in laid]).reshape(len(laid), len(reference.centres_px), 2)
    known = np.isfinite(places).all(axis=2)
    often = known.sum(axis=0) >= _SEEN_SHARE * len(laid)
    if len(laid) < _FEWEST_FRAMES or often.sum() <= _FEWEST_PATCHES:
        return reference, poses
    for share in [share for share in _SHARES if share > params.steady_share] + [params.steady_share] * _ROUNDS_AT_LAST:
        kept = _steadiest(reference, places, poses, often, share)
        held_out = np.zeros(len(kept), bool)
        held_out[kept] = spread(int(kept.sum()), params.held_out_share)
        for i, used in enumerate(known & kept):
            ends = places[i, used], reference.centres_px[used]
            pose = refit_pose(poses[i], *ends, held_out[used], params.inlier_tolerance_px)
            poses[i] = poses[i] if pose is None else pose.matrix
    chosen = reference.centres_px[kept], reference.patches[kept], held_out[kept]
    return replace(reference, centres_px=chosen[0], patches=chosen[1], held_out=chosen[2]), poses


def _steadiest(
    reference: Reference, places: NDArray[np.float64], poses: Matrices, often: NDArray[np.bool_], share: float
) -> NDArray[np.bool_]:
    """Return which patches (m,) have the smallest median residual over frames: a *share* of those seen *often*.

    The share is taken in every cell of a coarse grid, for a pose that rests on one corner of the frame goes astray in
    the others. A cell that shows roofs alone is outvoted in the fit.
    """
    away = np.array(
        [homography.apply(pose, seen) - reference.centres_px for pose, seen in zip(poses, places, strict=True)]
    )
    residual = np.full(len(often), np.inf)
    residual[often] = np.nanmedian(np.linalg.norm(away[:, often], axis=2), axis=0)
    share = max(share, _FEWEST_PATCHES / often.sum())
    cell = np.where(often, cell_of(reference), -1)
    order = np.lexsort((residual, cell))
    count = np.bincount(cell[order] + 1)
    rank = np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
    kept = np.zeros(len(often), bool)
    kept[order] = (cell[order] >= 0) & (rank < np.ceil(share * count[cell[order] + 1]))
    return kept
