"""Reduced images for the coarse pose: small, and free of exposure, cloud shade and vignetting."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.uint8]

_NEIGHBOURHOOD_PX = 31
_CONTRAST_FLOOR = 4.0


def green_plane(pixels: NDArray[np.uint8]) -> Grey:
    """Return the green channel (H, W) of *pixels* (H, W, 3) RGB: the least noisy one, and nearest to luminance.

    Raises `ValueError` for anything but 8-bit colour.
    """
    if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8:
        raise ValueError(f"a frame is (H, W, 3) uint8, not {pixels.shape} {pixels.dtype}")
    return np.asarray(cv2.extractChannel(pixels, 1))


def reduction_factor(shape: tuple[int, int], target_pixels: int) -> int:
    """Return the whole number by which an image of *shape* is divided to hold about *target_pixels*."""
    return max(1, round((shape[0] * shape[1] / target_pixels) ** 0.5))


def reduce(plane: Grey, factor: int) -> Grey:
    """Return *plane* averaged over blocks of *factor* x *factor* pixels; rows and columns left over are cut off."""
    height, width = (side // factor for side in plane.shape)
    if factor == 1:
        return plane
    return np.asarray(
        cv2.resize(plane[: height * factor, : width * factor], (width, height), interpolation=cv2.INTER_AREA)
    )


def to_reduced(factor: int) -> NDArray[np.float64]:
    """Return the map (3, 3) from full to reduced pixel coordinates: (x + 0.5) / factor - 0.5, because 0 is a centre."""
    shift = (1 - factor) / (2 * factor)
    return np.array([[1 / factor, 0, shift], [0, 1 / factor, shift], [0, 0, 1]])


def level_contrast(plane: Grey) -> Grey:
    """Return *plane* with its local mean moved to 128 and its local standard deviation to 32, saturating.

    Optical flow assumes that brightness is conserved; this makes it so under drifting exposure and cloud shade.
    """
    grey = plane.astype(np.float32)
    side = (_NEIGHBOURHOOD_PX, _NEIGHBOURHOOD_PX)
    mean = cv2.blur(grey, side)
    variance = cv2.blur(grey * grey, side) - mean * mean
    deviation = np.sqrt(np.maximum(variance, 0)) + _CONTRAST_FLOOR
    return np.asarray(cv2.convertScaleAbs((grey - mean) * (32 / deviation) + 128))


def no_data(pixels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return where (H, W) *pixels* (H, W, 3) are a wedge without data: pure black over at least 9 x 9 pixels."""
    black = cv2.inRange(pixels, (0, 0, 0), (0, 0, 0))
    return np.asarray(cv2.morphologyEx(black, cv2.MORPH_OPEN, np.ones((9, 9), np.uint8)) > 0)
