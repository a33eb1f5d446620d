"""Measure fitted boxes: paint colour, area and contrast, from the pixels inside."""

from __future__ import annotations

import numpy as np
from numba import njit

from vtrack_batch.background.exposure import GAIN_SHIFT
from vtrack_batch.background.subtract import GROUND, UNSEEN, place_of

_CORE = 0.85


@njit(cache=True, nogil=True)
def measure(picture, ground, to_ground, classes, levels, gain, boxes):  # type: ignore[no-untyped-def]
    """Return for each box (n, 7): red, green, blue, area in px, contrast, reaches over the border, holds unseen ground.

    *to_ground* (3, 3) takes pixels to those of *ground*; *boxes* are column, row, and the half axes along (x, y) and
    across (x, y) in px. Colour is the median over the inner pixels that differ from the ground, so windscreens and rims
    hardly count.
    """
    found = np.zeros((len(boxes), 7))
    height, width = classes.shape
    histogram = np.zeros((3, 256), np.int64)
    for n in range(len(boxes)):
        column, row, lx, ly, wx, wy = boxes[n]
        histogram[:] = 0
        determinant = lx * wy - ly * wx
        reach_r, reach_c = abs(ly) + abs(wy), abs(lx) + abs(wx)
        inside, total, area = 0, 0.0, 0
        for i in range(int(np.floor(row - reach_r)), int(np.ceil(row + reach_r)) + 1):
            for j in range(int(np.floor(column - reach_c)), int(np.ceil(column + reach_c)) + 1):
                x, y = j - column, i - row
                along, across = abs((x * wy - y * wx) / determinant), abs((y * lx - x * ly) / determinant)
                if along > 1.0 or across > 1.0:
                    continue
                if i < 0 or j < 0 or i >= height or j >= width:
                    found[n, 5] = 1
                    continue
                r, c = place_of(to_ground, j, i)
                if classes[i, j] == UNSEEN or r < 0 or r >= ground.shape[0] or c < 0 or c >= ground.shape[1]:
                    found[n, 6] = 1
                    continue
                g = gain[i >> GAIN_SHIFT, j >> GAIN_SHIFT]
                largest = 0.0
                for k in range(3):
                    level = min(levels[k, picture[i, j, k]] * g, 255.0)
                    largest = max(largest, abs(level - ground[r, c, k]))
                    if along < _CORE and across < _CORE:
                        histogram[k, int(level)] += 1
                inside += 1
                total += largest
                area += classes[i, j] != GROUND
        found[n, 3] = area
        found[n, 4] = total / max(1, inside)
        for k in range(3):
            found[n, k] = _median(histogram[k])
    return found


@njit(cache=True, nogil=True)
def _median(histogram):  # type: ignore[no-untyped-def]
    half, below = histogram.sum() / 2, 0
    if half == 0:
        return 0.0
    for level in range(256):
        if below + histogram[level] >= half:
            return level + (half - below) / histogram[level] - 0.5
        below += histogram[level]
    return 255.0
