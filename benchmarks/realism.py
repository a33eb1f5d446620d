"""What gives a rendered frame away: measures of one frame that can be laid beside those of a real one.

Pure: a picture and the boxes of its vehicles in, curves and samples out. All measures are taken of the luminance
(Rec. 601) in grey values of 255 (dn), at the frame's own resolution: compare frames of the same sampling distance.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRADIENT_EDGES_DN = np.concatenate([[0.0], np.geomspace(0.5, 160.0, 26)])
"""Bins of the gradient's magnitude; each is 1.26 times as wide as the one before it."""
LUMINANCE_EDGES_DN = np.linspace(0.0, 256.0, 33)
_TILE_PX = 64
_BLOCK_PX = 8
_FLATTEST = 0.1
_RINGS = 16
# Immerkaer 1996, Computer Vision and Image Understanding 64, 300: blind to planes and straight edges
_NOISE_MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
_AROUND_M = 0.6


def frame_statistics(rgb: NDArray[np.uint8], boxes_px: Array) -> dict[str, Array]:
    """Measure one frame *rgb* (H, W, 3) uint8 with vehicles in *boxes_px* (n, 4): left, top, width, height.

    Returns

    ``gradient_share``      (26,) share of the pixels per bin of GRADIENT_EDGES_DN (dn per pixel)
    ``luminance_share``     (32,) share of the pixels per bin of LUMINANCE_EDGES_DN
    ``saturation_share``    (20,) share of the pixels per bin of HSV saturation, 0 to 1
    ``spectrum_cpp``        (16,) spatial frequency in cycles per pixel
    ``spectrum_power``      (16,) mean power there, dn^2, of tiles of 64 px under a Hann window
    ``noise_dn``            (k,) spread of the high-pass residual in the flattest tenth of blocks of 8 px
    ``contrast_dn``         (n,) luminance of each vehicle's body less that of the ground around it, signed
    ``colour_contrast_dn``  (n,) largest difference of any channel between the two
    ``edge_dn``             (n,) 90th percentile of the gradient within each box

    Raises ``ValueError`` where the frame is smaller than a tile or the arrays have other shapes.
    """
    if rgb.ndim != 3 or rgb.shape[2] != 3 or min(rgb.shape[:2]) < _TILE_PX:
        raise ValueError(f"a frame is (H, W, 3) and at least {_TILE_PX} px wide and high, not {rgb.shape}")
    boxes = np.asarray(boxes_px, float)
    if boxes.ndim != 2 or boxes.shape[1] != 4:
        raise ValueError(f"boxes are (n, 4), not {boxes.shape}")
    grey = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.float32)
    gradient = _gradient(grey)
    saturation = cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)[..., 1] / 255.0
    frequency, power = _spectrum(grey)
    signed, colour, edge = _vehicles(rgb, grey, gradient, boxes)
    return {
        "gradient_share": _shares(gradient, GRADIENT_EDGES_DN),
        "luminance_share": _shares(grey, LUMINANCE_EDGES_DN),
        "saturation_share": _shares(saturation, np.linspace(0, 1.0001, 21)),
        "spectrum_cpp": frequency,
        "spectrum_power": power,
        "noise_dn": _noise(grey, gradient),
        "contrast_dn": signed,
        "colour_contrast_dn": colour,
        "edge_dn": edge,
    }


def distance(first: Array, second: Array) -> float:
    """Return how far two samples lie apart: the greatest difference of their distribution functions, 0 to 1."""
    if len(first) == 0 or len(second) == 0:
        raise ValueError("an empty sample has no distribution")
    at = np.concatenate([first, second])
    below = [np.searchsorted(np.sort(sample), at, side="right") / len(sample) for sample in (first, second)]
    return float(np.abs(below[0] - below[1]).max())


def share_distance(first: Array, second: Array) -> float:
    """Return the same for two histograms over the same bins."""
    return float(np.abs(np.cumsum(first) - np.cumsum(second)).max())


def _gradient(grey: NDArray[np.float32]) -> NDArray[np.float32]:
    across, down = (cv2.Sobel(grey, cv2.CV_32F, dx, 1 - dx, ksize=3, scale=0.125) for dx in (1, 0))
    return np.asarray(np.hypot(across, down), np.float32)


def _shares(values: NDArray[np.float32], edges: Array) -> Array:
    count = np.histogram(np.minimum(values, edges[-1]), edges)[0]
    return np.asarray(count / count.sum())


def _tiles(image: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """Cut the *image* into whole squares (n, size, size)."""
    rows, cols = image.shape[0] // size, image.shape[1] // size
    cut = image[: rows * size, : cols * size].reshape(rows, size, cols, size)
    return np.asarray(cut.transpose(0, 2, 1, 3).reshape(-1, size, size))


def _noise(grey: NDArray[np.float32], gradient: NDArray[np.float32]) -> Array:
    """Return the spread of the residual per flat block; blocks cut off at black or white say nothing and are left out.

    Flat is judged on the smoothed gradient, so that the choice does not favour blocks of little noise.
    """
    residual = np.asarray(cv2.filter2D(grey, cv2.CV_32F, _NOISE_MASK))
    smooth = _gradient(np.asarray(cv2.GaussianBlur(grey, (0, 0), 2.5), np.float32))
    level, slope = _tiles(grey, _BLOCK_PX).mean(axis=(1, 2)), _tiles(smooth, _BLOCK_PX).max(axis=(1, 2))
    spread = _tiles(residual, _BLOCK_PX).std(axis=(1, 2))
    usable = (level > 12) & (level < 243) & (_tiles(gradient, _BLOCK_PX).max(axis=(1, 2)) > 0)
    if not usable.any():
        return np.zeros(0)
    flat = slope <= np.quantile(slope[usable], _FLATTEST)
    return np.asarray(spread[usable & flat], np.float64)


def _spectrum(grey: NDArray[np.float32]) -> tuple[Array, Array]:
    tiles = _tiles(grey, _TILE_PX)
    window = np.outer(np.hanning(_TILE_PX), np.hanning(_TILE_PX)).astype(np.float32)
    waves = np.fft.rfft2((tiles - tiles.mean(axis=(1, 2), keepdims=True)) * window)
    power = (np.abs(waves) ** 2).mean(axis=0) / (window**2).sum()
    radius = np.hypot(np.fft.fftfreq(_TILE_PX)[:, None], np.fft.rfftfreq(_TILE_PX)[None, :])
    ring = np.floor(radius * 2 * _RINGS).astype(int)
    inside = (radius > 0) & (ring < _RINGS)
    count = np.bincount(ring[inside], minlength=_RINGS)
    return (np.arange(_RINGS) + 0.5) / (2 * _RINGS), np.bincount(ring[inside], power[inside], _RINGS) / count


def _vehicles(
    rgb: NDArray[np.uint8], grey: NDArray[np.float32], gradient: NDArray[np.float32], boxes: Array
) -> tuple[Array, Array, Array]:
    """Return signed contrast, colour contrast and edge strength per box; NaN where nothing of it is in view."""
    result = np.full((3, len(boxes)), np.nan)
    taken = np.zeros(grey.shape, bool)
    for box in boxes:
        taken[_window(box, 1.0, grey.shape)] = True
    for k, box in enumerate(boxes):
        inner, outer = _window(box, 0.7, grey.shape), _window(box, 1.0 + _AROUND_M, grey.shape)
        ground = ~taken[outer]
        if grey[inner].size < 4 or ground.sum() < 8:
            continue
        body, beside = rgb[inner].reshape(-1, 3), rgb[outer][ground]
        result[0, k] = grey[inner].mean() - np.median(grey[outer][ground])
        result[1, k] = np.abs(body.mean(axis=0) - np.median(beside, axis=0)).max()
        result[2, k] = np.quantile(gradient[_window(box, 1.0, grey.shape)], 0.9)
    return result[0], result[1], result[2]


def _window(box: Array, scale: float, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns of a box (left, top, width, height) made *scale* times as large, cut to the frame."""
    left, top, width, height = box
    half, middle = np.array([height, width]) * scale / 2, np.array([top + height / 2, left + width / 2])
    low = np.clip(np.floor(middle - half).astype(int), 0, shape[:2])
    high = np.clip(np.ceil(middle + half).astype(int), 0, shape[:2])
    return slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))
