"""What a detector makes of vehicles whose truth is known: places and paints with noise, misses, false alarms.

The usual noise is that of the pinned data's own notes (../shared/data/sumo/README.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

COLOURS = ["red", "green", "blue"]
FALSE_WITHIN_M = 25.0


@dataclass(frozen=True)
class Noise:
    """Spread of one sighting: place per axis, colour as gain, common and per channel; share in shadow; share missed.

    ``false_share`` false alarms for each sighting, some way off, with paints of their own.
    """

    position_m: float = 0.33
    gain: float = 0.04
    common: float = 3.0
    channel: float = 3.0
    shadow_share: float = 0.02
    missed: float = 0.0
    false_share: float = 0.0


def seen(truth: pd.DataFrame, noise: Noise, rng: np.random.Generator) -> pd.DataFrame:
    """Return what a detector would see of *truth*, rows shuffled; ``vehicle`` is -1 for a false alarm."""
    rows = truth[rng.random(len(truth)) >= noise.missed]
    false = rows[rng.random(len(rows)) < noise.false_share].assign(vehicle=-1)
    false[["x_m", "y_m"]] += rng.normal(0, FALSE_WITHIN_M, (len(false), 2))
    false[COLOURS] = rng.uniform(30, 220, (len(false), 3))
    rows = pd.concat([rows, false], ignore_index=True)
    rows = rows.sample(frac=1, random_state=int(rng.integers(2**31)), ignore_index=True)
    rows[COLOURS] = recoloured(rows[COLOURS].to_numpy(float), noise, rng)
    rows[["x_m", "y_m"]] += rng.normal(0, noise.position_m, (len(rows), 2))
    return rows


def recoloured(rgb: np.ndarray, noise: Noise, rng: np.random.Generator) -> np.ndarray:
    """Return colours (n, 3) as one sighting gives them, in whole levels 0-255."""
    n = len(rgb)
    gain = 1 + rng.normal(0, noise.gain, (n, 1))
    gain *= np.where(rng.random((n, 1)) < noise.shadow_share, 0.65, 1.0)
    level = rgb * gain + (rng.normal(0, noise.common, (n, 1)) + rng.normal(0, noise.channel, (n, 3)))
    return np.clip(np.round(level), 0, 255)
