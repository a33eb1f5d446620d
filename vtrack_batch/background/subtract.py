"""The difference of one frame from the background, as evidence and a class for every pixel.

The frame itself is never resampled: the background is looked up at the pixel to which the frame's pixel maps.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.background.exposure import GAIN_SHIFT, Exposure, fit_exposure

GROUND, OBJECT, SHADOW, UNSEEN = 0, 1, 2, 3
"""Classes of pixels: like the ground, different from it, darker like ground in cast shadow, no ground known there."""

FULL = 100
"""Evidence of a pixel that surely differs."""

_UNSEEN = 255
_POINT_STEP_PX = 3
_POINTS_PER_TILE_SIDE = 12
_POINTS = 50_000
_DARKEST_LEVEL = 24


@dataclass(frozen=True, eq=False)
class Difference:
    """One frame against the background: everything (H, W) in the pixels of that frame.

    ``evidence`` uint8 0..100 that something lies on the ground; ``classes`` uint8, see ``GROUND`` ... ``UNSEEN``;
    ``exposure`` takes the frame's levels to the background's; ``ground`` (H, W, 3) uint8 the background as seen there.
    """

    evidence: NDArray[np.uint8]
    classes: NDArray[np.uint8]
    exposure: Exposure
    ground: NDArray[np.uint8]


def subtract(
    frame: NDArray[np.uint8],
    ground: NDArray[np.uint8],
    frame_to_ground_px: NDArray[np.float64],
    *,
    threshold: float,
    shadow_band: NDArray[np.float64],
    tile_px: float,
) -> Difference:
    """Compare *frame* (H, W, 3) with *ground* (h, w, 4) uint8: colour and tolerance, tolerance 255 = unseen.

    *threshold* in grey levels gives half evidence; *shadow_band* (3, 2) = lowest and highest ratio of a cast
    shadow per channel; *tile_px* = distance of the nodes of the exposure's gain.
    """
    height, width = frame.shape[:2]
    seen = np.asarray(
        cv2.warpPerspective(
            ground,
            frame_to_ground_px,
            (width, height),
            flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=(0, 0, 0, _UNSEEN),
        ),
        np.uint8,
    )
    step = _point_step(height * width, tile_px)
    points = seen[::step, ::step]
    picture, target = np.ascontiguousarray(frame[::step, ::step]), np.ascontiguousarray(points[:, :, :3])
    exposure = fit_exposure(picture, target, points[:, :, 3] < _UNSEEN, tile_px=tile_px / step)
    evidence, classes = np.zeros((height, width), np.uint8), np.zeros((height, width), np.uint8)
    _classify(frame, seen, exposure.levels, exposure.gain_map(height, width), threshold, shadow_band, evidence, classes)
    return Difference(evidence, classes, exposure, seen)


def _point_step(pixels: int, tile_px: float) -> int:
    """Return the distance of the points from which the exposure is told: many in all, and some in every tile."""
    return max(_POINT_STEP_PX, min(round(tile_px / _POINTS_PER_TILE_SIDE), int((pixels / _POINTS) ** 0.5)))


@njit(cache=True, nogil=True)
def _classify(frame, ground, levels, gain, threshold, shadow, evidence, classes):  # type: ignore[no-untyped-def]
    """Fill *evidence* and *classes*, both zero before."""
    for r in range(frame.shape[0]):
        gains = gain[r >> GAIN_SHIFT]
        for c in range(frame.shape[1]):
            tolerance = ground[r, c, 3]
            if tolerance == _UNSEEN:
                classes[r, c] = UNSEEN
                continue
            g = gains[c >> GAIN_SHIFT]
            red = abs(levels[0, frame[r, c, 0]] * g - ground[r, c, 0])
            green = abs(levels[1, frame[r, c, 1]] * g - ground[r, c, 1])
            blue = abs(levels[2, frame[r, c, 2]] * g - ground[r, c, 2])
            strength = (max(red, green, blue) - tolerance) / threshold - 0.5
            # Most pixels show the ground: nothing more is asked of them.
            if strength > 0.0:
                evidence[r, c] = int(min(strength, 1.0) * FULL)
                classes[r, c] = SHADOW if _is_shaded(frame[r, c], ground[r, c], levels, g, shadow) else OBJECT


@njit(cache=True, nogil=True)
def _is_shaded(colour, ground, levels, gain, shadow):  # type: ignore[no-untyped-def]
    """Whether the ratio to the ground is that of a cast shadow in all channels, on ground light enough to tell."""
    brightest = 0.0
    for k in range(3):
        level, expected = levels[k, colour[k]] * gain, float(ground[k])
        ratio = (level + 2.0) / (expected + 2.0)
        if not shadow[k, 0] <= ratio <= shadow[k, 1]:
            return False
        brightest = max(brightest, expected)
    return brightest >= _DARKEST_LEVEL
