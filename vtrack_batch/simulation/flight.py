"""The platform: how each frame lies to the first one, from where it is taken, how light and exposure wander."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vtrack_batch.model.homography import Array, normalised
from vtrack_batch.simulation.view import FLIGHT_SEED, View

_PERIODS_S = (47.0, 83.0, 151.0)
"""Periods of the slow wander of drift, turn, travel and exposure."""


@dataclass(frozen=True)
class Flight:
    """Per frame: ``poses`` (n, 3, 3) reference to frame, ``exposure`` (n,) gain, ``cloud_m`` (n, 2) drift of shade.

    ``nadir_m`` (n, 2) is where the platform stands above the ground, from the middle of the view.
    """

    poses: Array
    exposure: Array
    cloud_m: Array
    nadir_m: Array


def fly(view: View, *, size_px: tuple[int, int], rigid: bool) -> Flight:
    """Draw the flight; *rigid* allows translations only, so that a frame's geotransform can say them exactly."""
    camera, t, rng = view.camera, view.t_s, view.rng(FLIGHT_SEED)
    turn = np.zeros(len(t)) if rigid else np.deg2rad(camera.rotation_deg) * _wander(t, rng)
    drift = camera.drift_px * np.stack([_wander(t, rng), _wander(t, rng)], axis=1)
    shift = drift + camera.jitter_px * rng.standard_normal((len(t), 2))
    tilt = 0.0 if rigid else camera.perspective_per_px
    perspective = tilt * np.stack([_wander(t, rng), _wander(t, rng)], axis=1)
    scale = 1.0 + (0.0 if rigid else camera.scale_drift) * _wander(t, rng)
    width, height = size_px
    centre = np.array([[1, 0, (width - 1) / 2], [0, 1, (height - 1) / 2], [0, 0, 1.0]])
    poses = []
    for k in range(len(t)):
        c, s = scale[k] * np.cos(turn[k]), scale[k] * np.sin(turn[k])
        about = np.array([[c, -s, shift[k, 0]], [s, c, shift[k, 1]], [*perspective[k], 1.0]])
        poses.append(centre @ about @ np.linalg.inv(centre))
    first = np.linalg.inv(poses[0])
    relative = np.stack([normalised(pose @ first) for pose in poses])
    relative[0] = np.eye(3)
    drifts = view.light.exposure_drift
    exposure = 1.0 + drifts * _wander(t, rng) + 0.004 * rng.standard_normal(len(t))
    wind = rng.uniform(2, 5) * np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a)])
    nadir = camera.travel_m * np.stack([_wander(t, rng), _wander(t, rng)], axis=1)
    return Flight(relative, exposure if drifts else np.ones(len(t)), t[:, None] * wind, nadir)


def _wander(t: Array, rng: np.random.Generator) -> Array:
    """Return a smooth curve over the times *t* (n,), mostly within -1 to 1."""
    phase = rng.uniform(0, 2 * np.pi, len(_PERIODS_S))
    weight = rng.uniform(0.3, 1.0, len(_PERIODS_S))
    waves = np.sin(2 * np.pi * t[:, None] / np.array(_PERIODS_S) + phase)
    return np.asarray((waves * weight).sum(axis=1) / weight.sum())
