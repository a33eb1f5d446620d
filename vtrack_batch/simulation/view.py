"""What a picture needs to know of its scenario: camera, ground, light, seed and times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation.view_params import CameraParams, GroundParams, LightParams

GROUND_SEED, FLIGHT_SEED, CLOUD_SEED, SWAY_SEED, PEOPLE_SEED = 77_001, 77_002, 77_003, 77_004, 77_005


@dataclass(frozen=True)
class View:
    """The part of a scenario that pictures are made from."""

    camera: CameraParams
    ground: GroundParams
    light: LightParams
    seed: int
    interval_s: float
    frame_count: int

    def rng(self, *stream: int) -> np.random.Generator:
        """Return the generator of one of the seeds above; the same stream gives the same numbers."""
        return np.random.default_rng([self.seed, *stream])

    @property
    def t_s(self) -> Array:
        """Times (frames,) since the first frame."""
        return np.arange(self.frame_count, dtype=np.float64) * self.interval_s
