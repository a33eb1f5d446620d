"""Region matching: the most similar region by place, grey and velocity, with weights that the matches themselves set.

Source: J. Badenas, J. M. Sanchiz and F. Pla, "Using Temporal Integration for Tracking Regions in Traffic Monitoring
Sequences" (ICPR 2000), section 2. The printed weights (3), (4) cannot be right; from the Lagrange condition, with S_f
the sum of squared differences of feature f over the matched regions and the product of all weights held at 1,

    w_f = (Π S)^(1/F) / S_f.

So every feature brings the same share to the sum of distances. Because a feature without any difference would take
over (S_f = 0), S_f is never less than measuring noise makes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.matching.candidates import Array, Edges, Index
from vtrack_batch.matching.params import RegionParams
from vtrack_batch.matching.relaxation import Labels
from vtrack_batch.matching.vehicles import Vehicles


@dataclass(frozen=True)
class Features:
    """Features of regions: ``values`` (n, 5) x, y, grey, vx, vy in m, 0-255, m/s, NaN = not measured.

    ``variance`` (5,) is what is first expected of a feature's squared difference, ``floor`` (5,) the least it can be.
    """

    values: Array
    variance: Array
    floor: Array


def features_of(xy: Array, rgb: Array | None, velocity: Array | None) -> Array:
    """Return place, grey and velocity side by side, (n, 5); NaN where nothing is known."""
    grey = np.full(len(xy), np.nan) if rgb is None else rgb.mean(axis=1)
    motion = np.full((len(xy), 2), np.nan) if velocity is None else velocity
    return np.column_stack([xy, grey, motion])


def expected(position_m: float, speed_mps: float, params: RegionParams) -> tuple[Array, Array]:
    """Return first variances and floors (5,) of squared differences, for these spreads of place and velocity."""
    floor = np.array([params.position_floor_m] * 2 + [params.grey_floor] + [params.speed_floor_mps] * 2) ** 2
    first = np.array([position_m] * 2 + [params.grey_sigma] + [speed_mps] * 2) ** 2
    return np.maximum(first, floor), floor


def pair_labels(edges: Edges, a: Vehicles, b: Vehicles, elapsed_s: float, params: RegionParams) -> Labels:
    """Return labels of two images: regions of the earlier one move on by their measured velocity, if there is one."""
    moved = a.xy if a.velocity is None else a.xy + np.nan_to_num(a.velocity) * elapsed_s
    variance, floor = expected(params.start_speed_mps * elapsed_s, params.start_speed_mps, params)
    predicted = Features(features_of(moved, a.rgb, a.velocity), variance, floor)
    return region_labels(edges, predicted, features_of(b.xy, b.rgb, b.velocity), params)


def region_labels(edges: Edges, predicted: Features, seen: Array, params: RegionParams) -> Labels:
    """Return label probabilities of the edges between *predicted* regions (n, 5) and those *seen* (m, 5).

    The paper takes the nearest; exp(-d / 2) of the weighted distance puts labels in the same order. No match stands
    where a region lies at the cut-off.
    """
    known, square = _squared(predicted.values[edges.i], seen[edges.k])
    distance = _distances(square[:, known], edges.i, predicted.variance[known], predicted.floor[known], params.rounds)
    near = np.exp(-0.5 * np.minimum(distance, 1400.0))
    none = np.exp(-0.5 * params.cutoff_sigmas**2 * max(known.sum(), 1))
    sum_i = none + np.bincount(edges.i, weights=near, minlength=edges.n)
    sum_k = none + np.bincount(edges.k, weights=near, minlength=edges.m)
    return Labels(near / sum_i[edges.i], near / sum_k[edges.k], none / sum_i, none / sum_k)


def lagrange_weights(spread: Array) -> Array:
    """Return the weights (f,), of product 1, that make the sum of weighted *spread* (f,) least."""
    return np.asarray(np.exp(np.log(spread).mean()) / spread)


def _squared(predicted: Array, seen: Array) -> tuple[NDArray[np.bool_], Array]:
    """Return which features are known at all (5,), and squared differences (e, 5); the mean stands for the unknown."""
    square = (seen - predicted) ** 2
    measured = np.asarray(np.isfinite(square))
    known = np.asarray(measured.any(axis=0)) if len(square) else np.array([True, True, False, False, False])
    count = np.maximum(measured.sum(axis=0), 1)
    mean = np.where(measured, square, 0.0).sum(axis=0) / count
    return known, np.where(measured, square, mean)


def _distances(square: Array, owner: Index, variance: Array, floor: Array, rounds: int) -> Array:
    """Match, weigh, and match again until the matches stay; returns distances (e,) in variances."""
    picked = np.zeros(0, np.int64)
    distance = square @ (1 / variance)
    for _ in range(rounds):
        nearest = _nearest(distance, owner)
        if np.array_equal(nearest, picked) or not len(nearest):
            break
        picked = nearest
        spread = np.maximum(square[picked].mean(axis=0), floor)
        # of the same order as by the weights of product 1; divided by the geometric mean they are 1 / variance
        distance = square @ (lagrange_weights(spread) / np.exp(np.log(spread).mean()))
    return np.asarray(distance)


def _nearest(distance: Array, owner: Index) -> Index:
    """Return each owner's edge of least distance, of equal ones the first."""
    order = np.lexsort((distance, owner))
    return np.asarray(order[np.flatnonzero(np.r_[True, np.diff(owner[order]) != 0])] if len(order) else order)
