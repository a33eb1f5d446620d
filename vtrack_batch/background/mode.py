"""The ground where it is occupied too often for a median: stop lines, and places where somebody waited for long.

Two things tell ground from vehicles there. Beside the queue the same road lies free, so samples that look like the road
nearby show it even if they are few; and where none does, vehicles differ in colour while the ground does not, so the
half-sample mode of the samples is it (Robertson and Cryer 1974; Bickel and Fruehwirth 2006).
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

_CELL_PX = 8
_REACHES_PX = (32, 96, 288)
_ENOUGH = 0.03
_LIKE_ROAD = 22
_FEWEST_LIKE_ROAD = 0.1
_ROAD_TO_MODE = 0.33


def road_nearby(pixels: NDArray[np.uint8], traffic: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the mean colour (H, W, 3) uint8 of *pixels* where *traffic* (H, W) bool is, as near as there is enough.

    Pixels far from all traffic get 0.
    """
    height, width = traffic.shape
    cells = (-(-width // _CELL_PX), -(-height // _CELL_PX))
    weight = traffic.astype(np.float32)
    share = cv2.resize(weight, cells, interpolation=cv2.INTER_AREA)
    # Channel by channel, for memory's sake.
    parts = [cv2.resize(pixels[:, :, k] * weight, cells, interpolation=cv2.INTER_AREA) for k in range(3)]
    colour = np.stack(parts, axis=2)
    road = np.zeros_like(colour)
    open_ = np.ones(share.shape, np.bool_)
    for reach in _REACHES_PX:
        sigma = reach / _CELL_PX
        mass = cv2.GaussianBlur(share, (0, 0), sigma)
        mean = cv2.GaussianBlur(colour, (0, 0), sigma) / np.maximum(mass, 1e-6)[:, :, None]
        found = open_ & (mass >= _ENOUGH)
        road[found] = mean[found]
        open_ &= ~found
    return np.asarray(cv2.resize(np.clip(road, 0, 255).astype(np.uint8), (width, height)), np.uint8)


@njit(cache=True, nogil=True)
def replace_busy(image, stack, covered, busy, road):  # type: ignore[no-untyped-def]
    """Overwrite *image* (h, w, 3) uint8 where *busy* (h, w) bool by road-like samples, else by the mode of *stack*.

    *stack* (n, h, w, 3) uint8, used where *covered* (n, h, w) bool; *road* (h, w, 3) uint8 = colour of road nearby.
    """
    count = stack.shape[0]
    grey = np.empty(count, np.int64)
    member = np.empty(count, np.int64)
    for r in range(busy.shape[0]):
        for c in range(busy.shape[1]):
            if not busy[r, c]:
                continue
            n = _sorted_by_grey(stack, covered, r, c, grey, member)
            first, size = _densest(grey, n)
            middle = grey[first + size // 2]
            alike = 0
            for j in range(n):
                alike += abs(grey[j] - middle) <= 3 * _LIKE_ROAD
            like, total = 0, np.zeros(3, np.int64)
            for i in range(count):
                if covered[i, r, c] and _is_like(stack[i, r, c], road[r, c]):
                    like += 1
                    for k in range(3):
                        total[k] += np.int64(stack[i, r, c, k])
            if like < max(2.0, _FEWEST_LIKE_ROAD * n) or like < _ROAD_TO_MODE * alike:
                like = size
                total[:] = 0
                for j in range(first, first + size):
                    for k in range(3):
                        total[k] += np.int64(stack[member[j], r, c, k])
            if like > 0:
                for k in range(3):
                    image[r, c, k] = (total[k] + like // 2) // like


@njit(cache=True, nogil=True)
def _sorted_by_grey(stack, covered, r, c, grey, member):  # type: ignore[no-untyped-def]
    n = 0
    for i in range(stack.shape[0]):
        if covered[i, r, c]:
            level = np.int64(stack[i, r, c, 0]) + np.int64(stack[i, r, c, 1]) + np.int64(stack[i, r, c, 2])
            j = n
            while j > 0 and grey[j - 1] > level:
                grey[j], member[j] = grey[j - 1], member[j - 1]
                j -= 1
            grey[j], member[j] = level, i
            n += 1
    return n


@njit(cache=True, nogil=True)
def _densest(grey, n):  # type: ignore[no-untyped-def]
    """First index and size of what is left of the sorted levels when the densest half is taken again and again."""
    first, size = 0, n
    while size > 3:
        half = (size + 1) // 2
        best, width = first, grey[first + half - 1] - grey[first]
        for j in range(first + 1, first + size - half + 1):
            if grey[j + half - 1] - grey[j] < width:
                best, width = j, grey[j + half - 1] - grey[j]
        first, size = best, half
    return first, size


@njit(cache=True, nogil=True)
def _is_like(colour, road):  # type: ignore[no-untyped-def]
    for k in range(3):
        if abs(np.int64(colour[k]) - np.int64(road[k])) > _LIKE_ROAD:
            return False
    return np.int64(road[0]) + np.int64(road[1]) + np.int64(road[2]) > 0
