"""Endless random textures: the value at a place depends on the place and a seed alone, so strips fit together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
_UNIT_SPREAD = 2.33
"""What brings noise that is uniform at the grid's points and smooth between them to unit spread."""


def fractal(shape: tuple[int, int], *, cells_px: Sequence[float], seed: int, first_row: int = 0) -> Float32:
    """Return noise (H, W) float32 of about unit spread: value noise of equal power at each of the *cells_px*.

    Octaves of equal power make a spectrum that falls with the square of the frequency, as that of natural scenes
    (Field 1987, J. Opt. Soc. Am. A 4, 2379). Row 0 is row *first_row* of the endless texture.
    """
    total = np.zeros(shape, np.float32)
    for octave, cell in enumerate(cells_px):
        # grids of incommensurate offsets hide one another's lines
        _octave(total, max(float(cell), 1.0), (octave + 1) * 0.618034, np.uint64(seed * 1009 + octave), first_row)
    return np.asarray(total * np.float32(_UNIT_SPREAD / np.sqrt(max(len(cells_px), 1))), np.float32)


def octaves(px_per_m: float, finest_m: float, coarsest_m: float) -> list[float]:
    """Return cells in pixels from *coarsest_m* down by halves to *finest_m*, none below a pixel."""
    count = max(1, int(np.floor(np.log2(coarsest_m / finest_m))) + 1)
    cells = [coarsest_m / 2**k * px_per_m for k in range(count)]
    return [cell for cell in cells if cell >= 1.0] or [1.0]


@njit(cache=True, nogil=True)
def _chance(i, j, seed):  # type: ignore[no-untyped-def]
    """Return the random number of a grid point, -1 to 1 (an integer hash in the manner of Murmur's finaliser)."""
    h = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) ^ np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F) ^ seed
    h ^= h >> np.uint64(33)
    h *= np.uint64(0xFF51AFD7ED558CCD)
    h ^= h >> np.uint64(33)
    h *= np.uint64(0xC4CEB9FE1A85EC53)
    h ^= h >> np.uint64(33)
    return np.float32((h >> np.uint64(40)) * (2.0 / 16777216.0) - 1.0)


@njit(cache=True, nogil=True)
def _octave(total, cell, offset, seed, first_row):  # type: ignore[no-untyped-def]
    height, width = total.shape
    for row in range(height):
        y = (row + first_row) / cell + offset
        j = int(np.floor(y))
        fy = np.float32(y - j)
        fy = fy * fy * (np.float32(3.0) - np.float32(2.0) * fy)
        at = -1
        left = np.float32(0.0)
        right = np.float32(0.0)
        for col in range(width):
            x = col / cell + offset
            i = int(x)
            if i != at:
                upper, lower = _chance(i, j, seed), _chance(i, j + 1, seed)
                left = upper + fy * (lower - upper)
                upper, lower = _chance(i + 1, j, seed), _chance(i + 1, j + 1, seed)
                right = upper + fy * (lower - upper)
                at = i
            fx = np.float32(x - i)
            fx = fx * fx * (np.float32(3.0) - np.float32(2.0) * fx)
            total[row, col] += left + fx * (right - left)
