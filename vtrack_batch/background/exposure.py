"""The exposure between two pictures of the same ground: a monotone map per channel and a smooth gain.

Both are told from the levels that a picture shows where the target has a given level. Conditioning on the *target*
(ground, mostly) keeps vehicles a minority at every level: a white car is rare over grey asphalt, but nearly all of what
is white in the picture may be cars.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

GAIN_SHIFT = 3
"""The gain is looked up once per 2^3 x 2^3 pixels; it changes far more slowly."""

_FEWEST_PAIRS = 400
_FEWEST_PER_LEVEL = 60
_FEWEST_PER_TILE = 24
_GAIN_BINS = 256
_GAIN_LIMIT = 2.0


@dataclass(frozen=True, eq=False)
class Exposure:
    """Takes levels of a picture to those of its target: first ``levels`` (3, 256) float32, then times ``gain``.

    ``gain`` is (rows, columns) float32, spread evenly over the whole picture.
    """

    levels: NDArray[np.float32]
    gain: NDArray[np.float32]

    def gain_map(self, height: int, width: int) -> NDArray[np.float32]:
        """Return the gain for a picture of *height* x *width* pixels, one value per 8 x 8 pixels."""
        cell = 1 << GAIN_SHIFT
        return np.asarray(cv2.resize(self.gain, (-(-width // cell), -(-height // cell))), np.float32)


def fit_exposure(
    picture: NDArray[np.uint8], target: NDArray[np.uint8], usable: NDArray[np.bool_], *, tile_px: float
) -> Exposure:
    """Fit the exposure that takes *picture* to *target*, both (h, w, 3) uint8 and aligned.

    *usable* (h, w) bool marks flat ground seen in both; *tile_px* is the distance of the nodes of the gain. Too few
    usable pixels give the identity.
    """
    counts = _joint_counts(picture, target, usable)
    levels = np.stack([_monotone_map(counts[channel]) for channel in range(3)]).astype(np.float32)
    rows = max(1, round(picture.shape[0] / tile_px))
    columns = max(1, round(picture.shape[1] / tile_px))
    gain = _tile_gains(picture, target, usable, levels, np.ones((rows, columns), np.float32))
    return Exposure(levels, _smooth(gain))


def _smooth(gain: NDArray[np.float32]) -> NDArray[np.float32]:
    # The median of neighbouring tiles keeps a tile that is full of vehicles from eating them.
    if min(gain.shape) >= 2:
        gain = cv2.medianBlur(gain, 3)
    return np.asarray(cv2.GaussianBlur(gain, (0, 0), 0.8), np.float32)


def _monotone_map(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the target's level for every level of the picture, from joint *counts* (target level, picture level)."""
    own = np.arange(256.0)
    per_level = counts.sum(axis=1)
    if per_level.sum() < _FEWEST_PAIRS:
        return own
    # Levels are pooled with their neighbours until enough pairs stand behind each median.
    pooled = np.cumsum(np.vstack([np.zeros((1, 256), np.int64), counts]), axis=0)
    known, seen_as, weight = [], [], []
    for level in range(256):
        for reach in (1, 2, 4, 7):
            window = pooled[min(256, level + reach + 1)] - pooled[max(0, level - reach)]
            if window.sum() >= _FEWEST_PER_LEVEL and per_level[level] > 0:
                cumulated = np.cumsum(window)
                known.append(float(level))
                seen_as.append(float(np.interp(0.5 * cumulated[-1], cumulated, own)))
                weight.append(float(window.sum()))
                break
    if len(known) < 2:
        return own
    curve = _isotonic(np.array(seen_as), np.array(weight))
    return _inverse(np.array(known), curve)


def _isotonic(values: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smooth over neighbouring levels, then pool adjacent violators: the nearest non-decreasing curve."""
    kernel = np.array([1.0, 2.0, 3.0, 2.0, 1.0])
    weight = np.minimum(weight, np.median(weight))
    smooth = np.convolve(np.pad(values * weight, 2), kernel, "valid") / np.convolve(np.pad(weight, 2), kernel, "valid")
    blocks: list[list[float]] = []
    for value, mass in zip(smooth, weight, strict=True):
        blocks.append([value, mass, 1])
        while len(blocks) > 1 and blocks[-2][0] >= blocks[-1][0]:
            last = blocks.pop()
            total = blocks[-1][1] + last[1]
            blocks[-1] = [(blocks[-1][0] * blocks[-1][1] + last[0] * last[1]) / total, total, blocks[-1][2] + last[2]]
    return np.concatenate([np.full(int(size), value) for value, _, size in blocks])


def _inverse(known: NDArray[np.float64], seen_as: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the target level for every picture level 0..255; beyond what was seen the ratio of the ends goes on."""
    level, first = np.unique(seen_as, return_index=True)
    last = np.r_[first[1:], len(seen_as)] - 1
    target = (known[first] + known[last]) / 2
    own = np.arange(256.0)
    mapped = np.interp(own, level, target)
    below, above = own < level[0], own > level[-1]
    mapped[below] = own[below] * target[0] / max(level[0], 1.0)
    mapped[above] = target[-1] + (own[above] - level[-1]) * target[-1] / max(level[-1], 1.0)
    return mapped


@njit(cache=True, nogil=True)
def expose(picture, levels, gain, top):  # type: ignore[no-untyped-def]
    """Apply an exposure to *picture* (h, w, 3) uint8 in place; its first row is row *top* of the *gain* map."""
    for r in range(picture.shape[0]):
        for c in range(picture.shape[1]):
            g = gain[(r + top) >> GAIN_SHIFT, c >> GAIN_SHIFT]
            for k in range(3):
                picture[r, c, k] = np.uint8(min(levels[k, picture[r, c, k]] * g + 0.5, 255.0))


@njit(cache=True, nogil=True)
def _joint_counts(picture, target, usable):  # type: ignore[no-untyped-def]
    counts = np.zeros((3, 256, 256), np.int64)
    for r in range(picture.shape[0]):
        for c in range(picture.shape[1]):
            if usable[r, c]:
                for k in range(3):
                    # Clipped levels tell nothing about the curve.
                    if picture[r, c, k] < 254:
                        counts[k, target[r, c, k], picture[r, c, k]] += 1
    return counts


@njit(cache=True, nogil=True)
def _tile_gains(picture, target, usable, levels, gains):  # type: ignore[no-untyped-def]
    """Median ratio target / picture per tile, by a histogram of logarithms; tiles without data keep 1."""
    rows, columns = gains.shape
    height, width = usable.shape
    scale = (_GAIN_BINS / 2) / np.log(_GAIN_LIMIT)
    for i in range(rows):
        for j in range(columns):
            counts = np.zeros(_GAIN_BINS + 1, np.int64)
            total = 0
            for r in range(i * height // rows, (i + 1) * height // rows):
                for c in range(j * width // columns, (j + 1) * width // columns):
                    if usable[r, c]:
                        mapped, wanted = 1.0, 1.0
                        for k in range(3):
                            mapped += levels[k, picture[r, c, k]]
                            wanted += target[r, c, k]
                        b = int(np.log(wanted / mapped) * scale + _GAIN_BINS / 2 + 0.5)
                        counts[min(max(b, 0), _GAIN_BINS)] += 1
                        total += 1
            if total >= _FEWEST_PER_TILE:
                below = 0
                for b in range(_GAIN_BINS + 1):
                    if 2 * (below + counts[b]) >= total:
                        inside = (0.5 * total - below) / counts[b] - 0.5
                        gains[i, j] = np.exp((b + inside - _GAIN_BINS / 2) / scale)
                        break
                    below += counts[b]
    return gains
