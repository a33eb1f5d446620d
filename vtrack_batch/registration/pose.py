"""Fitting a plane map to noisy point pairs, and choosing how much freedom it deserves by points it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model import homography
from vtrack_batch.registration.polishing import polished

Points = NDArray[np.float64]

_FEWEST_POINTS = 8
_AFFINE = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
# A homography must predict unseen points this much better than an affine map before its two extra freedoms are used.
_PREFERENCE = 0.9
# The residual is told from the closest 40 % of the points, so that 60 % may lie on moving things or on roofs. Distances
# of isotropic Gaussian errors are Rayleigh distributed: their root mean square is quantile(q) / sqrt(-ln(1 - q)).
_TRUSTED_SHARE = 0.4
_QUANTILE_TO_RMS = float(1 / np.sqrt(-np.log(1 - _TRUSTED_SHARE)))


@dataclass(frozen=True, eq=False)
class Pose:
    """A fitted map: ``matrix`` (3, 3), how many fitted points agree, and the robust residual at held-out points."""

    matrix: NDArray[np.float64]
    inliers: int
    fitted: int
    residual_px: float

    @property
    def inlier_share(self) -> float:
        """Share of the fitted points that agree with the map."""
        return self.inliers / max(1, self.fitted)


@dataclass(frozen=True)
class Consensus:
    """Settings of the sampling consensus: residual of an inlier in pixels, and the seed of the sampling."""

    tolerance_px: float
    seed: int


def fit_pose(source: Points, target: Points, held_out: NDArray[np.bool_], consensus: Consensus) -> Pose | None:
    """Fit a map from *source* to *target*, both (n, 2), to the points that are not *held_out* (n,) bool.

    An affine map and a homography are fitted by MAGSAC++ (Barath et al. 2020) and polished by iteratively reweighted
    least squares; the one with the smaller robust residual at the held-out points is returned, None if neither fits.
    """
    fitting = ~held_out
    if not _enough(held_out):
        return None
    starts = [sample(source[fitting], target[fitting], consensus) for sample in (_sampled_affine, _sampled_homography)]
    return _better(source, target, held_out, starts, consensus.tolerance_px)


def refit_pose(
    matrix: NDArray[np.float64], source: Points, target: Points, held_out: NDArray[np.bool_], tolerance_px: float
) -> Pose | None:
    """Fit as `fit_pose` does, from a *matrix* (3, 3) that is nearly right: nothing is left to chance."""
    if not _enough(held_out):
        return None
    return _better(source, target, held_out, [matrix * _AFFINE, matrix], tolerance_px)


def _enough(held_out: NDArray[np.bool_]) -> bool:
    return bool((~held_out).sum() >= _FEWEST_POINTS and held_out.sum() >= 2)


def _better(
    source: Points,
    target: Points,
    held_out: NDArray[np.bool_],
    starts: Sequence[NDArray[np.float64] | None],
    tolerance_px: float,
) -> Pose | None:
    """Polish the affine map and the homography of *starts*; return the one that better predicts *held_out* points."""
    here, there, poses = source[~held_out], target[~held_out], []
    for freedoms, start in zip((6, 8), starts, strict=True):
        if start is None:
            continue
        matrix = polished(start, here, there, freedoms=freedoms, tolerance_px=tolerance_px)
        if not _is_plausible(matrix, source):
            continue
        inliers = int((distances(matrix, here, there) <= tolerance_px).sum())
        residual = robust_rms(distances(matrix, source[held_out], target[held_out]))
        poses.append(Pose(homography.normalised(matrix), inliers, len(here), residual))
    if not poses:
        return None
    affine, last = poses[0], poses[-1]
    return last if last.residual_px < _PREFERENCE * affine.residual_px else affine


def distances(matrix: NDArray[np.float64], source: Points, target: Points) -> NDArray[np.float64]:
    """Return how far (n,) the images of *source* under *matrix* lie from *target*."""
    return np.asarray(np.linalg.norm(homography.apply(matrix, source) - target, axis=1))


def robust_rms(lengths: NDArray[np.float64]) -> float:
    """Return the root mean square of Gaussian errors as told from the smallest *lengths* (n,); inf for none."""
    if not len(lengths):
        return float("inf")
    at = _TRUSTED_SHARE * (len(lengths) - 1)
    ordered, low = np.sort(lengths), int(at)
    quantile = ordered[low] + (at - low) * (ordered[min(low + 1, len(ordered) - 1)] - ordered[low])
    return float(quantile) * _QUANTILE_TO_RMS


def _usac(consensus: Consensus) -> cv2.UsacParams:
    settings = cv2.UsacParams()
    settings.threshold = consensus.tolerance_px
    settings.confidence = 0.999
    settings.maxIterations = 1000
    settings.randomGeneratorState = consensus.seed
    settings.sampler = cv2.SAMPLING_UNIFORM
    settings.score = cv2.SCORE_METHOD_MAGSAC
    settings.loMethod = cv2.LOCAL_OPTIM_SIGMA
    settings.loIterations = 10
    settings.loSampleSize = 14
    return settings


def _sampled_affine(source: Points, target: Points, consensus: Consensus) -> NDArray[np.float64] | None:
    cv2.setRNGSeed(consensus.seed)
    matrix, _ = cv2.estimateAffine2D(
        source, target, method=cv2.RANSAC, ransacReprojThreshold=consensus.tolerance_px, maxIters=1000, confidence=0.999
    )
    return None if matrix is None or not np.isfinite(matrix).all() else np.vstack([matrix, [0.0, 0.0, 1.0]])


def _sampled_homography(source: Points, target: Points, consensus: Consensus) -> NDArray[np.float64] | None:
    matrix, _ = cv2.findHomography(source, target, _usac(consensus))
    if matrix is None or not np.isfinite(matrix).all() or abs(matrix[2, 2]) < 1e-9:
        return None
    return np.asarray(matrix)


def _is_plausible(matrix: NDArray[np.float64], points: Points) -> bool:
    """Say whether *matrix* keeps orientation and changes areas by less than a factor of 4 at all *points*."""
    if not np.isfinite(matrix).all() or abs(matrix[2, 2]) < 1e-9:
        return False
    areas = np.linalg.det(homography.jacobian(matrix, points))
    return bool(np.isfinite(areas).all() and (areas > 0.25).all() and (areas < 4.0).all())
