"""The samples of a block laid on each other, a few rows at a time, so that memory is bounded at any size of frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.background.coverage import without_data
from vtrack_batch.background.exposure import GAIN_SHIFT, Exposure, expose
from vtrack_batch.model import homography

STRIP_ROWS = 48
_ROWS_AROUND = 20


class Rows(Protocol):
    """A frame (H, W, 3) uint8 RGB that gives rows when sliced: an array, or one that is kept elsewhere."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows, columns, 3."""

    def __getitem__(self, rows: slice, /) -> NDArray[np.uint8]: ...


@dataclass(frozen=True, eq=False)
class Sample:
    """A frame, its homography to the block's reference frame, and when it was taken, in seconds from any start.

    Few rows of the frame are asked for at a time.
    """

    pixels: Rows
    frame_to_reference: NDArray[np.float64]
    taken_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Stacks:
    """Gives the rows of all samples at the reference's place and exposure, some at a time."""

    samples: Sequence[Sample]
    exposures: Sequence[Exposure]

    def part(self, rows: tuple[int, int], columns: tuple[int, int]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Return the samples' colours (n, 3, h, w) and where each covers the ground (n, h, w): 255, else 0.

        *columns* begin at a whole node of the gain.
        """
        height, width = self.samples[0].pixels.shape[:2]
        size = (columns[1] - columns[0], rows[1] - rows[0])
        stack = np.empty((len(self.samples), 3, size[1], size[0]), np.uint8)
        covered = np.empty((len(self.samples), size[1], size[0]), np.uint8)
        corner = np.array([[1.0, 0.0, columns[0]], [0.0, 1.0, rows[0]], [0.0, 0.0, 1.0]])
        for i, (sample, exposure) in enumerate(zip(self.samples, self.exposures, strict=True)):
            # Four channels are laid in half the time that three take.
            laid = _warp(*_part_below(sample, corner, size), size, cv2.INTER_LINEAR)
            gain = exposure.gain_map(height, width, rows)[:, columns[0] >> GAIN_SHIFT :]
            expose(laid, exposure.levels, gain, rows[0] & ((1 << GAIN_SHIFT) - 1))
            cv2.split(laid, [*stack[i], covered[i]])
            cv2.threshold(covered[i], 254, 255, cv2.THRESH_BINARY, covered[i])
        return stack, covered


def points_of(sample: Sample, step: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the colours at every *step*-th row and column of the reference, and which of these are covered."""
    height, width = (-(-side // step) for side in sample.pixels.shape[:2])
    colours, covered = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.bool_)
    for top in range(0, height, STRIP_ROWS):
        size = (width, min(STRIP_ROWS, height - top))
        grid = np.array([[step, 0.0, 0.0], [0.0, step, step * top], [0.0, 0.0, 1.0]])
        part = _warp(*_part_below(sample, grid, size), size, cv2.INTER_NEAREST)
        rows = slice(top, top + size[1])
        colours[rows], covered[rows] = part[:, :, :3], part[:, :, 3] > 0
    return colours, covered


def _part_below(
    sample: Sample, to_reference: NDArray[np.float64], size: tuple[int, int]
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return the rows of a sample onto which a picture of *size* maps, and how; some more tell wedges there.

    Colours (h, w, 4), the fourth of which says where there are data: 255, else 0.
    """
    to_frame = np.linalg.inv(sample.frame_to_reference) @ to_reference
    rows = homography.apply(to_frame, homography.corners(*size))[:, 1]
    height = sample.pixels.shape[0]
    first = int(np.clip(np.floor(rows.min()) - _ROWS_AROUND, 0, height - 1))
    last = int(np.clip(np.ceil(rows.max()) + _ROWS_AROUND, first + 1, height))
    up = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -first], [0.0, 0.0, 1.0]])
    pixels = np.ascontiguousarray(sample.pixels[first:last])
    below = cv2.cvtColor(pixels, cv2.COLOR_RGB2RGBA)
    missing = without_data(pixels)
    if missing is not None:
        below[:, :, 3] = cv2.bitwise_not(missing)
    return np.asarray(below, np.uint8), np.asarray(up @ to_frame)


def _warp(
    image: NDArray[np.uint8], to_source: NDArray[np.float64], size: tuple[int, int], how: int
) -> NDArray[np.uint8]:
    return np.asarray(cv2.warpPerspective(image, to_source, size, flags=how | cv2.WARP_INVERSE_MAP), np.uint8)
