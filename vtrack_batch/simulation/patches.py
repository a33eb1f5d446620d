"""Small pictures of what stands above the ground: roofs, walls, bridge decks and tree crowns, kept in one atlas."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation.texture import fractal, octaves

CROWNS = 48
_ROOFS = np.array(
    [(172, 104, 82), (150, 92, 76), (178, 128, 102), (128, 104, 92), (96, 95, 97), (140, 139, 141), (192, 193, 190)],
    float,
)
_ROOF_SHARE = (0.24, 0.14, 0.12, 0.10, 0.16, 0.14, 0.10)
_WALLS = np.array([(196, 188, 172), (206, 202, 194), (172, 158, 140), (150, 120, 104)], float)
_CROWN = np.array([58, 70, 46], float)


@dataclass(frozen=True)
class Atlas:
    """``rgba`` (bytes,) uint8 holds patches one after the other; row i of ``index`` (n, 3) is offset, height, width."""

    rgba: NDArray[np.uint8]
    index: NDArray[np.int64]


class AtlasMaker:
    """Collects patches (H, W, 4) uint8; :meth:`add` returns the number under which a patch is kept."""

    def __init__(self) -> None:
        """Begin with no patch."""
        self._parts: list[NDArray[np.uint8]] = []

    def add(self, rgba: NDArray[np.uint8]) -> int:
        """Keep one patch."""
        self._parts.append(rgba)
        return len(self._parts) - 1

    def atlas(self) -> Atlas:
        """Return all patches."""
        sizes = np.array([part.size for part in self._parts], np.int64)
        shapes = np.array([part.shape[:2] for part in self._parts], np.int64).reshape(-1, 2)
        flat = [part.reshape(-1) for part in self._parts] or [np.zeros(0, np.uint8)]
        return Atlas(np.concatenate(flat), np.column_stack([np.cumsum(sizes) - sizes, shapes]))


def roof(half_m: Array, px_per_m: float, sun: Array, *, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Draw a roof of *half_m* (2,) half sizes, its length along the columns; *sun* (2,) is where the sun stands.

    The local axes are right along the length and up across it. Small roofs have a ridge, large ones are flat.
    """
    half = np.asarray(half_m, float)
    shape = tuple(np.maximum(np.ceil(2 * half[::-1] * px_per_m).astype(int), 4))
    kind = int(rng.choice(len(_ROOFS), p=_ROOF_SHARE))
    flat = bool(half.min() > 9 or rng.random() < 0.2)
    base = (_ROOFS[max(kind, 4)] if flat else _ROOFS[kind]) + rng.normal(0, 9) + rng.normal(0, 3, 3)
    y = np.linspace(1, -1, shape[0])[:, None] * np.ones(shape)
    seed = int(rng.integers(1 << 30))
    tone = 1 + (0.035 if flat else 0.05) * fractal(shape, cells_px=octaves(px_per_m, 0.3, 12.0), seed=seed)
    if not flat:
        tone *= 1 + 0.2 * float(sun[1]) * np.sign(y)
        tone *= 1 - 0.05 * (np.mod(y * half[1] * px_per_m / max(px_per_m * 0.7, 2.0), 1.0) < 0.5)
        tone *= np.where(np.abs(y) < 0.15 / half[1], 0.85, 1.0)
    image = (tone[..., None] * base).astype(np.float32)
    _clutter(image, half, px_per_m, sun, flat, rng)
    _rim(image, 0.25 * px_per_m, 1.12 if flat else 0.9)
    return _soft(image, np.ones(shape, np.float32), px_per_m)


def wall(*, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Draw a wall seen at a glancing angle: plaster with columns of windows, hardly any height."""
    base = _WALLS[rng.integers(len(_WALLS))] + rng.normal(0, 8)
    row = np.repeat((base * (0.96 - 0.26 * (np.arange(48) % 6 < 3)[:, None]))[None], 3, axis=0)
    return _soft(row.astype(np.float32), np.ones((3, 48), np.float32), 1.0)


def deck(half_m: Array, px_per_m: float, *, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Draw the deck of a bridge with its parapets."""
    shape = tuple(np.maximum(np.ceil(2 * np.asarray(half_m)[::-1] * px_per_m).astype(int), 4))
    tone = 1 + 0.04 * fractal(shape, cells_px=octaves(px_per_m, 0.3, 16.0), seed=int(rng.integers(1 << 30)))
    image = (tone[..., None] * np.array([160, 157, 150.0])).astype(np.float32)
    _rim(image, 0.3 * px_per_m, 1.2)
    return _soft(image, np.ones(shape, np.float32), px_per_m)


def crown(radius_px: float, sun: Array, *, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Draw a crown seen from above: lumps of leaves, lit from *sun* (2,) in image axes (right, down)."""
    size = int(2 * np.ceil(radius_px * 1.15)) + 1
    y, x = (np.mgrid[:size, :size] - size // 2) / radius_px
    seed = int(rng.integers(1 << 30))
    angle, far = np.arctan2(y, x), np.hypot(x, y)
    waves = rng.uniform(0.02, 0.09, 5) * np.cos(np.arange(2, 7) * angle[..., None] + rng.uniform(0, 6.3, 5))
    ragged = 0.10 * fractal((size, size), cells_px=[radius_px / 2, radius_px / 4, radius_px / 8], seed=seed)
    edge = 0.92 + waves.sum(axis=-1) + ragged
    height = np.sqrt(np.clip(1.05 - (far / np.maximum(edge, 0.3)) ** 2, 0, 1))
    height += 0.16 * fractal((size, size), cells_px=[radius_px / 2.2, radius_px / 4, radius_px / 9, 1.5], seed=seed + 1)
    slope_y, slope_x = np.gradient(height * radius_px)
    lit = 0.94 - 0.24 * np.clip(slope_x * sun[0] + slope_y * sun[1], -1.6, 1.6) + 0.15 * (height - 0.6)
    base = _CROWN * rng.uniform(0.75, 1.2) * (1 + rng.normal(0, (0.08, 0.04, 0.08)))
    leaves = 1 + 0.10 * fractal((size, size), cells_px=[2.5, 1.3], seed=seed + 2)
    image = (np.clip(lit, 0.35, 1.6) * leaves)[..., None] * base
    alpha = np.clip((edge - far) * radius_px / 1.5 + 0.5, 0, 1)
    return _soft(image.astype(np.float32), alpha.astype(np.float32), 3.0)


def _clutter(
    image: NDArray[np.float32], half: Array, px_per_m: float, sun: Array, flat: bool, rng: np.random.Generator
) -> None:
    """Put chimneys, skylights, ducts and solar panels onto a roof, each with a little shadow."""
    shift = np.round(np.array([-sun[0], sun[1]]) * 0.8 * px_per_m).astype(int)
    for _ in range(int(rng.integers(2, 4 + int(half.prod() / 9)))):
        size = rng.uniform(0.35, 1.1, 2) if not flat else rng.uniform(0.5, 2.2, 2)
        at = rng.uniform(-0.85, 0.85, 2) * half
        low = np.round((at + half - size / 2) * px_per_m).astype(int)
        high = np.maximum(np.round((at + half + size / 2) * px_per_m).astype(int), low + 1)
        raised = rng.random() < 0.6
        if raised:
            spot = image[_within(low + shift, high + shift, image.shape)]
            spot *= np.float32(0.55)
        level = rng.choice([48.0, 84.0, 120.0, 205.0, 226.0]) + rng.normal(0, 10)
        image[_within(low, high, image.shape)] = (level, level, level * 1.02)


def _within(low: NDArray[np.int64], high: NDArray[np.int64], shape: tuple[int, ...]) -> tuple[slice, slice]:
    low, high = np.clip(low, 0, shape[1::-1]), np.clip(high, 0, shape[1::-1])
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _rim(image: NDArray[np.float32], width_px: float, gain: float) -> None:
    k = max(1, round(width_px))
    for side in (image[:k], image[-k:], image[:, :k], image[:, -k:]):
        side *= np.float32(gain)


def _soft(image: NDArray[np.float32], alpha: NDArray[np.float32], px_per_m: float) -> NDArray[np.uint8]:
    """Return the patch with a clear border of one pixel, so that its edges are smooth wherever it is laid."""
    if px_per_m > 2:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.55), np.float32)
    wide = cv2.copyMakeBorder(image, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    clear = cv2.copyMakeBorder(alpha * 255, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    return np.dstack([np.clip(wide + 0.5, 0, 255).astype(np.uint8), np.clip(clear + 0.5, 0, 255).astype(np.uint8)])
