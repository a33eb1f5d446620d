"""What came back of the vehicles that were painted, and which paint they had."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from vtrack_batch.model.homography import Array

_DARK, _LIGHT, _CHROMA = 70.0, 150.0, 45.0


def came_back(painted_m: Array, others_m: Array, found_m: Array, gate_m: float) -> NDArray[np.int64]:
    """Return for each painted vehicle (k,) the row of the box that is its own, -1 for none.

    A box (f, 2) belongs to the nearest of the painted (k, 2) and the *others* that were there before; it must lie
    within *gate_m* of it. Of several boxes the nearest counts.
    """
    own = np.full(len(painted_m), -1, np.int64)
    if not len(painted_m) or not len(found_m):
        return own
    distance, owner = cKDTree(np.concatenate([painted_m, others_m])).query(found_m)
    rows = np.flatnonzero((owner < len(painted_m)) & (distance <= gate_m))
    rows = rows[np.argsort(-distance[rows], kind="stable")]
    own[owner[rows]] = rows
    return own


def paint_of(red: Array, green: Array, blue: Array) -> NDArray[np.str_]:
    """Return dark, grey, light or coloured (n,) for colours 0-255."""
    luminance = 0.299 * red + 0.587 * green + 0.114 * blue
    chroma = np.maximum(np.maximum(red, green), blue) - np.minimum(np.minimum(red, green), blue)
    plain = np.select([luminance < _DARK, luminance > _LIGHT], ["dark", "light"], "grey")
    return np.where(chroma > _CHROMA, "coloured", plain)
