"""Reduced images for the coarse pose: small, and free of exposure, cloud shade and vignetting."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

Grey = NDArray[np.uint8]

_NEIGHBOURHOOD_PX = 31
_CONTRAST_FLOOR = 4.0
_WHOLE = np.float32(2**23)
"""From here on float32 has no fractions."""
_PIXELS_PER_SIDE = 2


def green_of(pixels: NDArray[np.uint8]) -> Grey:
    """Return the green channel (H, W) of *pixels* (H, W, 3) RGB: the least noisy one, and nearest to luminance.

    It is a view, for a frame is read at few places only. Raises `ValueError` for anything but 8-bit colour.
    """
    if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype != np.uint8:
        raise ValueError(f"a frame is (H, W, 3) uint8, not {pixels.shape} {pixels.dtype}")
    return pixels[:, :, 1]


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


@njit(cache=True, nogil=True)
def thin(plane, factor):  # type: ignore[no-untyped-def]
    """Return *plane* reduced as by `reduce`, from a few pixels of each block, evenly spread: quick for any layout."""
    step = max(1, factor // _PIXELS_PER_SIDE)
    first, count = (factor - 1 - step * ((factor - 1) // step)) // 2, 1 + (factor - 1) // step
    height, width = plane.shape[0] // factor, plane.shape[1] // factor
    sums = np.empty(width, np.int32)
    reduced = np.empty((height, width), np.uint8)
    for i in range(height):
        sums[:] = count * count // 2
        for row in range(count):
            r = i * factor + first + row * step
            for j in range(width):
                for column in range(count):
                    sums[j] += plane[r, j * factor + first + column * step]
        for j in range(width):
            reduced[i, j] = sums[j] // (count * count)
    return reduced


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
    return np.asarray(_levelled(plane, mean, cv2.blur(cv2.multiply(grey, grey), side)))


@njit(cache=True, nogil=True, error_model="numpy")
def _levelled(plane, mean, mean_square):  # type: ignore[no-untyped-def]
    """Return *plane* (h, w) uint8 levelled by the *mean* and *mean_square* (h, w) float32 around each place."""
    levelled = np.empty(plane.shape, np.uint8)
    for r in range(plane.shape[0]):
        middles, squares, levels, out = mean[r], mean_square[r], plane[r], levelled[r]
        for c in range(plane.shape[1]):
            middle = middles[c]
            variance = squares[c] - middle * middle
            deviation = np.sqrt(variance if variance > 0 else np.float32(0)) + np.float32(_CONTRAST_FLOOR)
            level = abs((np.float32(levels[c]) - middle) * (np.float32(32) / deviation) + np.float32(128))
            # To the nearest whole number, of two the even one.
            level = ((level if level < 255 else np.float32(255)) + _WHOLE) - _WHOLE
            out[c] = np.uint8(level)
    return levelled


def no_data(pixels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return where (H, W) *pixels* (H, W, 3) are a wedge without data: pure black over at least 9 x 9 pixels."""
    black = cv2.inRange(pixels, (0, 0, 0), (0, 0, 0))
    return np.asarray(cv2.morphologyEx(black, cv2.MORPH_OPEN, np.ones((9, 9), np.uint8)) > 0)
