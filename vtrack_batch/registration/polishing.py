"""Robust refinement of a plane map by iteratively reweighted least squares."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.model import homography

_STEPS = 5
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
    refined = _refine(h, local, target, freedoms, 2 * tolerance_px)
    return np.asarray(refined @ np.linalg.inv(inward)) if np.isfinite(refined).all() else matrix


@njit(cache=True, nogil=True)
def _refine(h, source, target, freedoms, furthest):  # type: ignore[no-untyped-def]
    h = h.copy()
    length = np.empty(len(source))
    for _ in range(_STEPS):
        for k in range(len(source)):
            error_x, error_y, _ = _error(h, source[k], target[k])
            length[k] = np.sqrt(error_x * error_x + error_y * error_y)
        close = length[length <= furthest]
        if len(close) < _FEWEST_POINTS:
            return h
        reach = _REACH_OF_MEDIAN * max(np.median(close), _SMALLEST_MEDIAN_PX)
        normal, right = np.zeros((freedoms, freedoms)), np.zeros(freedoms)
        _accumulate(h, source, target, reach, normal, right)
        # A trace of damping keeps points on one line from making the step boundless.
        for i in range(freedoms):
            normal[i, i] += 1e-9 * (1 + normal[i, i])
        h.ravel()[:freedoms] += np.linalg.solve(normal, right)
    return h


@njit(cache=True, nogil=True)
def _error(h, source, target):  # type: ignore[no-untyped-def]
    """Return how far right and down of the image of *source* the *target* lies, and the projective depth."""
    x, y = source
    depth = h[2, 0] * x + h[2, 1] * y + h[2, 2]
    at_x = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / depth
    at_y = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / depth
    return target[0] - at_x, target[1] - at_y, depth


@njit(cache=True, nogil=True)
def _accumulate(h, source, target, reach, normal, right):  # type: ignore[no-untyped-def]
    """Add the weighted normal equations of one Gauss-Newton step to *normal* (f, f) and *right* (f,)."""
    freedoms = len(right)
    slope = np.zeros((2, 8))
    for k in range(len(source)):
        x, y = source[k]
        error_x, error_y, depth = _error(h, source[k], target[k])
        at_x, at_y = target[k, 0] - error_x, target[k, 1] - error_y
        weight = max(0.0, 1 - (error_x * error_x + error_y * error_y) / (reach * reach)) ** 2
        if weight == 0.0:
            continue
        slope[0, 0], slope[0, 1], slope[0, 2] = x / depth, y / depth, 1 / depth
        slope[1, 3], slope[1, 4], slope[1, 5] = x / depth, y / depth, 1 / depth
        slope[0, 6], slope[0, 7] = -at_x * x / depth, -at_x * y / depth
        slope[1, 6], slope[1, 7] = -at_y * x / depth, -at_y * y / depth
        for i in range(freedoms):
            right[i] += weight * (slope[0, i] * error_x + slope[1, i] * error_y)
            for j in range(freedoms):
                normal[i, j] += weight * (slope[0, i] * slope[0, j] + slope[1, i] * slope[1, j])
