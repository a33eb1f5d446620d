"""What a platform saw and when: the clock and the ground footprint of every accepted frame of a sequence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Views:
    """The frames of one sequence in order of time, detections or not.

    ``t_utc`` (n,) datetime64[us], increasing; ``corners_m`` (n, 4, 2) float64, the footprint of each frame in ground
    metres, corner by corner around it; ``position_sigma_m`` (n,) float64, the registration residual in metres.
    """

    sequence: str
    t_utc: NDArray[np.datetime64]
    corners_m: NDArray[np.float64]
    position_sigma_m: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.t_utc)
