"""What cast shadows of moving things look like here: how dark, and on which side of the thing they lie.

Source: a cast shadow scales all channels alike (Horprasert et al. 1999), so the ratios of darkened pixels pile up at
one value where the sun shines and nowhere in particular where it does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.background.subtract import OBJECT, SHADOW, Difference

_BIN = 0.02
_PEAK_HALF_WIDTH = 0.06
_PEAK_SHARE = 0.42
_DARKER, _BRIGHTER = 0.11, 0.14
_REACH_PX = 12
_LEAST_DIRECTION = 0.15
_FEWEST_PIXELS = 300


@dataclass(frozen=True)
class Shadows:
    """``ratio`` = level in shadow / level in light; ``direction`` = unit vector in reference px, thing to shadow."""

    ratio: float | None = None
    direction: tuple[float, float] | None = None

    @property
    def band(self) -> tuple[float, float]:
        """Lowest and highest ratio of a pixel in cast shadow; (0, 0) where none are cast."""
        return (self.ratio - _DARKER, self.ratio + _BRIGHTER) if self.ratio is not None else (0.0, 0.0)


def learn_ratio(ratios: NDArray[np.float64]) -> float | None:
    """Return the ratio at which darkened pixels pile up, from *ratios* (n,) of mean levels; None without a peak."""
    if len(ratios) < _FEWEST_PIXELS:
        return None
    low, high = float(ratios.min()), float(ratios.max())
    counts, edges = np.histogram(ratios, np.arange(low, high + _BIN, _BIN))
    if len(counts) < 5:
        return None
    smooth = np.convolve(counts, np.ones(3) / 3, "same")
    peak = float(edges[int(np.argmax(smooth))] + _BIN / 2)
    share = float((np.abs(ratios - peak) <= _PEAK_HALF_WIDTH).mean())
    return peak if share >= _PEAK_SHARE else None


def darkened_ratios(frame: NDArray[np.uint8], difference: Difference) -> NDArray[np.float64]:
    """Return the mean ratio (n,) of the frame to the ground at the pixels classed as shadow."""
    rows, columns = np.nonzero(difference.classes == SHADOW)
    exposure = difference.exposure
    mapped = np.stack([exposure.levels[k][frame[rows, columns, k]] for k in range(3)], axis=1)
    gain = exposure.gain_map(*frame.shape[:2])[rows >> 3, columns >> 3]
    ground = difference.ground[rows, columns, :3].astype(float)
    return np.asarray((mapped.sum(axis=1) * gain + 6.0) / (ground.sum(axis=1) + 6.0), float)


def learn_direction(
    differences: Sequence[Difference], poses: Sequence[NDArray[np.float64]]
) -> tuple[float, float] | None:
    """Return the direction from things to their shadows, None where shadows lie on all sides alike.

    Every shadow pixel points away from the nearest pixel of a thing; the mean of these directions is the answer. The
    homographies *poses* (frame to reference) turn them into the reference's axes.
    """
    total, count = np.zeros(2), 0
    for difference, pose in zip(differences, poses, strict=True):
        away = _away_from_things(difference.classes) @ pose[:2, :2].T
        norm = np.linalg.norm(away, axis=1)
        total += (away / norm[:, None]).sum(axis=0)
        count += len(away)
    length = float(np.linalg.norm(total))
    if count < _FEWEST_PIXELS or length < _LEAST_DIRECTION * count:
        return None
    return float(total[0] / length), float(total[1] / length)


def _away_from_things(classes: NDArray[np.uint8]) -> NDArray[np.float64]:
    things = classes == OBJECT
    # Single pixels of noise are not things.
    things = cv2.morphologyEx(things.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    if not things.any():
        return np.zeros((0, 2))
    distance, label = cv2.distanceTransformWithLabels(1 - things, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    thing_rows, thing_columns = np.nonzero(things)
    place = np.zeros((label.max() + 1, 2))
    place[label[thing_rows, thing_columns]] = np.stack([thing_columns, thing_rows], axis=1)
    rows, columns = np.nonzero((classes == SHADOW) & (distance <= _REACH_PX) & (distance > 0))
    return np.asarray(np.stack([columns, rows], axis=1) - place[label[rows, columns]], float)
