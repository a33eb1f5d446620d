"""Are the speeds right, and is their stated error true? Over sightings of moving vehicles, in km/h."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import norm

from vtrack_batch.evaluation.blocks import Blocks, divide
from vtrack_batch.evaluation.pairing import Paired
from vtrack_batch.evaluation.params import EvaluationParams

_KMH = 3.6
_NOMINAL = (50, 80, 95)


def speed_scores(paired: Paired, blocks: Blocks, params: EvaluationParams) -> dict[str, Any] | None:
    """Return bias and RMS of the speed error per moving track point, and how true the stated sigma is.

    A point counts when its detection lies on a vehicle whose true speed at that frame is above ``moving_mps``. Of a
    true sigma, residuals over sigma have mean square 1, and 50, 80 and 95 % of them lie within the normal law's
    0.67, 1.28 and 1.96. None where the truth has no speeds.
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
    count, stated = blocks.totals(frame), np.isfinite(sigma) & (sigma > 0)
    square = blocks.totals(frame, (_KMH * error) ** 2)
    residual = error[stated] / sigma[stated]
    stated_frame, stated_count = frame[stated], blocks.totals(frame[stated])
    within = {
        f"within_stated_{share}": blocks.ratio(
            blocks.totals(stated_frame, np.abs(residual) <= norm.ppf(0.5 + share / 200)), stated_count
        )
        for share in _NOMINAL
    }
    return {
        "points": int(moving.sum()),
        "bias_kmh": blocks.ratio(blocks.totals(frame, _KMH * error), count),
        "rms_kmh": blocks.score(np.sqrt(divide(square, count))),
        "absolute_median_kmh": blocks.quantile(frame, _KMH * np.abs(error)),
        "points_with_sigma": int(stated.sum()),
        "residual_mean_square": blocks.ratio(blocks.totals(stated_frame, residual**2), stated_count),
        **within,
    }
