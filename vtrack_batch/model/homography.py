"""Plane projective maps as (3, 3) float64 matrices, and how points, directions and areas go through them.

Names say the spaces: ``frame_to_reference`` takes (col_px, row_px) of a frame to (col_px, row_px) of the block's
reference frame; ``reference_to_ground`` takes those to (x_m, y_m). (0, 0) is the centre of the top-left pixel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def apply(h: Array, xy: Array) -> Array:
    """Map points (n, 2) by the homography *h* (3, 3); returns (n, 2) float64."""
    xy = np.asarray(xy, float).reshape(-1, 2)
    w = xy @ h[2, :2] + h[2, 2]
    return np.asarray((xy @ h[:2, :2].T + h[:2, 2]) / w[:, None])


def jacobian(h: Array, xy: Array) -> Array:
    """Return the local linear part (n, 2, 2) of *h* at the points (n, 2): d(mapped)/d(xy)."""
    xy = np.asarray(xy, float).reshape(-1, 2)
    w = xy @ h[2, :2] + h[2, 2]
    mapped = (xy @ h[:2, :2].T + h[:2, 2]) / w[:, None]
    return np.asarray((h[None, :2, :2] - mapped[:, :, None] * h[None, 2:, :2]) / w[:, None, None])


def corners(width_px: int, height_px: int) -> Array:
    """Return the outer corners (4, 2) of a frame in pixel coordinates, clockwise on the screen from the top left."""
    right, bottom = width_px - 0.5, height_px - 0.5
    return np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])


def normalised(h: Array) -> Array:
    """Scale *h* so that its last element is 1, the form in which tables keep it."""
    return np.asarray(h / h[2, 2])
