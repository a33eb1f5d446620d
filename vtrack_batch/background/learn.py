"""Learn the background of a block from samples of its frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.background.exposure import Exposure, expose, fit_exposure
from vtrack_batch.background.mode import Road, replace_busy, road_nearby, unrest
from vtrack_batch.background.params import BackgroundParams
from vtrack_batch.background.planes import deviations, padded
from vtrack_batch.background.shadow import Band, Shadows, darkened_ratios, learn_direction, learn_ratio, widest_band
from vtrack_batch.background.stacks import STRIP_ROWS, Sample, Stacks, points_of
from vtrack_batch.background.subtract import Difference, subtract
from vtrack_batch.model.ranks import take_ranks

_BUSY_COLUMNS = 256
_POINT_STEP_PX = 3
UNSEEN_TOLERANCE = 255
_SHADOW_SAMPLES, _FEWEST_SHADOW_SAMPLES, _SHADOW_PIXELS = 7, 3, 60_000_000
_WIDEST_STEP_PX, _POINTS = 8, 230_000
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
    ``shadows`` how cast shadows look; ``samples`` = how many were used; ``range_share`` as in ``BackgroundParams``.
    """

    levels: NDArray[np.uint8]
    shadows: Shadows
    samples: int
    range_share: float
    _coarser: dict[tuple[int, int], NDArray[np.uint8]] = field(default_factory=dict, init=False, repr=False)

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """The colour of the ground (H, W, 3) uint8."""
        return np.ascontiguousarray(self.levels[:, :, :3])

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Where (H, W) bool the ground is known."""
        return np.asarray(self.levels[:, :, 3] < UNSEEN_TOLERANCE)

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
        height, width = self.levels.shape[:2]
        size = (width // step_x, height // step_y)
        rows, columns = size[1] * step_y, size[0] * step_x
        coarse = cv2.resize(self.levels[:rows, :columns], size, interpolation=cv2.INTER_AREA)
        seen = cv2.resize(self.seen[:rows, :columns].astype(np.float32), size, interpolation=cv2.INTER_AREA) > _WHOLLY
        # The local range grows with the distance of the pixels.
        local = self.range_share * _local_range(np.ascontiguousarray(coarse[:, :, :3]))
        tolerance = np.minimum(np.maximum(coarse[:, :, 3], local), UNSEEN_TOLERANCE - 1)
        coarse[:, :, 3] = np.where(seen, tolerance, UNSEEN_TOLERANCE)
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
    height, width = samples[0].pixels.shape[:2]
    exposures, road = _exposures(samples, params)
    window_px = 2 * max(1, round(params.calm_window_m / metres_per_px / 2)) + 1
    stacks = Stacks(samples, exposures)
    levels, seen = np.empty((height, width, 4), np.uint8), np.empty((height, width), np.bool_)
    spread = np.empty((height, width), np.uint8)
    for top, bottom in _strips(height):
        at, around = slice(top, bottom), window_px // 2 if road is not None else 0
        first = max(0, top - around)
        stack = stacks.part((first, min(height, bottom + around)), (0, width))
        inner = slice(top - first, bottom - first)
        strip = _median_strip((stack[0][:, :, inner], stack[1][:, inner]), params)
        if road is not None:
            _free_busy_places(strip, stack, (first, inner), road, window_px, params)
        levels[at, :, :3], spread[at], seen[at] = strip.pixels, strip.spread, strip.seen
    _set_tolerance(levels, spread, seen, params)
    del spread, seen
    return Background(levels, _shadows(samples, levels, params), len(samples), params.range_share)


Layers = tuple[NDArray[np.uint8], NDArray[np.uint8]]
"""Colours of samples (n, 3, h, w), and where each covers the ground (n, h, w): 255, else 0."""


# exposure -------------------------------------------------------------------------------------------------------------


def _exposures(samples: Sequence[Sample], params: BackgroundParams) -> tuple[list[Exposure], Road | None]:
    """Return the exposure of every sample, and the colours of roads; None of too few samples for the mode."""
    height, width = samples[0].pixels.shape[:2]
    step = max(_POINT_STEP_PX, min(_WIDEST_STEP_PX, int((height * width / _POINTS) ** 0.5)))
    target, seen = points_of(replace(samples[_reference(samples)], frame_to_reference=np.eye(3)), step)
    exposures, size = list[Exposure](), (len(samples), *seen.shape)
    stack, covered = np.empty((size[0], 3, *size[1:]), np.uint8), np.empty(size, np.uint8)
    for sample, planes, there in zip(samples, stack, covered, strict=True):
        picture, shown = points_of(sample, step)
        exposures.append(fit_exposure(picture, target, seen & shown, tile_px=params.gain_tile_px / step))
        expose(picture, exposures[-1].levels, exposures[-1].gain_map(*seen.shape), 0)
        cv2.split(picture, list(planes))
        there[:] = np.where(shown, 255, 0)
    if len(samples) < _FEWEST_FOR_MODE:
        return exposures, None
    found = _median_strip((stack, covered), params)
    traffic = (found.changed > _LEAST_TRAFFIC / len(samples)) & (found.changed <= _MOST_TRAFFIC)
    return exposures, road_nearby(found.pixels, traffic, step=step, size=(height, width))


def _reference(samples: Sequence[Sample]) -> int:
    off = [float(np.abs(sample.frame_to_reference - np.eye(3)).max()) for sample in samples]
    return int(np.argmin(off)) if min(off) < 1e-9 else 0


# strips ---------------------------------------------------------------------------------------------------------------


def _strips(height: int) -> list[tuple[int, int]]:
    return [(top, min(height, top + STRIP_ROWS)) for top in range(0, height, STRIP_ROWS)]


@dataclass(frozen=True, eq=False)
class _Strip:
    """Some rows: ``pixels`` (h, w, 3), ``spread`` over time, share ``changed`` of samples that differ, ``seen``."""

    pixels: NDArray[np.uint8]
    spread: NDArray[np.uint8]
    changed: NDArray[np.float32]
    seen: NDArray[np.bool_]


def _median_strip(layers: Layers, params: BackgroundParams) -> _Strip:
    """Return what the median of *layers* tells."""
    (stack, covered), count = layers, len(layers[0])
    middle = ((count - 1) // 2, count // 2)
    low, high = take_ranks(padded(stack, covered), middle)
    planes = low if middle[0] == middle[1] else ((low.astype(np.uint16) + high + 1) >> 1).astype(np.uint8)
    deviation, changed, seen = deviations(stack, covered, planes, params.change_levels)
    (spread,) = take_ranks(deviation, (count // _THIRD,))
    fewest = max(1, min(params.fewest_samples, (count + 1) // 2))
    return _Strip(np.asarray(cv2.merge(list(planes)), np.uint8), spread, changed, seen >= fewest)


def _free_busy_places(
    strip: _Strip,
    around: Layers,
    place: tuple[int, slice],
    road: Road,
    window_px: int,
    params: BackgroundParams,
) -> None:
    """Overwrite what *strip* says where its median is doubtful.

    Its *place*: the frame's row at which the layers *around* begin, and which of their rows it is.
    """
    top, inner = place
    busy, width, reach = strip.changed > params.busy_share, strip.changed.shape[1], window_px // 2
    for left, right in _runs(busy):
        first, at = max(0, left - reach), (slice(None), slice(left, right))
        restless = unrest(around[0][..., first : min(width, right + reach)], window_px)
        stack, covered = around[0][:, :, inner, left:right], around[1][:, inner, left:right]
        restless = restless[:, inner, left - first :][..., : right - left]
        image, scatter, open_ = (np.ascontiguousarray(part[at]) for part in (strip.pixels, strip.spread, busy))
        lane = road.part((top + inner.start, top + inner.stop), (left, right))
        replace_busy(image, scatter, stack, covered, restless, open_, lane)
        strip.pixels[at], strip.spread[at] = image, scatter


def _runs(busy: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return from where to where columns hold anything *busy* (h, w), in whole tiles."""
    edges = np.arange(0, busy.shape[1], _BUSY_COLUMNS)
    held = np.r_[False, np.logical_or.reduceat(busy.any(axis=0), edges), False]
    bounds = np.r_[edges, busy.shape[1]]
    first, last = np.flatnonzero(held[1:] & ~held[:-1]), np.flatnonzero(held[:-1] & ~held[1:])
    return list(zip(bounds[first].tolist(), bounds[last].tolist(), strict=True))


# tolerance and shadows ------------------------------------------------------------------------------------------------


def _local_range(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    square = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.subtract(cv2.dilate(grey, square), cv2.erode(grey, square)), np.uint8)


def _set_tolerance(
    levels: NDArray[np.uint8], spread: NDArray[np.uint8], seen: NDArray[np.bool_], params: BackgroundParams
) -> None:
    """Fill in the fourth of *levels* (H, W, 4), the first three of which are colours."""
    strips, step = _strips(len(levels)), _POINT_STEP_PX
    some = [_sigma(spread, strip)[::step, ::step][seen[slice(*strip)][::step, ::step]] for strip in strips]
    # What every pixel shows is noise, which the threshold of the difference already covers.
    noise = np.float32(np.median(np.concatenate(some))) if seen.any() else np.float32(0)
    for top, bottom in strips:
        above = min(top, 1)
        colours = np.ascontiguousarray(levels[top - above : bottom + 1, :, :3])
        local_range = _local_range(colours)[above:][: bottom - top]
        # The cap keeps places open that are occupied most of the time: stop lines.
        sigma = np.maximum(_sigma(spread, (top, bottom)) - noise, 0) * np.float32(params.spread_factor)
        sigma = np.minimum(sigma, np.float32(params.spread_limit_levels)) + np.float32(params.range_share) * local_range
        tolerance = np.minimum(sigma, UNSEEN_TOLERANCE - 1)
        levels[top:bottom, :, 3] = np.where(seen[top:bottom], tolerance, UNSEEN_TOLERANCE)


def _sigma(spread: NDArray[np.uint8], rows: tuple[int, int]) -> NDArray[np.float32]:
    """Return the standard deviation over time, of the 3 x 3 neighbourhood, in the rows top..bottom."""
    above = min(rows[0], 1)
    part = spread[rows[0] - above : rows[1] + 1].astype(np.float32)
    return np.asarray(cv2.blur(part, (3, 3))[above:][: rows[1] - rows[0]] * np.float32(_THIRD_TO_SIGMA), np.float32)


def _shadows(samples: Sequence[Sample], ground: NDArray[np.uint8], params: BackgroundParams) -> Shadows:
    most = max(_FEWEST_SHADOW_SAMPLES, min(_SHADOW_SAMPLES, _SHADOW_PIXELS // (ground.shape[0] * ground.shape[1])))
    chosen = [samples[i] for i in np.unique(np.linspace(0, len(samples) - 1, most).round().astype(int))]

    # One at a time: a difference is larger than its frame.
    def seen(sample: Sample, band: Band) -> tuple[NDArray[np.uint8], Difference]:
        pixels, tile_px = sample.pixels[:], float(params.gain_tile_px)
        by = sample.frame_to_reference
        return pixels, subtract(pixels, ground, by, threshold=params.change_levels, shadow_band=band, tile_px=tile_px)

    widest = widest_band(params.shadow_ratio_min, params.shadow_ratio_max)
    ratios = [darkened_ratios(*seen(sample, widest), params) for sample in chosen]
    shadows = Shadows(learn_ratio(np.concatenate(ratios), params))
    if shadows.ratio is None:
        return shadows
    differences = (seen(sample, shadows.band)[1] for sample in chosen)
    return Shadows(shadows.ratio, learn_direction(differences, [sample.frame_to_reference for sample in chosen]))
