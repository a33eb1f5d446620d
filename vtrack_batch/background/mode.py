"""The ground where it is occupied too often for a median: stop lines, and places where somebody waited for long.

Three things tell ground from vehicles there. Samples agree on it: vehicles differ in colour, the ground does not. It is
calm: a window as large as a car holds edges wherever a vehicle or its shadow is. And it looks like the road nearby. So
the samples vote, calm ones more, each for the colours near its own, and the road nearby votes too: a mode with weights
(kernel density estimate, Parzen 1962). Ground comes back after every vehicle; a vehicle stands once: however long one
colour stays without a break, it has no more than two votes.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

_CELL_PX = 8
_REACHES_PX = (32, 96, 288)
_ENOUGH = 0.03
_SAME = 8.0
_LIKE_ROAD = 25.0
_ROAD_VOTES = 2.0
_STAY_VOTES = 2.0
_AGREES = 0.3
_CALM = 16.0
# Ground in shadow has at most this share of its levels; beside a grey car's levels, those of the road are higher.
_SHADED = 0.65
_NEAR = 40.0
_KIND_APART = 0.85
# Half a cell beyond the last one whose colour is known.
_MOSTLY = 0.5


@dataclass(frozen=True, eq=False)
class Road:
    """The ``colour`` (h, w, 3) uint8 of the road nearby, 0 where there is none, spread evenly over a frame's ``size``.

    The size is rows and columns.
    """

    colour: NDArray[np.uint8]
    size: tuple[int, int]

    def part(self, rows: tuple[int, int], columns: tuple[int, int]) -> NDArray[np.uint8]:
        """Return the colour (h, w, 3) at the pixels of some rows and columns."""
        down, across = (own / whole for own, whole in zip(self.colour.shape, self.size, strict=False))
        into = np.array(
            [[across, 0.0, across * (columns[0] + 0.5) - 0.5], [0.0, down, down * (rows[0] + 0.5) - 0.5]], np.float64
        )
        size, how = (columns[1] - columns[0], rows[1] - rows[0]), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        # at the rim, where nothing is known beyond, the colour of what is known, not one between it and black
        known = np.where(self.colour.any(axis=2), np.float32(1), np.float32(0))
        colour = cv2.warpAffine(self.colour, into, size, flags=how, borderMode=cv2.BORDER_REPLICATE)
        share = cv2.warpAffine(known, into, size, flags=how, borderMode=cv2.BORDER_REPLICATE)[:, :, None]
        nearby = np.where(share >= _MOSTLY, colour / np.maximum(share, _MOSTLY), 0.0)
        return np.asarray(np.rint(np.minimum(nearby, 255.0)), np.uint8)


def road_nearby(pixels: NDArray[np.uint8], traffic: NDArray[np.bool_], *, step: int, size: tuple[int, int]) -> Road:
    """Return the mean colour of *pixels* (h, w, 3) where *traffic* (h, w) bool is, as near as there is enough.

    They are *step* pixels of a frame of *size* apart. Places far from all traffic get 0.
    """
    cell = max(1, round(_CELL_PX / step))
    cells = (-(-traffic.shape[1] // cell), -(-traffic.shape[0] // cell))
    weight = traffic.astype(np.float32)
    share = cv2.resize(weight, cells, interpolation=cv2.INTER_AREA)
    colour = cv2.resize(pixels * weight[:, :, None], cells, interpolation=cv2.INTER_AREA)
    road = np.zeros_like(colour)
    open_ = np.ones(share.shape, np.bool_)
    for reach in _REACHES_PX:
        sigma = reach / (cell * step)
        mass = cv2.GaussianBlur(share, (0, 0), sigma)
        mean = cv2.GaussianBlur(colour, (0, 0), sigma) / np.maximum(mass, 1e-6)[:, :, None]
        found = open_ & (mass >= _ENOUGH)
        road[found] = mean[found]
        open_ &= ~found
    return Road(np.clip(road, 0, 255).astype(np.uint8), size)


def unrest(stack: NDArray[np.uint8], window_px: int) -> NDArray[np.uint8]:
    """Return the largest range of a channel (n, h, w) uint8 in a square around each pixel of *stack* (n, 3, h, w)."""
    square, largest = np.ones((window_px, window_px), np.uint8), np.empty_like(stack[:, 0])
    for planes, found in zip(stack, largest, strict=True):
        ranges = [cv2.subtract(cv2.dilate(plane, square), cv2.erode(plane, square)) for plane in planes]
        cv2.max(cv2.max(ranges[0], ranges[1]), ranges[2], found)
    return largest


@njit(cache=True, nogil=True)
def replace_busy(image, spread, stack, covered, restless, busy, road):  # type: ignore[no-untyped-def]
    """Overwrite *image* (h, w, 3) and *spread* (h, w), uint8, where *busy* (h, w) bool, by the mode of *stack*.

    *stack* (n, 3, h, w) uint8, in order of time, counts where *covered* (n, h, w), the less, the more *restless*
    (n, h, w) uint8 it is; *road* (h, w, 3) uint8 = colour of road nearby, 0 = none. The spread becomes that of the
    samples like the mode, where these are a kind of their own.
    """
    count = stack.shape[0]
    levels, away = np.empty((3, count)), np.empty(count, np.int32)
    weight, votes, stay = np.empty(count), np.empty(count), np.empty(count)
    calm, like_road = np.empty(256), np.empty(256)
    for level in range(256):
        calm[level] = np.exp(-level / _CALM)
        like_road[level] = _ROAD_VOTES * np.exp(-((level / _LIKE_ROAD) ** 2))
    for r in range(busy.shape[0]):
        for c in range(busy.shape[1]):
            if not busy[r, c]:
                continue
            n, calmest = 0, 255.0
            for i in range(count):
                if covered[i, r, c]:
                    for k in range(3):
                        levels[k, n] = stack[i, k, r, c]
                    weight[n] = restless[i, r, c]
                    calmest = min(calmest, weight[n])
                    n += 1
            if n == 0:
                continue
            for j in range(n):
                weight[j] = calm[int(weight[j] - calmest)]
            best = _most_voted(levels, weight, n, road[r, c], like_road, votes, stay)
            _set_apart(away, levels, n, float(image[r, c, 0]), float(image[r, c, 1]), float(image[r, c, 2]))
            best = _lying_below(away, levels, n, best, road[r, c])
            _set_apart(away, levels, n, levels[0, best], levels[1, best], levels[2, best])
            for k in range(3):
                image[r, c, k] = int(_mean_near(levels[k], weight, n, away) + 0.5)
            on_road = _apart(road[r, c], image[r, c]) <= _LIKE_ROAD
            _set_apart(away, levels, n, float(image[r, c, 0]), float(image[r, c, 1]), float(image[r, c, 2]))
            spread[r, c] = _spread_near(weight, n, away, 0.0 if on_road else _KIND_APART)


@njit(cache=True, nogil=True)
def _most_voted(levels, weight, n, road, like_road, votes, stay):  # type: ignore[no-untyped-def]
    """Index of the sample whose colour has most votes; *votes* and *stay* are overwritten.

    *like_road* (256,) are the votes of the *road* for what is so far from its colour.

    Every sample votes on all in turn, by selections in place of branches: processors do several of them at a time.
    """
    votes[:n], stay[:n] = 0.0, 0.0
    for i in range(n):
        red, green, blue, weighs = levels[0, i], levels[1, i], levels[2, i], weight[i]
        for j in range(n):
            away, other = abs(levels[0, j] - red), abs(levels[1, j] - green)
            away = away if away > other else other
            other = abs(levels[2, j] - blue)
            away = away if away > other else other
            likeness = 2.0 - away / _SAME
            likeness = likeness if likeness > 0.0 else 0.0
            likeness = likeness if likeness < 1.0 else 1.0
            past = stay[j] if stay[j] < _STAY_VOTES else _STAY_VOTES
            votes[j] += 0.0 if likeness > _AGREES else past
            stay[j] = stay[j] + likeness * weighs if likeness > _AGREES else 0.0
    known = np.int64(road[0]) + np.int64(road[1]) + np.int64(road[2]) > 0
    best, most = 0, -1.0
    for j in range(n):
        votes[j] += min(stay[j], _STAY_VOTES)
        if known:
            away = max(abs(road[0] - levels[0, j]), abs(road[1] - levels[1, j]), abs(road[2] - levels[2, j]))
            votes[j] += like_road[int(away)]
        if votes[j] > most:
            best, most = j, votes[j]
    return best


@njit(cache=True, nogil=True)
def _lying_below(away, levels, n, best, road):  # type: ignore[no-untyped-def]
    """Return *best*, or the sample most like the median, *away* (n,) from all, if that lies below what *best* shows.

    It does where most samples are like it, and not too unlike the *road* nearby, where all that are like *best* came
    after some of these and went before others, and are as dark as shadow on them: next to a dark hedge a lorry's shadow
    makes the lane calmer than it is.
    """
    most, first, last, nearest = 0, n, -1, 0
    for i in range(n):
        if away[i] <= _SAME:
            most += 1
            first, last = min(first, i), i
        if away[i] < away[nearest]:
            nearest = i
    if 2 * most <= n or away[best] <= 2 * _SAME:
        return best
    if road.max() > 0 and _apart(road, levels[:, nearest]) > 2 * _LIKE_ROAD:
        return best
    for k in range(3):
        if levels[k, best] > _SHADED * levels[k, nearest]:
            return best
    for i in range(n):
        if not first < i < last and _apart(levels[:, i], levels[:, best]) <= _SAME:
            return best
    return nearest


@njit(cache=True, nogil=True)
def _set_apart(away, levels, n, red, green, blue):  # type: ignore[no-untyped-def]
    """Fill *away* with the largest difference of a channel between a colour and each of the first *n* of *levels*."""
    for i in range(n):
        away[i] = max(abs(levels[0, i] - red), abs(levels[1, i] - green), abs(levels[2, i] - blue))


@njit(cache=True, nogil=True)
def _mean_near(levels, weight, n, away):  # type: ignore[no-untyped-def]
    total, mass = 0.0, 0.0
    for i in range(n):
        if away[i] <= _SAME:
            total += weight[i] * levels[i]
            mass += weight[i]
    return total / mass


@njit(cache=True, nogil=True)
def _spread_near(weight, n, away, kind_apart):  # type: ignore[no-untyped-def]
    """The deviation that a third of the samples stay below: of those like the ground, where these are a kind apart.

    Among calm samples, vehicles leave a gap between the ground's levels and theirs; trees and leaning walls show all.
    On a road it is vehicles that come and go: *kind_apart* is 0.
    """
    counts = np.zeros(256, np.int64)
    like, near = 0.0, 0.0
    for i in range(n):
        counts[away[i]] += 1
        if away[i] <= _SAME:
            like += weight[i]
        if away[i] <= _NEAR:
            near += weight[i]
    meant = counts[: int(_SAME) + 1].sum() if like >= kind_apart * near else n
    below = 0
    for level in range(256):
        below += counts[level]
        if 3 * below > meant:
            return level
    return 255


@njit(cache=True, nogil=True)
def _apart(one, other):  # type: ignore[no-untyped-def]
    """Largest difference of two colours in a channel."""
    largest = 0.0
    for k in range(3):
        largest = max(largest, abs(float(one[k]) - float(other[k])))
    return largest
