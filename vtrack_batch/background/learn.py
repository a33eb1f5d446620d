"""Learn the background of a block from samples of its frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.background.exposure import GAIN_SHIFT, Exposure, fit_exposure
from vtrack_batch.background.mode import replace_busy, road_nearby, unrest
from vtrack_batch.background.params import BackgroundParams
from vtrack_batch.background.ranks import take_ranks
from vtrack_batch.background.shadow import Band, Shadows, darkened_ratios, learn_direction, learn_ratio, widest_band
from vtrack_batch.background.stacks import STRIP_ROWS, Sample, Stacks, points_of
from vtrack_batch.background.subtract import Difference, subtract

_BUSY_COLUMNS = 256
_POINT_STEP_PX = 3
_UNSEEN_TOLERANCE = 255
_SHADOW_SAMPLES = 7
_FEWEST_FOR_MODE = 5
_LEAST_TRAFFIC, _MOST_TRAFFIC = 1.5, 0.16
_THIRD = 3
_WHOLLY = 0.999
_USUAL_METRES_PER_PX = 0.33
# A third of the |deviations| of a Gaussian lie below 0.43 standard deviations; of the largest of three, partly
# correlated channels below about 0.7.
_THIRD_TO_SIGMA = 1 / 0.7


@dataclass(frozen=True, eq=False)
class Background:
    """The block's ground without traffic, in reference pixels (H, W).

    ``levels`` (H, W, 4) uint8: colour, and the grey levels by which a frame may differ by chance, 255 = unseen;
    ``seen`` bool; ``activity`` bool where samples differ often; ``shadows`` how cast shadows look; ``samples`` = how
    many were used; ``range_share`` as in ``BackgroundParams``.
    """

    levels: NDArray[np.uint8]
    seen: NDArray[np.bool_]
    activity: NDArray[np.bool_]
    shadows: Shadows
    samples: int
    range_share: float
    _coarser: dict[tuple[int, int], NDArray[np.uint8]] = field(default_factory=dict, init=False, repr=False)

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """The colour of the ground (H, W, 3) uint8."""
        return np.ascontiguousarray(self.levels[:, :, :3])

    @property
    def tolerance(self) -> NDArray[np.uint8]:
        """Grey levels (H, W) uint8 by which a frame may differ by chance; 255 = unseen."""
        return np.ascontiguousarray(self.levels[:, :, 3])

    def ground(self, step_x: int, step_y: int) -> NDArray[np.uint8]:
        """Return colour and tolerance (h, w, 4) uint8 on a grid coarser by whole steps, for ``subtract``."""
        if step_x == step_y == 1:
            return self.levels
        if (step_x, step_y) not in self._coarser:
            self._coarser[step_x, step_y] = self._reduced(step_x, step_y)
        return self._coarser[step_x, step_y]

    def _reduced(self, step_x: int, step_y: int) -> NDArray[np.uint8]:
        height, width = self.seen.shape
        size = (width // step_x, height // step_y)
        rows, columns = size[1] * step_y, size[0] * step_x
        coarse = cv2.resize(self.levels[:rows, :columns], size, interpolation=cv2.INTER_AREA)
        seen = cv2.resize(self.seen[:rows, :columns].astype(np.float32), size, interpolation=cv2.INTER_AREA) > _WHOLLY
        # The local range grows with the distance of the pixels.
        local = self.range_share * _local_range(np.ascontiguousarray(coarse[:, :, :3]))
        tolerance = np.minimum(np.maximum(coarse[:, :, 3], local), _UNSEEN_TOLERANCE - 1)
        coarse[:, :, 3] = np.where(seen, tolerance, _UNSEEN_TOLERANCE)
        return np.asarray(coarse, np.uint8)


def learn_background(
    samples: Sequence[Sample], *, params: BackgroundParams, metres_per_px: float = _USUAL_METRES_PER_PX
) -> Background:
    """Learn the ground from *samples*, all of one size; the one with the identity as homography is the reference.

    Samples in any order give the same, if they say when they were taken; otherwise they count as in order of time.
    *metres_per_px* of the reference says how large vehicles look.

    Without a reference the first gives the exposure. One sample is its own background; two are averaged.

    Raises ValueError if there is no sample or sizes differ.
    """
    if not samples:
        raise ValueError("a background needs at least one sample")
    if len({sample.pixels.shape for sample in samples}) > 1:
        raise ValueError("samples of one background must have one size")
    samples = sorted(samples, key=lambda sample: sample.taken_s)
    stacks = Stacks(samples, _exposures(samples, params))
    strips = _strips(samples[0].pixels.shape[0])
    height, width = samples[0].pixels.shape[:2]
    pixels, seen = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.bool_)
    spread, changed = np.empty((height, width), np.uint8), np.empty((height, width), np.float32)
    for top, bottom in strips:
        at = slice(top, bottom)
        pixels[at], spread[at], changed[at], seen[at] = _median_strip(stacks, (top, bottom), params)
    if len(samples) >= _FEWEST_FOR_MODE:
        window_px = 2 * max(1, round(params.calm_window_m / metres_per_px / 2)) + 1
        _free_busy_places(stacks, strips, (pixels, spread, changed), window_px, params)
    tolerance = _tolerance(pixels, spread, seen, params)
    # Half of the neighbourhood, once: a single vehicle that passed through one of the samples counts.
    activity = cv2.blur(changed, (9, 9)) > 0.5 / max(8, len(samples))
    levels = np.dstack([pixels, tolerance])
    del pixels, tolerance, spread, changed
    shadows = _shadows(samples, levels, params)
    return Background(levels, seen, activity, shadows, len(samples), params.range_share)


# exposure -------------------------------------------------------------------------------------------------------------


def _exposures(samples: Sequence[Sample], params: BackgroundParams) -> list[Exposure]:
    step = _POINT_STEP_PX
    target, seen = points_of(replace(samples[_reference(samples)], frame_to_reference=np.eye(3)), step)
    found = []
    for sample in samples:
        picture, covered = points_of(sample, step)
        found.append(fit_exposure(picture, target, seen & covered, tile_px=params.gain_tile_px / step))
    return found


def _reference(samples: Sequence[Sample]) -> int:
    off = [float(np.abs(sample.frame_to_reference - np.eye(3)).max()) for sample in samples]
    return int(np.argmin(off)) if min(off) < 1e-9 else 0


# strips ---------------------------------------------------------------------------------------------------------------


def _strips(height: int) -> list[tuple[int, int]]:
    return [(top, min(height, top + STRIP_ROWS)) for top in range(0, height, STRIP_ROWS)]


Strip = tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_]]


def _median_strip(stacks: Stacks, rows: tuple[int, int], params: BackgroundParams) -> Strip:
    """Return colour, temporal spread, share of samples that differ, and whether seen, for the rows top..bottom."""
    stack, covered = stacks.part(rows, (0, stacks.samples[0].pixels.shape[1]))
    count = len(stack)
    middle = ((count - 1) // 2, count // 2)
    padded = stack.copy()
    _pad(padded, covered)
    low, high = take_ranks(padded, middle)
    pixels = low if middle[0] == middle[1] else ((low.astype(np.uint16) + high + 1) >> 1).astype(np.uint8)
    deviation, changed = _deviations(stack, covered, pixels, params.change_levels)
    (spread,) = take_ranks(deviation, (count // _THIRD,))
    fewest = max(1, min(params.fewest_samples, (count + 1) // 2))
    return pixels, spread, changed, covered.sum(axis=0) >= fewest


def _free_busy_places(
    stacks: Stacks,
    strips: Sequence[tuple[int, int]],
    learned: tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]],
    window_px: int,
    params: BackgroundParams,
) -> None:
    """Overwrite colour, spread and share of change where the median is doubtful."""
    pixels, spread, changed = learned
    busy = changed > params.busy_share
    traffic = changed > _LEAST_TRAFFIC / len(stacks.samples)
    traffic &= changed <= _MOST_TRAFFIC
    road = road_nearby(pixels, traffic)
    for (top, bottom), left in product(strips, range(0, busy.shape[1], _BUSY_COLUMNS)):
        at = slice(top, bottom), slice(left, left + _BUSY_COLUMNS)
        if not busy[at].any():
            continue
        near, inside = _tile((top, left), busy[at].shape, busy.shape, window_px)
        stack, covered = stacks.part(*near)
        restless = np.ascontiguousarray(unrest(stack, window_px)[:, *inside])
        stack, covered = np.ascontiguousarray(stack[:, *inside]), np.ascontiguousarray(covered[:, *inside])
        image, scatter, open_, lane = (np.ascontiguousarray(part[at]) for part in (pixels, spread, busy, road))
        replace_busy(image, scatter, stack, covered, restless, open_, lane)
        pixels[at], spread[at] = image, scatter
        _, changed[at] = _deviations(stack, covered, image, params.change_levels)


Range = tuple[int, int]


def _tile(
    corner: tuple[int, int], size: tuple[int, ...], whole: tuple[int, ...], window_px: int
) -> tuple[tuple[Range, Range], tuple[slice, slice]]:
    """Return the rows and columns that windows around the pixels of a tile reach, and where in them the tile lies."""
    node = 1 << GAIN_SHIFT
    margin = -(-(window_px // 2) // node) * node
    first = [max(0, start - margin) for start in corner]
    last = [min(most, start + extent + margin) for start, extent, most in zip(corner, size, whole, strict=True)]
    (top, left), (height, width) = (start - begin for start, begin in zip(corner, first, strict=True)), size
    return ((first[0], last[0]), (first[1], last[1])), (slice(top, top + height), slice(left, left + width))


@njit(cache=True, nogil=True)
def _pad(stack, covered):  # type: ignore[no-untyped-def]
    """Fill what is not covered by 0 and 255 in turn, so that it votes for neither side of the median."""
    for r in range(stack.shape[1]):
        for c in range(stack.shape[2]):
            fill = np.uint8(0)
            for i in range(stack.shape[0]):
                if not covered[i, r, c]:
                    stack[i, r, c, :] = fill
                    fill = np.uint8(255) - fill


@njit(cache=True, nogil=True)
def _deviations(stack, covered, pixels, change):  # type: ignore[no-untyped-def]
    """Largest channel difference of every sample (n, h, w), and the share of samples in which it exceeds *change*."""
    count, height, width = covered.shape
    deviation = np.zeros((count, height, width), np.uint8)
    share = np.zeros((height, width), np.float32)
    for r in range(height):
        for c in range(width):
            seen, changed, fill = 0, 0, np.uint8(255)
            for i in range(count):
                if covered[i, r, c]:
                    largest = np.int64(0)
                    for k in range(3):
                        largest = max(largest, abs(np.int64(stack[i, r, c, k]) - np.int64(pixels[r, c, k])))
                    deviation[i, r, c] = largest
                    seen += 1
                    changed += largest > change
                else:
                    deviation[i, r, c] = fill
                    fill = np.uint8(255) - fill
            if seen > 0:
                share[r, c] = changed / seen
    return deviation, share


# tolerance and shadows ------------------------------------------------------------------------------------------------


def _local_range(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    square = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.subtract(cv2.dilate(grey, square), cv2.erode(grey, square)), np.uint8)


def _tolerance(
    pixels: NDArray[np.uint8], spread: NDArray[np.uint8], seen: NDArray[np.bool_], params: BackgroundParams
) -> NDArray[np.uint8]:
    strips, step = _strips(len(pixels)), _POINT_STEP_PX
    some = [_sigma(spread, strip)[::step, ::step][seen[slice(*strip)][::step, ::step]] for strip in strips]
    # What every pixel shows is noise, which the threshold of the difference already covers.
    noise = np.float32(np.median(np.concatenate(some))) if seen.any() else np.float32(0)
    levels = np.empty(seen.shape, np.uint8)
    for top, bottom in strips:
        above = min(top, 1)
        local_range = _local_range(pixels[top - above : bottom + 1])[above:][: bottom - top]
        # The cap keeps places open that are occupied most of the time: stop lines.
        sigma = np.maximum(_sigma(spread, (top, bottom)) - noise, 0) * np.float32(params.spread_factor)
        sigma = np.minimum(sigma, np.float32(params.spread_limit_levels)) + np.float32(params.range_share) * local_range
        levels[top:bottom] = np.minimum(sigma, _UNSEEN_TOLERANCE - 1).astype(np.uint8)
    levels[~seen] = _UNSEEN_TOLERANCE
    return levels


def _sigma(spread: NDArray[np.uint8], rows: tuple[int, int]) -> NDArray[np.float32]:
    """Return the standard deviation over time, of the 3 x 3 neighbourhood, in the rows top..bottom."""
    above = min(rows[0], 1)
    part = spread[rows[0] - above : rows[1] + 1].astype(np.float32)
    return np.asarray(cv2.blur(part, (3, 3))[above:][: rows[1] - rows[0]] * np.float32(_THIRD_TO_SIGMA), np.float32)


def _shadows(samples: Sequence[Sample], ground: NDArray[np.uint8], params: BackgroundParams) -> Shadows:
    chosen = np.unique(np.linspace(0, len(samples) - 1, _SHADOW_SAMPLES).round().astype(int))

    def differences(band: Band) -> Iterator[Difference]:
        for i in chosen:
            yield subtract(
                samples[i].pixels[:],
                ground,
                samples[i].frame_to_reference,
                threshold=params.change_levels,
                shadow_band=band,
                tile_px=params.gain_tile_px,
            )

    # One at a time: a difference is larger than its frame.
    found = differences(widest_band(params.shadow_ratio_min, params.shadow_ratio_max))
    ratios = [
        darkened_ratios(samples[i].pixels[:], difference, params) for i, difference in zip(chosen, found, strict=True)
    ]
    shadows = Shadows(learn_ratio(np.concatenate(ratios), params))
    if shadows.ratio is None:
        return shadows
    poses = [samples[i].frame_to_reference for i in chosen]
    return Shadows(shadows.ratio, learn_direction(differences(shadows.band), poses))
