"""Vehicle candidates of one frame: boxes over what differs from the background, weak ones too, with their score."""

from __future__ import annotations

from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.background.coverage import without_data
from vtrack_batch.background.faint import add_faint
from vtrack_batch.background.learn import Background
from vtrack_batch.background.subtract import UNSEEN, Difference, subtract
from vtrack_batch.detection.boxes import Tried, fit_boxes
from vtrack_batch.detection.measure import measure
from vtrack_batch.detection.overlaps import stand_alone
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.detection.refine import refine
from vtrack_batch.detection.templates import draw_templates
from vtrack_batch.model import homography
from vtrack_batch.model.flags import DetectionFlag

_FAINT_REACH_M = 1.2


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidates of one frame, one element each, in the frame's pixels; sorted by row, then column.

    ``col_px``, ``row_px`` centre; ``lx_px``, ``ly_px`` from the centre to the front end, ``wx_px``, ``wy_px`` to the
    side; ``area_px`` pixels inside that differ from the ground; ``red``, ``green``, ``blue`` paint colour at the
    background's exposure; ``contrast`` mean difference from the ground; ``score``; ``flags`` bits of DetectionFlag.
    """

    col_px: NDArray[np.float64]
    row_px: NDArray[np.float64]
    lx_px: NDArray[np.float64]
    ly_px: NDArray[np.float64]
    wx_px: NDArray[np.float64]
    wy_px: NDArray[np.float64]
    area_px: NDArray[np.float64]
    red: NDArray[np.float64]
    green: NDArray[np.float64]
    blue: NDArray[np.float64]
    contrast: NDArray[np.float64]
    score: NDArray[np.float64]
    flags: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.col_px)

    def take(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Candidates:
        """Return the candidates that a mask or an array of indices chooses."""
        return Candidates(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})

    def joined(self, others: Candidates) -> Candidates:
        """Return these candidates and then the *others*."""
        names = [field.name for field in fields(self)]
        return Candidates(**{name: np.concatenate([getattr(self, name), getattr(others, name)]) for name in names})


def find_candidates(
    pixels: NDArray[np.uint8],
    frame_to_reference: NDArray[np.float64],
    background: Background,
    *,
    metres_per_px: tuple[float, float],
    params: DetectionParams,
    tried: Tried | None = None,
) -> Candidates:
    """Fit boxes to what differs from *background* in the frame *pixels* (H, W, 3) uint8 RGB.

    *metres_per_px* = ground distance of the reference's pixels along columns and rows; *tried* tells of places in the
    frame's px which directions are tried there, None = all.
    """
    steps = grid_steps(params, metres_per_px)
    to_frame = _grid_to_frame(steps)
    picture = reduced(pixels, steps)
    px_per_m = _px_per_m(frame_to_reference, pixels.shape, metres_per_px, steps)
    to_ground = np.linalg.inv(to_frame) @ frame_to_reference @ to_frame
    difference = subtract(
        picture,
        background.ground(*steps),
        to_ground,
        threshold=params.threshold_levels,
        shadow_band=background.shadows.band,
        tile_px=params.gain_tile_m * float(np.mean(px_per_m)),
    )
    reach_px = _FAINT_REACH_M * float(np.mean(px_per_m))
    add_faint(difference, picture, threshold=params.faint_levels, reach_px=reach_px)
    missing = without_data(pixels)
    if missing is not None:
        difference.classes[reduced(missing, steps) == 255] = UNSEEN
    shadow = _in_frame(background.shadows.direction, frame_to_reference)
    here = None if tried is None else _through(to_frame, tried)
    return candidates_in(picture, difference, px_per_m=px_per_m, steps=steps, shadow=shadow, params=params, tried=here)


def candidates_in(
    picture: NDArray[np.uint8],
    difference: Difference,
    *,
    px_per_m: tuple[float, float],
    steps: tuple[int, int],
    shadow: tuple[float, float] | None,
    params: DetectionParams,
    tried: Tried | None = None,
) -> Candidates:
    """Fit boxes to a *difference*, however it was made, of the *picture* (h, w, 3) uint8 with *px_per_m* (x, y).

    The picture is the frame reduced by whole *steps* (x, y); *shadow* = unit vector (x, y) towards cast shadows;
    *tried* as in ``fit_boxes``.
    """
    templates = draw_templates(px_per_m, shadow, params)
    boxes = fit_boxes(difference, templates, px_per_m, params, tried)
    axes = templates.half_axes[boxes[:, 2].astype(int), boxes[:, 3].astype(int)]
    placed = np.concatenate([boxes[:, :2], axes], axis=1)
    scale = np.array(px_per_m)
    placed = refine(difference.evidence, difference.classes, placed, scale, params.shadow_evidence)
    order = np.lexsort((placed[:, 0], placed[:, 1]))
    order = order[stand_alone(placed, boxes[:, 4], px_per_m)[order]]
    return _candidates(picture, difference, placed[order], boxes[order, 4], steps)


# the grid -------------------------------------------------------------------------------------------------------------


def grid_steps(params: DetectionParams, metres_per_px: tuple[float, float]) -> tuple[int, int]:
    """Return by how many whole pixels (x, y) frames are reduced to the grid that is worked on."""
    return max(1, round(params.grid_m / metres_per_px[0])), max(1, round(params.grid_m / metres_per_px[1]))


def _grid_to_frame(steps: tuple[int, int]) -> NDArray[np.float64]:
    """Return the map (3, 3) from pixels of the reduced picture to pixels of the frame."""
    return np.array([[steps[0], 0.0, (steps[0] - 1) / 2], [0.0, steps[1], (steps[1] - 1) / 2], [0.0, 0.0, 1.0]])


def reduced(image: NDArray[np.uint8], steps: tuple[int, int]) -> NDArray[np.uint8]:
    """Return *image* averaged over *steps* (x, y) pixels."""
    if steps == (1, 1):
        return np.ascontiguousarray(image)
    width, height = image.shape[1] // steps[0], image.shape[0] // steps[1]
    whole = image[: height * steps[1], : width * steps[0]]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _through(to_frame: NDArray[np.float64], tried: Tried) -> Tried:
    """Return what tells of places of the reduced picture what *tried* tells of the frame's."""
    return lambda places: tried(homography.apply(to_frame, places))


def _px_per_m(
    frame_to_reference: NDArray[np.float64],
    shape: tuple[int, ...],
    metres_per_px: tuple[float, float],
    steps: tuple[int, int],
) -> tuple[float, float]:
    """Return the scale of the reduced picture: the platform may have climbed since the reference frame."""
    middle = np.array([[shape[1] / 2, shape[0] / 2]])
    local = homography.jacobian(frame_to_reference, middle)[0]
    metres = np.hypot(*(local * np.array(metres_per_px)[:, None])) * np.array(steps)
    return float(1 / metres[0]), float(1 / metres[1])


def _in_frame(
    direction: tuple[float, float] | None, frame_to_reference: NDArray[np.float64]
) -> tuple[float, float] | None:
    if direction is None:
        return None
    turned = np.linalg.solve(frame_to_reference[:2, :2], np.array(direction))
    turned /= np.linalg.norm(turned)
    return float(turned[0]), float(turned[1])


# results --------------------------------------------------------------------------------------------------------------


def _candidates(
    picture: NDArray[np.uint8],
    difference: Difference,
    placed: NDArray[np.float64],
    score: NDArray[np.float64],
    steps: tuple[int, int],
) -> Candidates:
    exposure = difference.exposure
    gain = exposure.gain_map(*picture.shape[:2])
    ground, to_ground = difference.ground, difference.to_ground
    found = measure(picture, ground, to_ground, difference.classes, exposure.levels, gain, placed)
    x, y = float(steps[0]), float(steps[1])
    flags = np.where(found[:, 5] > 0, int(DetectionFlag.TOUCHES_BORDER), 0)
    flags |= np.where(found[:, 6] > 0, int(DetectionFlag.NEAR_UNSEEN), 0)
    return Candidates(
        col_px=placed[:, 0] * x + (x - 1) / 2,
        row_px=placed[:, 1] * y + (y - 1) / 2,
        lx_px=placed[:, 2] * x,
        ly_px=placed[:, 3] * y,
        wx_px=placed[:, 4] * x,
        wy_px=placed[:, 5] * y,
        area_px=found[:, 3] * x * y,
        red=found[:, 0],
        green=found[:, 1],
        blue=found[:, 2],
        contrast=found[:, 4],
        score=score,
        flags=flags.astype(np.int32),
    )
