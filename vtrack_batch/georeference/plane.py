"""Least-squares fits of plane maps to few, good points: control points and grids of transformed corners."""

from __future__ import annotations

from itertools import combinations, islice
from math import comb

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model import homography

Array = NDArray[np.float64]

_MOST_SAMPLES = 2000


def fit_affine(source: Array, target: Array) -> Array:
    """Return the affine map (3, 3) from *source* to *target*, both (n >= 3, 2), with the least squared distances."""
    inward, outward = _normaliser(source), _normaliser(target)
    design = np.column_stack([homography.apply(inward, source), np.ones(len(source))])
    solution = np.linalg.lstsq(design, homography.apply(outward, target), rcond=None)[0]
    return np.asarray(np.linalg.inv(outward) @ np.vstack([solution.T, [0, 0, 1]]) @ inward)


def fit_homography(source: Array, target: Array) -> Array:
    """Return the homography (3, 3) from *source* to *target*, both (n >= 4, 2), with the least squared distances.

    Direct linear transformation on normalised points (Hartley & Zisserman 2004, algorithm 4.2), then Gauss-Newton.
    """
    inward, outward = _normaliser(source), _normaliser(target)
    a, b = homography.apply(inward, source), homography.apply(outward, target)
    ones, zero = np.ones((len(a), 1)), np.zeros((len(a), 3))
    ray = np.hstack([a, ones])
    design = np.vstack([np.hstack([ray, zero, -b[:, :1] * ray]), np.hstack([zero, ray, -b[:, 1:] * ray])])
    h = np.linalg.svd(design)[2][-1].reshape(3, 3)
    if abs(h[2, 2]) < 1e-9:
        return fit_affine(source, target)
    h = homography.normalised(h)
    for _ in range(5):
        depth = (ray @ h[2])[:, None]
        mapped = homography.apply(h, a)
        slope = np.vstack([np.hstack([ray, zero, -mapped[:, :1] * a]), np.hstack([zero, ray, -mapped[:, 1:] * a])])
        slope /= np.vstack([depth, depth])
        step = np.linalg.lstsq(slope, (b - mapped).T.ravel(), rcond=None)[0]
        h = h + np.append(step, 0.0).reshape(3, 3)
    return homography.normalised(np.linalg.inv(outward) @ h @ inward)


def distances(h: Array, source: Array, target: Array) -> Array:
    """Return how far (n,) the images of *source* under *h* lie from *target*."""
    return np.asarray(np.linalg.norm(homography.apply(h, source) - target, axis=1))


def rms(lengths: Array) -> float:
    """Return the root mean square of *lengths*."""
    return float(np.sqrt(np.mean(np.square(lengths))))


def agreeing(source: Array, target: Array, tolerance: float) -> NDArray[np.bool_]:
    """Return which (n,) of at least 6 point pairs agree on an affine map; blunders do not.

    Least median of squares (Rousseeuw 1984) over triples of points: all of them where they are few, else an even
    selection, so that nothing is left to chance. Residuals below *tolerance* always agree.
    """
    count = len(source)
    best, smallest = fit_affine(source, target), np.inf
    stride = max(1, comb(count, 3) // _MOST_SAMPLES)
    for triple in islice(combinations(range(count), 3), 0, None, stride):
        chosen = list(triple)
        legs = source[chosen[1:]] - source[chosen[0]]
        if abs(np.linalg.det(legs)) < 1e-3 * float(np.prod(np.linalg.norm(legs, axis=1))) + 1e-12:
            continue
        candidate = fit_affine(source[chosen], target[chosen])
        median = float(np.median(distances(candidate, source, target)))
        if median < smallest:
            best, smallest = candidate, median
    sigma = 1.4826 * (1 + 5 / (count - 3)) * smallest
    return np.asarray(distances(best, source, target) <= max(2.5 * sigma, tolerance))


def _normaliser(points: Array) -> Array:
    """Return the map that moves *points* around zero and to unit size: sums of squares then keep all their digits."""
    middle = points.mean(axis=0)
    size = float(np.abs(points - middle).max()) or 1.0
    return np.array([[1 / size, 0, -middle[0] / size], [0, 1 / size, -middle[1] / size], [0, 0, 1]])
