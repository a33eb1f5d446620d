"""The stage: how scene, ground, reference frame and each frame lie to one another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vtrack_batch.model.homography import Array, apply, jacobian
from vtrack_batch.simulation.params import Scenario


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

    def scene_to_frame(self, pose: Array) -> Array:
        """Return the homography from scene metres to the pixels of the frame with *pose* (reference to frame)."""
        return np.asarray(pose @ self.ground_to_reference @ self.scene_to_ground)


def local_stage(scenario: Scenario) -> Stage:
    """Return the stage of frames without a CRS: x right, y up, origin at the first frame's top-left corner."""
    gsd = scenario.gsd_m
    to_ground = np.array([[gsd, 0, gsd / 2], [0, -gsd, -gsd / 2], [0, 0, 1]])
    return _with_scene(scenario, (scenario.width_px, scenario.height_px), to_ground, None)


def mapped_stage(scenario: Scenario, *, size_px: tuple[int, int], reference_to_ground: Array, crs: str) -> Stage:
    """Return the stage of frames of *size_px* (width, height) cut out of an orthophoto in a projected *crs*."""
    return _with_scene(scenario, size_px, reference_to_ground, crs)


def _with_scene(scenario: Scenario, size_px: tuple[int, int], to_ground: Array, crs: str | None) -> Stage:
    """Put the middle of the scene into the middle of the frame, or the street onto its two ends."""
    width, height = size_px
    middle = np.array([[(width - 1) / 2, (height - 1) / 2]])
    angle = -np.deg2rad(scenario.azimuth_deg)
    if scenario.scene == "street" and scenario.street_px is not None:
        ends = np.array(scenario.street_px, float)
        middle = ends.mean(axis=0, keepdims=True)
        along = (apply(to_ground, ends[1:]) - apply(to_ground, ends[:1]))[0]
        angle = float(np.arctan2(along[1], along[0]))
    centre = apply(to_ground, middle)[0]
    c, s = np.cos(angle), np.sin(angle)
    scene = np.array([[c, -s, centre[0]], [s, c, centre[1]], [0, 0, 1]])
    return Stage(width, height, to_ground, scene, crs)


def directions(h: Array, at: Array, vectors: Array) -> Array:
    """Carry the direction *vectors* (n, 2) at the points *at* (n, 2) through the homography *h*; returns (n, 2)."""
    return np.asarray(np.einsum("nij,nj->ni", jacobian(h, at), vectors))


def compass_deg(vectors: Array) -> Array:
    """Return the direction of ground *vectors* (n, 2), degrees clockwise from north, 0 to 360."""
    return np.asarray(np.mod(np.rad2deg(np.arctan2(vectors[:, 0], vectors[:, 1])), 360.0))
