"""Are the speeds right, and is their stated error true? Over sightings of moving vehicles, in km/h."""

from __future__ import annotations

from typing import Any

import numpy as np

from vtrack_batch.evaluation.blocks import Blocks, divide
from vtrack_batch.evaluation.pairing import Paired
from vtrack_batch.evaluation.params import EvaluationParams

_KMH = 3.6


def speed_scores(paired: Paired, blocks: Blocks, params: EvaluationParams) -> dict[str, Any] | None:
    """Return bias and RMS of the speed error per moving track point, and the share within 1.96 stated sigma.

    A point counts when its detection lies on a vehicle whose true speed at that frame is above ``moving_mps``. None
    where the truth has no speeds.
    """
    speed = paired.true["speed_mps"].to_numpy(float)
    if not np.isfinite(speed).any():
        return None
    found = paired.found[(paired.found["row"] >= 0) & paired.found["speed_mps"].notna()]
    true = speed[found["row"].to_numpy(int)]
    moving = true > params.moving_mps
    frame = found["frame"].to_numpy(int)[moving]
    sigma = found["speed_sigma_mps"].to_numpy(float, na_value=np.nan)[moving]
    error = found["speed_mps"].to_numpy(float)[moving] - true[moving]
    count, stated = blocks.totals(frame), np.isfinite(sigma)
    square = blocks.totals(frame, (_KMH * error) ** 2)
    covered = np.abs(error[stated]) <= 1.96 * sigma[stated]
    return {
        "points": int(moving.sum()),
        "bias_kmh": blocks.ratio(blocks.totals(frame, _KMH * error), count),
        "rms_kmh": blocks.score(np.sqrt(divide(square, count))),
        "absolute_median_kmh": blocks.quantile(frame, _KMH * np.abs(error)),
        "within_stated_95": blocks.ratio(blocks.totals(frame[stated], covered), blocks.totals(frame[stated])),
    }
