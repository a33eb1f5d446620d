"""Robust refinement of a plane map by iteratively reweighted least squares."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.model import homography

_ROUNDS = 3
_STEPS = 2
_FEWEST_POINTS = 8
# Tukey's biweight is 95 % efficient with a reach of 4.685 sigma; the median of Rayleigh distances is 1.1774 sigma.
_REACH_OF_MEDIAN = 4.685 / 1.1774
_SMALLEST_MEDIAN_PX = 0.02


def polished(
    matrix: NDArray[np.float64],
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    *,
    freedoms: int,
    tolerance_px: float,
) -> NDArray[np.float64]:
    """Return *matrix* (3, 3) improved as a map from *source* to *target*, both (n, 2).

    Gauss-Newton steps on the squared distances in the target, with Tukey's biweight on the scale of the errors that
    are actually met among points closer than twice *tolerance_px*. 6 *freedoms* are affine, 8 a homography.
    """
    middle, span = source.mean(axis=0), max(1.0, float(np.ptp(source, axis=0).max()) / 2)
    inward = np.array([[span, 0, middle[0]], [0, span, middle[1]], [0, 0, 1]])
    local, h = np.ascontiguousarray((source - middle) / span), homography.normalised(matrix @ inward)
    target = np.ascontiguousarray(target)
    better = _polish(np.ascontiguousarray(h), local, target, freedoms, tolerance_px)
    return np.asarray(better @ np.linalg.inv(inward)) if np.isfinite(better).all() else matrix


@njit(cache=True, nogil=True)
def _polish(h, source, target, freedoms, tolerance_px):  # type: ignore[no-untyped-def]
    """Return the matrix after all rounds; all NaN where too few points are close."""
    found = h.copy()
    for _ in range(_ROUNDS):
        close = _lengths(found, source, target)
        close = np.sort(close[close <= 2 * tolerance_px])
        if len(close) < _FEWEST_POINTS:
            return np.full((3, 3), np.nan)
        median = (close[(len(close) - 1) // 2] + close[len(close) // 2]) / 2
        reach = _REACH_OF_MEDIAN * max(median, _SMALLEST_MEDIAN_PX)
        for _ in range(_STEPS):
            normal, right = np.zeros((freedoms, freedoms)), np.zeros(freedoms)
            _accumulate(found, source, target, reach, normal, right)
            for i in range(freedoms):
                # A trace of damping keeps points on one line from making the step boundless.
                normal[i, i] += 1e-9 * (1 + normal[i, i])
            step = np.linalg.solve(normal, right)
            for i in range(freedoms):
                found[i // 3, i % 3] += step[i]
    return found


@njit(cache=True, nogil=True)
def _lengths(h, source, target):  # type: ignore[no-untyped-def]
    """Return how far (n,) the images of *source* lie from *target*."""
    lengths = np.empty(len(source))
    for k in range(len(source)):
        x, y = source[k, 0], source[k, 1]
        depth = h[2, 0] * x + h[2, 1] * y + h[2, 2]
        across = target[k, 0] - (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / depth
        down = target[k, 1] - (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / depth
        lengths[k] = np.sqrt(across * across + down * down)
    return lengths


@njit(cache=True, nogil=True)
def _accumulate(h, source, target, reach, normal, right):  # type: ignore[no-untyped-def]
    """Add the weighted normal equations of one Gauss-Newton step to *normal* (f, f) and *right* (f,)."""
    freedoms = len(right)
    slope = np.zeros((2, 8))
    for k in range(len(source)):
        x, y = source[k, 0], source[k, 1]
        depth = h[2, 0] * x + h[2, 1] * y + h[2, 2]
        at_x = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / depth
        at_y = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / depth
        error_x, error_y = target[k, 0] - at_x, target[k, 1] - at_y
        closeness = 1 - (error_x * error_x + error_y * error_y) / (reach * reach)
        if not closeness > 0:
            continue
        weight = closeness * closeness
        slope[0, 0], slope[0, 1], slope[0, 2] = x / depth, y / depth, 1 / depth
        slope[1, 3], slope[1, 4], slope[1, 5] = x / depth, y / depth, 1 / depth
        slope[0, 6], slope[0, 7] = -at_x * x / depth, -at_x * y / depth
        slope[1, 6], slope[1, 7] = -at_y * x / depth, -at_y * y / depth
        for i in range(freedoms):
            right[i] += weight * (slope[0, i] * error_x + slope[1, i] * error_y)
            for j in range(freedoms):
                normal[i, j] += weight * (slope[0, i] * slope[0, j] + slope[1, i] * slope[1, j])
