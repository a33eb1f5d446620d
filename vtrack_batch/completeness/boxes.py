"""Oriented boxes as rows (column, row, half axis along (x, y), half axis across (x, y)), in any one plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.detection.candidates import Candidates
from vtrack_batch.model import homography
from vtrack_batch.model.homography import Array


def boxes_of(found: Candidates) -> Array:
    """Return the boxes (n, 6) of *found*, in the frame's pixels."""
    return np.stack([found.col_px, found.row_px, found.lx_px, found.ly_px, found.wx_px, found.wy_px], axis=1)


def mapped(boxes: Array, h: Array) -> Array:
    """Return *boxes* (n, 6) as the homography *h* shows them."""
    local = homography.jacobian(h, boxes[:, :2])
    along, across = (np.einsum("nij,nj->ni", local, boxes[:, at : at + 2]) for at in (2, 4))
    return np.concatenate([homography.apply(h, boxes[:, :2]), along, across], axis=1)


def grown(boxes: Array, by: float) -> Array:
    """Return *boxes* with every half axis longer *by* so much."""
    out = boxes.copy()
    for at in (2, 4):
        length = np.maximum(np.hypot(out[:, at], out[:, at + 1]), 1e-9)
        out[:, at : at + 2] *= (1 + by / length)[:, None]
    return out


def overlaps(one: Array, other: Array) -> NDArray[np.bool_]:
    """Return (n, m) which boxes overlap, by the separating axes of both."""
    apart = other[None, :, :2] - one[:, None, :2]
    separate = np.zeros(apart.shape[:2], np.bool_)
    for boxes, first in ((one, True), (other, False)):
        for at in (2, 4):
            axis = boxes[:, at : at + 2] / np.maximum(np.hypot(boxes[:, at], boxes[:, at + 1]), 1e-9)[:, None]
            axis = axis[:, None, :] if first else axis[None, :, :]
            reach = sum(
                np.abs((side[:, a : a + 2].reshape(shape) * axis).sum(axis=2))
                for side, shape in ((one, (len(one), 1, 2)), (other, (1, len(other), 2)))
                for a in (2, 4)
            )
            separate |= np.abs((apart * axis).sum(axis=2)) > reach
    return ~separate


def corners_of(boxes: Array) -> Array:
    """Return the corners (n, 4, 2) of *boxes*, around each."""
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    return np.asarray(
        boxes[:, None, :2] + signs[None, :, :1] * boxes[:, None, 2:4] + signs[None, :, 1:] * boxes[:, None, 4:6]
    )
