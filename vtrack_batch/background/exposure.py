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
from scipy.linalg import solveh_banded

GAIN_SHIFT = 3
"""The gain is looked up once per 2^3 x 2^3 pixels; it changes far more slowly."""

_FEWEST_PAIRS = 400
_FLAT_LEVELS = 6.0
_STIFFNESS = 3e4
_QUARTILES = (0.25, 0.5, 0.75)
_USUAL_SCATTER = 8.0
_LINE_TRUST = 0.003
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

    def gain_map(self, height: int, width: int, rows: tuple[int, int] | None = None) -> NDArray[np.float32]:
        """Return the gain for a picture of *height* x *width* pixels, one value per 8 x 8 pixels.

        Of the *rows* alone, if given: it then begins at the cell in which the first of them lies.
        """
        cell = 1 << GAIN_SHIFT
        size = -(-width // cell), -(-height // cell)
        if rows is None:
            return np.asarray(cv2.resize(self.gain, size), np.float32)
        first, last = rows[0] // cell, -(-rows[1] // cell)
        across, down = self.gain.shape[1] / size[0], self.gain.shape[0] / size[1]
        into = np.array([[across, 0, (across - 1) / 2], [0, down, down * (first + 0.5) - 0.5]])
        how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        wanted = (size[0], last - first)
        part = cv2.warpAffine(self.gain, into, wanted, flags=how, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(part, np.float32)


def fit_exposure(
    picture: NDArray[np.uint8], target: NDArray[np.uint8], usable: NDArray[np.bool_], *, tile_px: float
) -> Exposure:
    """Fit the exposure that takes *picture* to *target*, both (h, w, 3) uint8 and aligned.

    *usable* (h, w) bool marks ground seen in both; *tile_px* is the distance of the nodes of the gain. Too few
    usable pixels give the identity.
    """
    usable = _flat(target, usable)
    counts = _joint_counts(picture, target, usable)
    levels = np.stack([_monotone_map(counts[channel]) for channel in range(3)]).astype(np.float32)
    rows = max(1, round(picture.shape[0] / tile_px))
    columns = max(1, round(picture.shape[1] / tile_px))
    gain = _tile_gains(picture, target, usable, levels, np.ones((rows, columns), np.float32))
    return Exposure(levels, _smooth(gain))


def _smooth(gain: NDArray[np.float32]) -> NDArray[np.float32]:
    # The median of neighbouring tiles keeps a tile that is full of vehicles from eating them.
    steady = cv2.medianBlur(gain, 3) if min(gain.shape) >= 2 else gain
    return np.asarray(cv2.GaussianBlur(steady, (0, 0), 0.8), np.float32)


def _flat(target: NDArray[np.uint8], usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the flatter half of the *usable* points: beside edges a pixel's partner is often another thing."""
    grey = cv2.cvtColor(target, cv2.COLOR_RGB2GRAY)
    square = np.ones((3, 3), np.uint8)
    local_range = cv2.subtract(cv2.dilate(grey, square), cv2.erode(grey, square))
    below = np.cumsum(np.bincount(local_range[usable], minlength=256))
    middle = float(np.searchsorted(2 * below, below[-1]))
    return np.asarray(usable & (local_range <= max(middle, _FLAT_LEVELS)))


def _monotone_map(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the target's level for every level of the picture, from joint *counts* (target level, picture level)."""
    own = np.arange(256.0)
    per_level = counts.sum(axis=1)
    if per_level.sum() < _FEWEST_PAIRS:
        return own
    low, middle, high = _levels_at(counts, np.array(_QUARTILES))
    # Levels at which partners scatter widely are those of things that stand elsewhere in the picture: roofs, markings.
    trust = np.minimum(per_level * (256.0 / per_level.sum()), 1.0) / (1.0 + ((high - low) / _USUAL_SCATTER) ** 2)
    seen_as = _smooth_curve(middle, trust)
    # The inverse of the curve; beyond its ends the ratio goes on.
    mapped = np.interp(own, seen_as, own)
    above, beneath = own > seen_as[-1], own < seen_as[0]
    mapped[above] = 255.0 * own[above] / max(seen_as[-1], 1.0)
    mapped[beneath] = 0.0
    return mapped


def _smooth_curve(values: NDArray[np.float64], trust: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fit an increasing smooth curve to *values* (256,); levels of little *trust* follow the straight line of the rest.

    Source: Whittaker's smoother with second differences (Eilers 2003), on the residuals of a line by iterated weights.
    """
    own, weight = np.arange(256.0), trust
    line = own
    for _ in range(5):
        share = weight / weight.sum()
        away = own - share @ own
        spread = share * away
        line = share @ values + (spread @ values) / max(float(spread @ away), 1e-9) * away
        weight = trust / (1.0 + ((values - line) / _USUAL_SCATTER) ** 2)
    pull = weight + _LINE_TRUST
    bands = np.zeros((3, 256))
    bands[2] = pull + _STIFFNESS * np.r_[1.0, 5.0, np.full(252, 6.0), 5.0, 1.0]
    bands[1, 1:] = _STIFFNESS * np.r_[-2.0, np.full(253, -4.0), -2.0]
    bands[0, 2:] = _STIFFNESS
    curve = line + solveh_banded(bands, weight * (values - line))
    return np.asarray(np.maximum.accumulate(curve) + 1e-6 * own)


@njit(cache=True, nogil=True)
def expose(picture, levels, gain, top):  # type: ignore[no-untyped-def]
    """Apply an exposure to *picture* (h, w, 3) uint8 in place; its first row is row *top* of the *gain* map."""
    half, full = np.float32(0.5), np.float32(255.0)
    for r in range(picture.shape[0]):
        row, gains = picture[r], gain[(r + top) >> GAIN_SHIFT]
        for c in range(picture.shape[1]):
            g = gains[c >> GAIN_SHIFT]
            for k in range(3):
                level = levels[k, row[c, k]] * g + half
                row[c, k] = np.uint8(np.int32(level if level < full else full))


@njit(cache=True, nogil=True)
def _levels_at(counts, shares):  # type: ignore[no-untyped-def]
    """Return for each of *shares* and each row of *counts* the first column up to which so large a share of it lies."""
    found = np.zeros((len(shares), counts.shape[0]))
    for row in range(counts.shape[0]):
        total = counts[row].sum()
        for k in range(len(shares)):
            below = 0
            for column in range(counts.shape[1]):
                below += counts[row, column]
                if below >= shares[k] * total:
                    found[k, row] = column
                    break
    return found


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
    # Logarithms of the sum of three levels, by quarters of a level: most of the time went into them.
    logarithm = np.log(np.arange(1, 4 * (3 * 255 + 2)) / 4) * scale
    for i in range(rows):
        for j in range(columns):
            counts = np.zeros(_GAIN_BINS + 1, np.int64)
            total = 0
            for r in range(i * height // rows, (i + 1) * height // rows):
                for c in range(j * width // columns, (j + 1) * width // columns):
                    if usable[r, c]:
                        mapped, wanted = 1.0, 1
                        for k in range(3):
                            mapped += levels[k, picture[r, c, k]]
                            wanted += target[r, c, k]
                        quarters = min(int(4 * mapped + 0.5), len(logarithm))
                        b = int(logarithm[4 * wanted - 1] - logarithm[quarters - 1] + _GAIN_BINS / 2 + 0.5)
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
