"""Learn the background of a block from samples of its frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.background.coverage import has_data
from vtrack_batch.background.exposure import Exposure, expose, fit_exposure
from vtrack_batch.background.mode import replace_busy, road_nearby
from vtrack_batch.background.params import BackgroundParams
from vtrack_batch.background.ranks import take_ranks
from vtrack_batch.background.shadow import Band, Shadows, darkened_ratios, learn_direction, learn_ratio, widest_band
from vtrack_batch.background.subtract import Difference, subtract

_STRIP_ROWS = 32
_POINT_STEP_PX = 3
_UNSEEN_TOLERANCE = 255
_SHADOW_SAMPLES = 7
_FEWEST_FOR_MODE = 5
_LEAST_TRAFFIC = 1.5
_THIRD = 3
_WHOLLY = 0.999
# A third of the |deviations| of a Gaussian lie below 0.43 standard deviations; of the largest of three, partly
# correlated channels below about 0.7.
_THIRD_TO_SIGMA = 1 / 0.7


@dataclass(frozen=True, eq=False)
class Sample:
    """A frame (H, W, 3) uint8 RGB and its homography to the block's reference frame."""

    pixels: NDArray[np.uint8]
    frame_to_reference: NDArray[np.float64]


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


def learn_background(samples: Sequence[Sample], *, params: BackgroundParams) -> Background:
    """Learn the ground from *samples*, all of one size; the one with the identity as homography is the reference.

    Without such a sample the first gives the exposure. One sample is its own background; two are averaged.

    Raises ValueError if there is no sample or sizes differ.
    """
    if not samples:
        raise ValueError("a background needs at least one sample")
    if len({sample.pixels.shape for sample in samples}) > 1:
        raise ValueError("samples of one background must have one size")
    covered = [has_data(sample.pixels) for sample in samples]
    stacks = _Stacks(samples, covered, _exposures(samples, covered, params))
    strips = _strips(samples[0].pixels.shape[0])
    parts = [_median_strip(stacks, rows, params) for rows in strips]
    pixels, spread, changed, seen = (np.concatenate([part[i] for part in parts]) for i in range(4))
    if len(samples) >= _FEWEST_FOR_MODE:
        _free_busy_places(stacks, strips, (pixels, spread, changed), params)
    tolerance = _tolerance(pixels, spread, seen, params)
    # Half of the neighbourhood, once: a single vehicle that passed through one of the samples counts.
    activity = cv2.blur(changed, (9, 9)) > 0.5 / max(8, len(samples))
    levels = np.dstack([pixels, tolerance])
    shadows = _shadows(samples, levels, params)
    return Background(levels, seen, activity, shadows, len(samples), params.range_share)


# exposure -------------------------------------------------------------------------------------------------------------


def _exposures(
    samples: Sequence[Sample], covered: Sequence[NDArray[np.uint8]], params: BackgroundParams
) -> list[Exposure]:
    reference = _reference(samples)
    step = _POINT_STEP_PX
    target = np.ascontiguousarray(samples[reference].pixels[::step, ::step])
    seen = covered[reference][::step, ::step] > 0
    size = (target.shape[1], target.shape[0])
    found = []
    for sample, mask in zip(samples, covered, strict=True):
        to_frame = np.asarray(np.linalg.inv(sample.frame_to_reference) @ np.diag([step, step, 1.0]), float)
        picture = _warp(sample.pixels, to_frame, size, cv2.INTER_NEAREST)
        usable = seen & (_warp(mask, to_frame, size, cv2.INTER_NEAREST) > 0)
        found.append(fit_exposure(picture, target, usable, tile_px=params.gain_tile_px / step))
    return found


def _reference(samples: Sequence[Sample]) -> int:
    off = [float(np.abs(sample.frame_to_reference - np.eye(3)).max()) for sample in samples]
    return int(np.argmin(off)) if min(off) < 1e-9 else 0


def _warp(
    image: NDArray[np.uint8], to_source: NDArray[np.float64], size: tuple[int, int], how: int
) -> NDArray[np.uint8]:
    return np.asarray(cv2.warpPerspective(image, to_source, size, flags=how | cv2.WARP_INVERSE_MAP), np.uint8)


# strips ---------------------------------------------------------------------------------------------------------------


def _strips(height: int) -> list[tuple[int, int]]:
    return [(top, min(height, top + _STRIP_ROWS)) for top in range(0, height, _STRIP_ROWS)]


Strip = tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_]]


@dataclass(frozen=True, eq=False)
class _Stacks:
    """Gives the rows of all samples at the reference's place and exposure, some at a time."""

    samples: Sequence[Sample]
    masks: Sequence[NDArray[np.uint8]]
    exposures: Sequence[Exposure]

    def rows(self, top: int, bottom: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return the samples' colours (n, h, w, 3) and where each covers the ground (n, h, w)."""
        height, width = self.samples[0].pixels.shape[:2]
        stack = np.empty((len(self.samples), bottom - top, width, 3), np.uint8)
        covered = np.empty(stack.shape[:3], np.bool_)
        down = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
        for i, (sample, mask, exposure) in enumerate(zip(self.samples, self.masks, self.exposures, strict=True)):
            to_frame = np.linalg.inv(sample.frame_to_reference) @ down
            stack[i] = _warp(sample.pixels, to_frame, (width, bottom - top), cv2.INTER_LINEAR)
            covered[i] = _warp(mask, to_frame, (width, bottom - top), cv2.INTER_LINEAR) == 255
            expose(stack[i], exposure.levels, exposure.gain_map(height, width), top)
        return stack, covered


def _median_strip(stacks: _Stacks, rows: tuple[int, int], params: BackgroundParams) -> Strip:
    """Return colour, temporal spread, share of samples that differ, and whether seen, for the rows top..bottom."""
    stack, covered = stacks.rows(*rows)
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
    stacks: _Stacks,
    strips: Sequence[tuple[int, int]],
    learned: tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]],
    params: BackgroundParams,
) -> None:
    """Overwrite colour, spread and share of change where the median is doubtful."""
    pixels, spread, changed = learned
    busy = changed > params.busy_share
    traffic = (changed > _LEAST_TRAFFIC / len(stacks.samples)) & ~(changed > 0.8 * params.busy_share)
    road = road_nearby(pixels, traffic)
    for top, bottom in strips:
        if not busy[top:bottom].any():
            continue
        stack, covered = stacks.rows(top, bottom)
        replace_busy(pixels[top:bottom], stack, covered, busy[top:bottom], road[top:bottom])
        deviation, changed[top:bottom] = _deviations(stack, covered, pixels[top:bottom], params.change_levels)
        (spread[top:bottom],) = take_ranks(deviation, (len(stack) // _THIRD,))


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
    sigma = cv2.blur(spread.astype(np.float32), (3, 3)) * _THIRD_TO_SIGMA
    # What every pixel shows is noise, which the threshold of the difference already covers.
    noise = float(np.median(sigma[seen])) if seen.any() else 0.0
    # The cap keeps places open that are occupied most of the time: stop lines.
    restless = np.minimum(params.spread_factor * np.maximum(0.0, sigma - noise), params.spread_limit_levels)
    levels = params.range_share * _local_range(pixels) + restless
    levels = np.minimum(levels, _UNSEEN_TOLERANCE - 1).astype(np.uint8)
    levels[~seen] = _UNSEEN_TOLERANCE
    return levels


def _shadows(samples: Sequence[Sample], ground: NDArray[np.uint8], params: BackgroundParams) -> Shadows:
    chosen = np.unique(np.linspace(0, len(samples) - 1, _SHADOW_SAMPLES).round().astype(int))

    def differences(band: Band) -> list[Difference]:
        return [
            subtract(
                samples[i].pixels,
                ground,
                samples[i].frame_to_reference,
                threshold=params.change_levels,
                shadow_band=band,
                tile_px=params.gain_tile_px,
            )
            for i in chosen
        ]

    found = differences(widest_band(params.shadow_ratio_min, params.shadow_ratio_max))
    ratios = [darkened_ratios(samples[i].pixels, found[n], params) for n, i in enumerate(chosen)]
    shadows = Shadows(learn_ratio(np.concatenate(ratios), params))
    if shadows.ratio is None:
        return shadows
    poses = [samples[i].frame_to_reference for i in chosen]
    return Shadows(shadows.ratio, learn_direction(differences(shadows.band), poses))
