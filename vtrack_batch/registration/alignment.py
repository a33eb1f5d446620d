"""Laying a frame on its block's reference frame: guess, find patches, fit, measure, accept or refuse."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from vtrack_batch.model import homography
from vtrack_batch.registration.coarse import Guess, pose_by_features, pose_by_flow
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.patches import Search, Sightings, find_patches
from vtrack_batch.registration.pose import Consensus, Pose, distances, fit_pose, refit_pose
from vtrack_batch.registration.reduction import Grey, green_of, thin
from vtrack_batch.registration.reference import Reference

Reason = Literal["blank", "not_registered", "little_overlap", "partly_covered", "residual_too_large"]

_COVERAGE_CELLS = 4
_FIRST_PATCHES = 45


@dataclass(frozen=True, eq=False)
class Registration:
    """Where a frame lies on the reference frame, and how well that is known.

    ``frame_to_reference`` (3, 3) float64, last element 1; ``inliers`` patches of the fit that agree with it;
    ``inlier_share`` of those found; ``residual_px``: robust root mean square distance at patches kept out of the fit,
    in reference pixels (inf where nothing was found); ``reason``: why it was refused, None if accepted; ``patches_px``
    (m, 2) float64: where in the frame the reference's patches were found, NaN = not found.
    """

    frame_to_reference: NDArray[np.float64]
    inliers: int
    inlier_share: float
    residual_px: float
    accepted: bool
    reason: Reason | None
    patches_px: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Trial:
    pose: Pose
    patches_px: NDArray[np.float64]
    confirmed_share: float
    coverage_share: float
    overlap_share: float


def register(
    pixels: NDArray[np.uint8],
    reference: Reference,
    *,
    start: NDArray[np.float64] | None = None,
    params: RegistrationParams,
) -> Registration:
    """Lay the frame *pixels* (H, W, 3) uint8 RGB on *reference*; refuse it where the result cannot be trusted.

    Guesses are tried in a fixed order until one is confirmed by patches: optical flow of the whole frame, then
    *start* (3, 3) if given, then features. A frame that tells its own place is thus laid the same way whatever frame
    came before it.
    """
    plane = green_of(pixels)
    reduced = thin(plane, reference.factor)
    if float(cv2.meanStdDev(reduced)[1].item()) < params.min_contrast:
        return _lost(reference, "blank")
    best: _Trial | None = None
    for guess in _guesses(plane, reduced, reference, start=start, seed=params.seed):
        trial = _refined(plane, reference, guess, params)
        if trial is not None and (best is None or trial.confirmed_share > best.confirmed_share):
            best = trial
        if best is not None and _doubt(best, params) is None:
            break
    if best is None:
        return _lost(reference, "not_registered")
    reason, pose = _doubt(best, params), best.pose
    told = pose.matrix, pose.inliers, pose.inlier_share, pose.residual_px
    return Registration(*told, reason is None, reason, best.patches_px)


def _lost(reference: Reference, reason: Reason) -> Registration:
    return Registration(np.eye(3), 0, 0.0, float("inf"), False, reason, np.full_like(reference.centres_px, np.nan))


def _guesses(
    plane: Grey, reduced: Grey, reference: Reference, *, start: NDArray[np.float64] | None, seed: int
) -> Iterator[Guess]:
    yield pose_by_flow(reduced, reference, seed)
    if start is not None:
        yield Guess(np.asarray(start, float), float("inf"))
    by_features = pose_by_features(plane, reference, seed)
    if by_features is not None:
        yield by_features


def _refined(plane: Grey, reference: Reference, guess: Guess, params: RegistrationParams) -> _Trial | None:
    """Return the pose after two rounds of patches: a few to mend the guess, then all of them."""
    every = np.ones(len(reference.centres_px), bool)
    few = np.arange(len(every)) % max(1, len(every) // _FIRST_PATCHES) == 0
    first = _found(plane, reference, guess, few, params=params)
    mended = fit_pose(*_pairs(first, reference), Consensus(params.inlier_tolerance_px, params.seed))
    if mended is None:
        return None
    seen = _found(plane, reference, Guess(mended.matrix, mended.residual_px), every, params=params)
    final = refit_pose(mended.matrix, *_pairs(seen, reference), params.inlier_tolerance_px)
    return None if final is None else _judged(final, seen, plane.shape, reference, params)


def _found(
    plane: Grey, reference: Reference, guess: Guess, chosen: NDArray[np.bool_], *, params: RegistrationParams
) -> Sightings:
    """Look for the *chosen* patches around the places that *guess* predicts."""
    # Where the scene is rigid a good guess leaves little to look for; where it leans and sways, more.
    reach_px = math.ceil(min(params.search_px, 1.5 + 3 * guess.error_px))
    search = Search(reach_px, params.min_correlation)
    return find_patches(plane, reference, guess.frame_to_reference, chosen=chosen, search=search)


def _pairs(
    sightings: Sightings, reference: Reference
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return the places of patches in the frame, in the reference, and which never enter a fit."""
    found = sightings.found
    return sightings.frame_px[found], reference.centres_px[found], reference.held_out[found]


def _judged(
    pose: Pose,
    sightings: Sightings,
    plane_shape: tuple[int, ...],
    reference: Reference,
    params: RegistrationParams,
) -> _Trial:
    """Measure how many of the patches that the frame should show bear the *pose* out, and over how much of it."""
    found, visible = sightings.found, sightings.visible
    length = np.full(len(found), np.inf)
    length[found] = distances(pose.matrix, sightings.frame_px[found], reference.centres_px[found])
    confirmed = length <= 2 * params.inlier_tolerance_px
    checked = visible & reference.held_out
    cell = cell_of(reference)
    shown = np.bincount(cell[visible], minlength=_COVERAGE_CELLS**2)
    borne_out = np.bincount(cell[visible & confirmed], minlength=_COVERAGE_CELLS**2)
    vouched = borne_out >= 0.1 * shown
    return _Trial(
        pose,
        sightings.frame_px,
        confirmed_share=float(confirmed[checked].mean()) if checked.any() else 0.0,
        coverage_share=float((shown * (vouched & (borne_out > 0))).sum() / max(1, shown.sum())),
        overlap_share=overlap_share(pose.matrix, plane_shape, reference),
    )


def overlap_share(frame_to_reference: NDArray[np.float64], shape: tuple[int, ...], reference: Reference) -> float:
    """Return the share of the reference frame that a frame of *shape* (H, W, ...) at a pose (3, 3) shows."""
    shown = shapely.Polygon(homography.apply(frame_to_reference, homography.corners(shape[1], shape[0])))
    if not shown.is_valid:
        return 0.0
    whole = shapely.Polygon(homography.corners(reference.shape[1], reference.shape[0]))
    return float(shown.intersection(whole).area / whole.area)


def cell_of(reference: Reference) -> NDArray[np.int64]:
    """Return in which cell of a coarse grid over the frame each patch (m,) of *reference* lies."""
    size = np.array([reference.shape[1], reference.shape[0]])
    column, row = (reference.centres_px * _COVERAGE_CELLS / size).astype(np.int64).clip(0, _COVERAGE_CELLS - 1).T
    return np.asarray(row * _COVERAGE_CELLS + column)


def _doubt(trial: _Trial, params: RegistrationParams) -> Reason | None:
    """Return why *trial* is not to be believed, None if it is."""
    if trial.confirmed_share < params.min_confirmed_share:
        return "not_registered"
    if trial.pose.residual_px > params.max_residual_px:
        return "residual_too_large"
    if trial.overlap_share < params.min_overlap_share:
        return "little_overlap"
    if trial.coverage_share < params.min_coverage_share:
        return "partly_covered"
    return None
