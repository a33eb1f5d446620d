"""What cast shadows of moving things look like here: how dark, and on which side of the thing they lie.

Source: a cast shadow scales the levels of the ground (Horprasert et al. 1999), so the ratios of darkened pixels pile
up at one value where the sun shines and nowhere in particular where it does not.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.background.exposure import GAIN_SHIFT
from vtrack_batch.background.params import BackgroundParams
from vtrack_batch.background.subtract import OBJECT, SHADOW, Difference
from vtrack_batch.model import homography

_BIN = 0.02
_PEAK_HALF_WIDTH = 0.06
_PEAK_SHARE = 0.36
_DARKER, _BRIGHTER = 0.11, 0.14
_TINT = 0.15
_INNER_SHARE = 0.33
_REACH_PX = 12
_LEAST_DIRECTION = 0.15
_FEWEST_PIXELS = 300
_BAND_ROWS = 512


Band = NDArray[np.float64]
"""(3, 2): lowest and highest ratio of a pixel in cast shadow, per channel."""


@dataclass(frozen=True)
class Shadows:
    """``ratio`` = level in shadow / level in light, per channel; ``direction`` = unit vector in reference px from a
    thing to its shadow. None = not found.
    """

    ratio: tuple[float, float, float] | None = None
    direction: tuple[float, float] | None = None

    @property
    def band(self) -> Band:
        """What counts as shadow; empty where none are cast."""
        if self.ratio is None:
            return np.zeros((3, 2))
        return np.array([[ratio - _DARKER, ratio + _BRIGHTER] for ratio in self.ratio])


def widest_band(lowest: float, highest: float) -> Band:
    """Return the band for a mean ratio of *lowest* to *highest*: the sky lends shadows some blue and takes some red."""
    return np.tile([lowest - _TINT, highest + _TINT], (3, 1))


def learn_ratio(ratios: NDArray[np.float64], params: BackgroundParams) -> tuple[float, float, float] | None:
    """Return the ratio per channel at which darkened pixels (n, 3) pile up; None without a peak."""
    if len(ratios) < _FEWEST_PIXELS:
        return None
    mean = ratios.mean(axis=1)
    counts, edges = np.histogram(mean, np.arange(params.shadow_ratio_min, params.shadow_ratio_max + _BIN, _BIN))
    peak = float(edges[int(np.argmax(np.convolve(counts, np.ones(3) / 3, "same")))] + _BIN / 2)
    near = np.abs(mean - peak) <= _PEAK_HALF_WIDTH
    at_the_end = min(peak - params.shadow_ratio_min, params.shadow_ratio_max - peak) < _PEAK_HALF_WIDTH
    if near.mean() < _PEAK_SHARE or at_the_end:
        return None
    red, green, blue = np.median(ratios[near], axis=0)
    return float(red), float(green), float(blue)


def darkened_ratios(frame: NDArray[np.uint8], difference: Difference, params: BackgroundParams) -> NDArray[np.float64]:
    """Return the ratios (n, 3) of the frame to the ground at the pixels classed as shadow, where these are even."""
    rows, columns = _places(difference.classes == SHADOW)
    local_range = _local_range(frame, difference.classes == SHADOW)
    # The edge of a shadow is a mixture of shadow and light.
    inner = local_range <= (np.quantile(local_range, _INNER_SHARE) if len(rows) else 0)
    rows, columns = rows[inner], columns[inner]
    exposure = difference.exposure
    mapped = np.stack([exposure.levels[k][frame[rows, columns, k]] for k in range(3)], axis=1)
    gain = exposure.gain_map(*frame.shape[:2])[rows >> GAIN_SHIFT, columns >> GAIN_SHIFT]
    there = homography.apply(difference.to_ground, np.stack([columns, rows], axis=1).astype(float))
    ground_columns, ground_rows = np.floor(there + 0.5).astype(int).T
    ratios = (mapped * gain[:, None] + 2.0) / (difference.ground[ground_rows, ground_columns, :3] + 2.0)
    mean = ratios.mean(axis=1)
    return np.asarray(ratios[(mean >= params.shadow_ratio_min) & (mean <= params.shadow_ratio_max)], float)


def _local_range(frame: NDArray[np.uint8], wanted: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the range of grey levels around each of the *wanted* pixels (H, W), in order of rows."""
    square, found = np.ones((3, 3), np.uint8), []
    for top in range(0, len(frame), _BAND_ROWS):
        first = max(0, top - 1)
        grey = cv2.cvtColor(frame[first : top + _BAND_ROWS + 1], cv2.COLOR_RGB2GRAY)
        local_range = cv2.subtract(cv2.dilate(grey, square), cv2.erode(grey, square))[top - first :]
        found.append(local_range[:_BAND_ROWS][wanted[top : top + _BAND_ROWS]])
    return np.concatenate(found)


def learn_direction(
    differences: Iterable[Difference], poses: Sequence[NDArray[np.float64]]
) -> tuple[float, float] | None:
    """Return the direction from things to their shadows, None where shadows lie on all sides alike.

    Every shadow pixel points away from the nearest pixel of a thing; the mean of these directions is the answer. The
    homographies *poses* (frame to reference) turn them into the reference's axes.
    """
    total, count = np.zeros(2), 0
    for difference, pose in zip(differences, poses, strict=True):
        for top in range(0, len(difference.classes), _BAND_ROWS):
            away = _away_from_things(difference.classes[top : top + _BAND_ROWS]) @ pose[:2, :2].T
            total += (away / np.linalg.norm(away, axis=1)[:, None]).sum(axis=0)
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
    thing_rows, thing_columns = _places(things > 0)
    place = np.zeros((label.max() + 1, 2))
    place[label[thing_rows, thing_columns]] = np.stack([thing_columns, thing_rows], axis=1)
    rows, columns = _places((classes == SHADOW) & (distance <= _REACH_PX) & (distance > 0))
    return np.asarray(np.stack([columns, rows], axis=1) - place[label[rows, columns]], float)


def _places(where: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return rows and columns (2, n) of what is true in *where* (h, w): ``np.nonzero`` in a third of the time."""
    found = cv2.findNonZero(where.view(np.uint8))
    return np.zeros((2, 0), np.int64) if found is None else np.asarray(found.reshape(-1, 2).T[::-1], np.int64)
