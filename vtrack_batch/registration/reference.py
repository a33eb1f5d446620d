"""What is kept of a reference frame so that others can be laid on it: a reduced image, features, small patches."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.errors import UnusableFrame
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.reduction import (
    Grey,
    green_of,
    level_contrast,
    no_data,
    reduce,
    reduction_factor,
    thin,
    to_reduced,
)

_COARSE_POINTS = 90
_ORB_FEATURES = 2000
_ORB_PIXELS = 500_000
_FEWEST_PATCHES = 20


@dataclass(frozen=True, eq=False)
class Features:
    """ORB features: ``points_px`` (n, 2) float64 in full-resolution pixels, ``descriptors`` (n, 32) uint8."""

    points_px: NDArray[np.float64]
    descriptors: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference frame in digest; a few MB whatever the frame's size, and picklable.

    ``shape`` (rows, columns) of the frame; ``factor`` its reduction; ``coarse`` the reduced, contrast-levelled image;
    ``coarse_points`` (n, 2) float32 corners in it; ``features`` for the fallback; ``patches`` (m, s, s) uint8 of the
    green channel around ``centres_px`` (m, 2) float64, of which ``held_out`` (m,) bool never enter a fit.
    """

    shape: tuple[int, int]
    factor: int
    coarse: Grey
    coarse_points: NDArray[np.float32]
    features: Features
    patches: NDArray[np.uint8]
    centres_px: NDArray[np.float64]
    held_out: NDArray[np.bool_]


def prepare_reference(pixels: NDArray[np.uint8], *, params: RegistrationParams) -> Reference:
    """Digest the reference frame *pixels* (H, W, 3) uint8 RGB of a block.

    Patches are the best corners (Shi & Tomasi 1994) of a regular grid of cells, so that every part of the frame has its
    say; which of them are worth more than others only frames can tell, see `steady_patches`.

    Raises `UnusableFrame` (``blank``) where the frame has too little texture to register anything to.
    """
    plane, missing = np.ascontiguousarray(green_of(pixels)), no_data(pixels)
    centres = _patch_centres(plane, missing, params)
    rows, columns = plane.shape
    factor = reduction_factor((rows, columns), params.coarse_pixels)
    levelled = level_contrast(thin(plane, factor))
    allowed = reduce((~missing).view(np.uint8) * np.uint8(255), factor) == 255
    if len(centres) < _FEWEST_PATCHES:
        raise UnusableFrame("blank", f"{len(centres)} corners found, {_FEWEST_PATCHES} are needed of a reference frame")
    half = params.patch_px // 2
    return Reference(
        shape=(rows, columns),
        factor=factor,
        coarse=levelled,
        coarse_points=_corners(levelled, allowed, _COARSE_POINTS, 7),
        features=find_features(plane),
        patches=np.stack([plane[y - half : y + half + 1, x - half : x + half + 1] for x, y in centres]),
        centres_px=centres.astype(float),
        held_out=spread(len(centres), params.held_out_share),
    )


def find_features(plane: Grey) -> Features:
    """Find ORB features (Rublee et al. 2011) of the grey image *plane* after reducing it."""
    factor = reduction_factor((plane.shape[0], plane.shape[1]), _ORB_PIXELS)
    keypoints, descriptors = cv2.ORB.create(nfeatures=_ORB_FEATURES).detectAndCompute(reduce(plane, factor), None)
    if descriptors is None:
        return Features(np.empty((0, 2)), np.empty((0, 32), np.uint8))
    points = np.array([keypoint.pt for keypoint in keypoints], float).reshape(-1, 2)
    to_full = np.linalg.inv(to_reduced(factor))
    return Features(points * to_full[0, 0] + to_full[0, 2], np.asarray(descriptors))


def _patch_centres(plane: Grey, barred: NDArray[np.bool_], params: RegistrationParams) -> NDArray[np.int64]:
    """Return the best corner (col, row) of each cell of a grid, row by row."""
    margin = params.patch_px // 2 + 1
    rows, columns = plane.shape
    inner_rows, inner_columns = rows - 2 * margin, columns - 2 * margin
    if inner_rows < 8 or inner_columns < 8:
        return np.empty((0, 2), np.int64)
    down = max(1, round((params.patches * inner_rows / inner_columns) ** 0.5))
    across = max(1, round(params.patches / down))
    row_edges = np.linspace(margin, rows - margin, down + 1).astype(int)
    column_edges = np.linspace(margin, columns - margin, across + 1).astype(int)
    # A patch must not even touch a barred place: grow those by half a patch first.
    near_barred = cv2.dilate(barred.view(np.uint8), np.ones((params.patch_px, params.patch_px), np.uint8)) > 0
    found = [
        _best_corner(plane, near_barred, (top, bottom, left, right))
        for top, bottom in pairwise(row_edges.tolist())
        for left, right in pairwise(column_edges.tolist())
    ]
    return np.array([place for place in found if place is not None], np.int64).reshape(-1, 2)


def _best_corner(plane: Grey, barred: NDArray[np.bool_], cell: tuple[int, int, int, int]) -> tuple[int, int] | None:
    top, bottom, left, right = cell
    free = ~barred[top:bottom, left:right]
    if not free.any():
        return None
    response = cv2.cornerMinEigenVal(plane[top:bottom, left:right], 7, ksize=3)
    response[~free] = 0
    _, strength, _, (column, row) = cv2.minMaxLoc(response)
    # 1e-4 in OpenCV's scaling is a corner of about 2 grey values: below that a patch holds noise only.
    return (left + column, top + row) if strength > 1e-4 else None


def _corners(image: Grey, allowed: NDArray[np.bool_], count: int, spacing_px: int) -> NDArray[np.float32]:
    mask = allowed.astype(np.uint8)
    found = cv2.goodFeaturesToTrack(image, count, 0.01, spacing_px, mask=mask)
    return np.empty((0, 2), np.float32) if found is None else np.asarray(found, np.float32).reshape(-1, 2)


def spread(count: int, share: float) -> NDArray[np.bool_]:
    """Mark a *share* of *count* patches in rows of a grid, so that the marked ones lie all over the frame."""
    # The golden ratio steps through the rows of the grid without lining up into columns.
    return np.asarray((np.arange(count) * 0.6180339887498949) % 1.0 < share)
