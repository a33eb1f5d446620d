"""The stage: how scene, ground, reference frame and each frame lie to one another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vtrack_batch.model.homography import Array, apply, jacobian
from vtrack_batch.simulation.view_params import CameraParams, PointPx


@dataclass(frozen=True)
class Stage:
    """Fixed geometry of an archive; all matrices are (3, 3).

    ``reference_to_ground`` takes (col_px, row_px) of the first frame to ground metres, ``scene_to_ground`` takes the
    road network's metres there; ``crs`` is null for local metres.
    """

    width_px: int
    height_px: int
    reference_to_ground: Array
    scene_to_ground: Array
    crs: str | None

    @property
    def ground_to_reference(self) -> Array:
        """Inverse of ``reference_to_ground``."""
        return np.asarray(np.linalg.inv(self.reference_to_ground))

    @property
    def gsd_m(self) -> float:
        """Ground sampling distance along the rows."""
        return float(np.hypot(self.reference_to_ground[0, 0], self.reference_to_ground[1, 0]))

    @property
    def centre_m(self) -> Array:
        """Ground point (2,) in the middle of the reference frame."""
        middle = np.array([[(self.width_px - 1) / 2, (self.height_px - 1) / 2]])
        return apply(self.reference_to_ground, middle)[0]

    def scene_to_frame(self, pose: Array) -> Array:
        """Return the homography from scene metres to the pixels of the frame with *pose* (reference to frame)."""
        return np.asarray(pose @ self.ground_to_reference @ self.scene_to_ground)


def local_stage(camera: CameraParams, *, middle_m: PointPx = (0.0, 0.0)) -> Stage:
    """Return the stage of frames without a CRS: x right, y up, origin at the first frame's top-left corner.

    The scene's point *middle_m* lies in the middle of the frame, its x axis turned by the camera's azimuth.
    """
    gsd = camera.gsd_m
    to_ground = np.array([[gsd, 0, gsd / 2], [0, -gsd, -gsd / 2], [0, 0, 1]])
    size = (camera.width_px, camera.height_px)
    return Stage(*size, to_ground, _scene(camera, size, to_ground, middle_m, None), None)


def mapped_stage(
    camera: CameraParams,
    *,
    size_px: tuple[int, int],
    reference_to_ground: Array,
    crs: str | None,
    middle_m: PointPx = (0.0, 0.0),
    axis_px: tuple[PointPx, PointPx] | None = None,
) -> Stage:
    """Return the stage of frames of *size_px* (width, height) that lie on a given ground.

    The scene's x axis is laid from the first of the pixels *axis_px* to the second, its *middle_m* half-way; without
    them it lies as on a :func:`local_stage`.
    """
    scene = _scene(camera, size_px, reference_to_ground, middle_m, axis_px)
    return Stage(*size_px, reference_to_ground, scene, crs)


def _scene(
    camera: CameraParams,
    size_px: tuple[int, int],
    to_ground: Array,
    middle_m: PointPx,
    axis_px: tuple[PointPx, PointPx] | None,
) -> Array:
    width, height = size_px
    middle = np.array([[(width - 1) / 2, (height - 1) / 2]])
    angle = -np.deg2rad(camera.azimuth_deg)
    if axis_px is not None:
        ends = np.array(axis_px, float)
        middle = ends.mean(axis=0, keepdims=True)
        along = (apply(to_ground, ends[1:]) - apply(to_ground, ends[:1]))[0]
        angle = float(np.arctan2(along[1], along[0]))
    centre = apply(to_ground, middle)[0]
    c, s = np.cos(angle), np.sin(angle)
    turned = np.array([[c, -s], [s, c]])
    scene = np.eye(3)
    scene[:2, :2], scene[:2, 2] = turned, centre - turned @ np.asarray(middle_m, float)
    return scene


def directions(h: Array, at: Array, vectors: Array) -> Array:
    """Carry the direction *vectors* (n, 2) at the points *at* (n, 2) through the homography *h*; returns (n, 2)."""
    return np.asarray(np.einsum("nij,nj->ni", jacobian(h, at), vectors))


def compass_deg(vectors: Array) -> Array:
    """Return the direction of ground *vectors* (n, 2), degrees clockwise from north, 0 to 360."""
    return np.asarray(np.mod(np.rad2deg(np.arctan2(vectors[:, 0], vectors[:, 1])), 360.0))
