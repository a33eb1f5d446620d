"""Who stands, and who surely moves: sightings in successive frames, compared without tracking anybody."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from vtrack_batch.model.homography import Array

_REACH_M = 0.7
_MISSES = 2
_SLOWEST_MPS, _FASTEST_MPS = 2.0, 60.0
_ALONG = float(np.cos(np.radians(20.0)))
_COLOUR = 30.0


def stays_of(places_m: Sequence[Array], times_s: Array, least_s: float) -> list[NDArray[np.int64]]:
    """Return for every sighting the number of the stay that it belongs to, -1 where it moves.

    *places_m* (n, 2) of each frame at *times_s*; sightings within 0.7 m over up to two misses are one stay, if it lasts
    *least_s*.
    """
    first = np.concatenate([[0], np.cumsum([len(places) for places in places_m])]).astype(np.int64)
    frame = np.repeat(np.arange(len(places_m)), np.diff(first))
    links = [np.zeros((0, 2), np.int64)]
    trees = [cKDTree(places) if len(places) else None for places in places_m]
    for k, tree in enumerate(trees):
        for later in range(k + 1, min(k + 2 + _MISSES, len(trees))):
            if tree is None or trees[later] is None:
                continue
            distance, nearest = tree.query(places_m[later], distance_upper_bound=_REACH_M)
            near = np.flatnonzero(np.isfinite(distance))
            links.append(np.stack([first[k] + nearest[near], first[later] + near], axis=1))
    pairs = np.concatenate(links)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(first[-1], first[-1]))
    label = connected_components(graph, directed=False)[1] if first[-1] else np.zeros(0, np.int64)
    count = int(label.max(initial=-1)) + 1
    begin, end = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(begin, label, times_s[frame])
    np.maximum.at(end, label, times_s[frame])
    long = end - begin >= least_s
    number = np.where(long, np.cumsum(long) - 1, -1)
    return [number[label[a:b]] for a, b in pairwise(first)]


def moving(boxes_m: Sequence[Array], colours: Sequence[Array], times_s: Array) -> list[NDArray[np.bool_]]:
    """Return for every sighting whether the frame before or after shows one of its colour farther on along its axis.

    *boxes_m* (n, 6) and *colours* (n, 3) of each frame at *times_s*.
    """
    found = [np.zeros(len(boxes), np.bool_) for boxes in boxes_m]
    for k in range(len(boxes_m) - 1):
        one, other = boxes_m[k], boxes_m[k + 1]
        way = other[None, :, :2] - one[:, None, :2]
        far = np.maximum(np.hypot(way[:, :, 0], way[:, :, 1]), 1e-9)
        speed = far / max(times_s[k + 1] - times_s[k], 1e-9)
        fits = (speed > _SLOWEST_MPS) & (speed < _FASTEST_MPS)
        for axes in (_unit(one)[:, None, :], _unit(other)[None, :, :]):
            fits &= np.abs((way * axes).sum(axis=2)) > _ALONG * far
        fits &= np.abs(colours[k][:, None, :] - colours[k + 1][None, :, :]).max(axis=2, initial=0) < _COLOUR
        found[k] |= fits.any(axis=1)
        found[k + 1] |= fits.any(axis=0)
    return found


def _unit(boxes: Array) -> Array:
    return boxes[:, 2:4] / np.maximum(np.hypot(boxes[:, 2], boxes[:, 3]), 1e-9)[:, None]
