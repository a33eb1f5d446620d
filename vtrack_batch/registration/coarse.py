"""First guesses of a frame's pose: correlation of reduced images, optical flow from there, and features."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from vtrack_batch.registration.pose import Consensus, Pose, fit_pose
from vtrack_batch.registration.reduction import Grey, level_contrast, reduce, to_reduced
from vtrack_batch.registration.reference import Reference, find_features

_GREY = 128
_PEAKS = 4
_PEAK_RADIUS_PX = 4
_LARGEST_SHIFT_SHARE = 0.6
_FLOW_TOLERANCE_PX = 1.0
_FEWEST_FLOWS = 12
_FEATURE_TOLERANCE_PX = 4.0
_FLOW_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 0.03)


@dataclass(frozen=True, eq=False)
class Guess:
    """A first pose: ``frame_to_reference`` (3, 3) and its robust error in reference pixels, inf if unknown."""

    frame_to_reference: NDArray[np.float64]
    error_px: float


def pose_by_flow(reduced: Grey, reference: Reference, seed: int) -> Guess:
    """Guess where the frame whose green plane, *reduced* by the reference's factor, is given lies on the reference.

    A shift by phase correlation (Kuglin & Hines 1975) starts pyramidal optical flow (Lucas & Kanade 1981,
    Bouguet 2001) of the reference's corners; where too few corners agree, the guess is the shift alone.
    """
    coarse = _to_shape(level_contrast(reduced), reference.coarse.shape)
    shift = _shift(coarse, reference.coarse)
    down = to_reduced(reference.factor)
    up = np.linalg.inv(down)
    pose = _flow(coarse, reference, shift, seed)
    if pose is None:
        return Guess(up @ np.array([[1.0, 0, -shift[0]], [0, 1, -shift[1]], [0, 0, 1]]) @ down, float("inf"))
    return Guess(up @ pose.matrix @ down, pose.residual_px * reference.factor)


def pose_by_features(plane: Grey, reference: Reference, seed: int) -> Guess | None:
    """Guess the pose from ORB features, which survive any rotation; None if none."""
    here, there = find_features(np.ascontiguousarray(plane)), reference.features
    if min(len(here.points_px), len(there.points_px)) < 8:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(here.descriptors, there.descriptors)
    source = here.points_px[[pair.queryIdx for pair in pairs]]
    target = there.points_px[[pair.trainIdx for pair in pairs]]
    pose = fit_pose(source, target, np.arange(len(source)) % 5 == 0, Consensus(_FEATURE_TOLERANCE_PX, seed))
    return None if pose is None else Guess(pose.matrix, pose.residual_px)


def _flow(coarse: Grey, reference: Reference, shift: tuple[int, int], seed: int) -> Pose | None:
    start = reference.coarse_points
    if len(start) < 16:
        return None
    guess = (start + np.array(shift, np.float32)).astype(np.float32)
    ended, status, _ = cv2.calcOpticalFlowPyrLK(
        reference.coarse,
        coarse,
        start.reshape(-1, 1, 2),
        guess.reshape(-1, 1, 2),
        winSize=(15, 15),
        maxLevel=2,
        criteria=_FLOW_CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    arrived = np.asarray(status).ravel() == 1
    source = np.asarray(ended, float).reshape(-1, 2)[arrived]
    target = start.astype(float)[arrived]
    pose = fit_pose(source, target, np.arange(len(source)) % 4 == 0, Consensus(_FLOW_TOLERANCE_PX, seed))
    return None if pose is None or pose.inliers < _FEWEST_FLOWS else pose


def _shift(coarse: Grey, reference: Grey) -> tuple[int, int]:
    """Return the shift (col, row) in pixels that takes the reference onto the frame, both reduced.

    The strongest peaks of the phase correlation, and no shift at all, are tried on the overlap; the best one is kept,
    so that a repetitive texture does not win by a hair. Half the resolution is enough to start optical flow from.
    """
    here, there = _halved(coarse), _halved(reference)
    peaks = _correlation_peaks(here, there)
    candidates = [(0, 0), *(wrapped for peak in peaks for wrapped in _unwrapped(peak, here.shape))]
    here, there = _smooth(here), _smooth(there)
    agreement = [_agreement(here, there, candidate) for candidate in candidates]
    column, row = candidates[int(np.argmax(agreement))]
    return 2 * column, 2 * row


def _halved(image: Grey) -> NDArray[np.float32]:
    return np.asarray(reduce(image, 2).astype(np.float32) - _GREY)


def _smooth(image: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(cv2.blur(image, (3, 3)), np.float32)


def _to_shape(coarse: Grey, shape: tuple[int, ...]) -> Grey:
    """Return *coarse* cut, or filled up with grey, to *shape*: a frame may differ from its reference in size."""
    if coarse.shape == shape:
        return coarse
    placed = np.full(shape, _GREY, np.uint8)
    rows, columns = min(shape[0], coarse.shape[0]), min(shape[1], coarse.shape[1])
    placed[:rows, :columns] = coarse[:rows, :columns]
    return placed


def _correlation_peaks(here: NDArray[np.float32], there: NDArray[np.float32]) -> list[tuple[int, int]]:
    window = cv2.createHanningWindow((here.shape[1], here.shape[0]), cv2.CV_32F)
    cross = fft.rfft2(here * window) * np.conj(fft.rfft2(there * window))
    surface = fft.irfft2(cross / (np.abs(cross) + 1e-3), here.shape)
    return [(int(x), int(y)) for x, y in _strongest(surface)]


def _strongest(surface: NDArray[np.float32]) -> list[tuple[int, int]]:
    # Rotation and perspective smear the peak: gather it before looking for it.
    smooth = cv2.GaussianBlur(np.pad(surface, 4, mode="wrap"), (7, 7), 1.0)[4:-4, 4:-4].copy()
    found = []
    for _ in range(_PEAKS):
        _, _, _, (x, y) = cv2.minMaxLoc(smooth)
        found.append((x, y))
        top, left = max(0, y - _PEAK_RADIUS_PX), max(0, x - _PEAK_RADIUS_PX)
        smooth[top : y + _PEAK_RADIUS_PX + 1, left : x + _PEAK_RADIUS_PX + 1] = -1
    return found


def _unwrapped(peak: tuple[int, int], shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return the shifts that a peak of a circular correlation may stand for."""
    rows, columns = shape
    return [
        (x, y)
        for x in (peak[0], peak[0] - columns)
        for y in (peak[1], peak[1] - rows)
        if abs(x) < _LARGEST_SHIFT_SHARE * columns and abs(y) < _LARGEST_SHIFT_SHARE * rows
    ]


def _agreement(here: NDArray[np.float32], there: NDArray[np.float32], shift: tuple[int, int]) -> float:
    """Return the correlation of *here* with *there* moved by *shift*; small overlaps are doubted."""
    (x, y), (rows, columns) = shift, here.shape
    a = here[max(0, y) : rows + min(0, y), max(0, x) : columns + min(0, x)]
    b = there[max(0, -y) : rows + min(0, -y), max(0, -x) : columns + min(0, -x)]
    norm = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / norm * (a.size / here.size) ** 0.25 if norm > 0 else -1.0
