"""Bodies of nearly the ground's own colour: found by what neighbouring pixels show alike, beside what surely differs.

A grey body differs from asphalt by less than noise lets a single pixel show; its windscreen, its edges and its shadow
differ surely. The mean of nine pixels has a third of the noise of one. So where something is found, the pixels around
it are asked again, nine at a time; a pixel counts only if it differs to the same side itself, for else every edge
would grow by a pixel. How much such means differ by chance, in this frame, is told by ground far from all that is
found: little where the frame fits the ground, too much to see anything faint where it is off.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.background.exposure import GAIN_SHIFT
from vtrack_batch.background.subtract import FULL, GROUND, OBJECT, SHADOW, UNSEEN, Difference, place_of

_UNSEEN = 255
_CELL = 4
_SURE = 50
_OWN = 2.0
_STEP_PX, _POINTS, _FEWEST = 5, 20_000, 200
_RARE, _CHANCES = 0.99, 3.0


def add_faint(
    difference: Difference,
    frame: NDArray[np.uint8],
    *,
    threshold: float,
    reach_px: float,
) -> None:
    """Raise the evidence of *difference*, in place, where 3 x 3 pixels of *frame* (H, W, 3) uint8 differ together.

    *threshold* in grey levels gives half evidence, or more levels, where ground without anything differs by so much;
    within *reach_px* of pixels that differ by themselves.
    """
    height, width = frame.shape[:2]
    held = _held(difference.evidence)
    side = 2 * max(1, round(reach_px / _CELL)) + 1
    near = cv2.dilate(held, np.ones((side, side), np.uint8))
    exposure = difference.exposure
    light = exposure.levels, exposure.gain_map(height, width)
    seen = frame, difference.ground, difference.to_ground, *light
    chance = _by_chance(*seen, near, max(_STEP_PX, int((height * width / _POINTS) ** 0.5)))
    if len(chance) < _FEWEST:
        return
    threshold = max(threshold, _CHANCES * float(np.quantile(chance, _RARE)))
    _raise(*seen, threshold, near, difference.evidence, difference.classes)


@njit(cache=True, nogil=True)
def _held(evidence):  # type: ignore[no-untyped-def]
    """Return which cells of pixels hold one that surely differs: 1, else 0."""
    height, width = evidence.shape
    held = np.zeros((-(-height // _CELL), -(-width // _CELL)), np.uint8)
    most = np.empty(width, np.uint8)
    for i in range(held.shape[0]):
        most[:] = 0
        for r in range(i * _CELL, min((i + 1) * _CELL, height)):
            row = evidence[r]
            for c in range(width):
                most[c] = row[c] if row[c] > most[c] else most[c]
        for c in range(width):
            if most[c] >= _SURE:
                held[i, c // _CELL] = 1
    return held


@njit(cache=True, nogil=True, error_model="numpy")
def _by_chance(frame, ground, matrix, levels, gain, near, step):  # type: ignore[no-untyped-def]
    """Return by how much nine pixels together differ beyond the tolerance at every *step*-th pixel that is not near."""
    height, width = frame.shape[:2]
    found = np.empty((height // step + 1) * (width // step + 1), np.float32)
    count, nine = 0, np.zeros((3, 3, 4), np.float32)
    for row in range(step // 2 + 1, height - 1, step):
        for column in range(step // 2 + 1, width - 1, step):
            if near[row // _CELL, column // _CELL]:
                continue
            seen = True
            for i in range(3):
                for j in range(3):
                    seen &= _differ(frame, ground, matrix, levels, gain, row + i - 1, column + j - 1, nine[i, j])
            if seen:
                found[count] = abs(_together(nine[0], nine[1], nine[2], 1)) - nine[1, 1, 3]
                count += 1
    return found[:count]


@njit(cache=True, nogil=True, error_model="numpy")
def _raise(frame, ground, matrix, levels, gain, threshold, near, evidence, classes):  # type: ignore[no-untyped-def]
    height, width = evidence.shape
    rows = np.zeros((3, width, 4), np.float32)
    for row in range(height):
        _differences(frame, ground, matrix, levels, gain, near, row, rows[row % 3])
        middle = row - 1
        if middle < 1:
            continue
        above, here, below = rows[(row - 2) % 3], rows[middle % 3], rows[row % 3]
        for cell in range(near.shape[1]):
            if not near[middle // _CELL, cell]:
                continue
            for column in range(max(1, cell * _CELL), min(width - 1, (cell + 1) * _CELL)):
                if evidence[middle, column] == FULL or classes[middle, column] == UNSEEN:
                    continue
                change = _together(above, here, below, column)
                value = int(min(max((abs(change) - here[column, 3]) / threshold - 0.5, 0.0), 1.0) * FULL)
                # The edge of a shadow is half as dark, and nothing that lies on the ground.
                if value > evidence[middle, column] and (change > 0 or not _beside_shadow(classes, middle, column)):
                    evidence[middle, column] = value
                    if classes[middle, column] == GROUND:
                        classes[middle, column] = OBJECT


@njit(cache=True, nogil=True)
def _beside_shadow(classes, row, column):  # type: ignore[no-untyped-def]
    for r in range(row - 1, row + 2):
        for c in range(column - 1, column + 2):
            if classes[r, c] == SHADOW:
                return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _together(above, here, below, column):  # type: ignore[no-untyped-def]
    """Return by how many levels the nine pixels around *column* differ on the mean, if the middle one does as well.

    Less than 0 where they are darker.
    """
    strongest = np.float32(0.0)
    for k in range(3):
        mean = np.float32(0.0)
        for j in range(column - 1, column + 2):
            mean += above[j, k] + here[j, k] + below[j, k]
        mean /= np.float32(9.0)
        own = _OWN * here[column, k]
        change = min(mean, own) if mean > 0 else max(mean, own)
        if change * mean > 0 and abs(change) > abs(strongest):
            strongest = change
    return strongest


@njit(cache=True, nogil=True, error_model="numpy")
def _differences(frame, ground, matrix, levels, gain, near, row, found):  # type: ignore[no-untyped-def]
    """Fill *found* (W, 4) with the signed differences and the tolerance of one row, where it may be asked for."""
    height, width = frame.shape[:2]
    above, below = max(0, row - 1) // _CELL, min(height - 1, row + 1) // _CELL
    done = 0
    for cell in range(near.shape[1]):
        if near[above, cell] or near[below, cell]:
            for column in range(max(done, cell * _CELL - 1), min(width, (cell + 1) * _CELL + 1)):
                _differ(frame, ground, matrix, levels, gain, row, column, found[column])
                done = column + 1


@njit(cache=True, nogil=True, error_model="numpy")
def _differ(frame, ground, matrix, levels, gain, row, column, found):  # type: ignore[no-untyped-def]
    """Fill *found* (4,) with the signed differences of one pixel and its tolerance; return whether ground is seen."""
    r, c = place_of(matrix, column, row)
    if r < 0 or r >= ground.shape[0] or c < 0 or c >= ground.shape[1] or ground[r, c, 3] == _UNSEEN:
        found[:] = 0.0
        return False
    g = gain[row >> GAIN_SHIFT, column >> GAIN_SHIFT]
    for k in range(3):
        found[k] = levels[k, frame[row, column, k]] * g - ground[r, c, k]
    found[3] = ground[r, c, 3]
    return True
