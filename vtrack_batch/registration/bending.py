"""Where a frame bends away from its plane pose: parallax and cut-outs of ortho-images move every house its own way.

All frames of a block are laid on one picture of the ground, the median of several of them, and what is left of the
motion is told by a dense optical flow (DIS, Kroeger et al. 2016) from there, levelled in contrast. A wide median over
the flow keeps what many neighbours agree on: a vehicle fills less than half of the window, so it is not drawn onto the
place where the picture shows it, or another one. Frames are then straightened once, and nothing else need know.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.model import homography
from vtrack_batch.model.homography import Array
from vtrack_batch.model.ranks import take_ranks
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.pose import distances, robust_rms
from vtrack_batch.registration.reduction import Grey, green_of, level_contrast, reduce, to_reduced

CELL_PX = 8
"""Pixels of a frame are moved in squares of this side."""

_FACTOR = 2
_FINEST_SCALE = 1
_ITERATIONS = 6
_STEPS_PER_PX = 16
_STRIP_ROWS = 64
_SMALLEST_PX = 128


@dataclass(frozen=True, eq=False)
class Bend:
    """What a frame's pixels must be moved by: ``shift_px`` (rows, columns, 2) float32 (x, y), one for each cell.

    The straightened frame shows at p what the frame as taken shows at p + shift.
    """

    shift_px: NDArray[np.float32]

    def to_frame(self, straight_px: Array) -> Array:
        """Return where points (n, 2) of the straightened frame lie in the frame as taken."""
        return np.asarray(straight_px + self._at(straight_px))

    def to_straight(self, frame_px: Array) -> Array:
        """Return where points (n, 2) of the frame as taken lie in the straightened one."""
        guess = frame_px - self._at(frame_px)
        return np.asarray(frame_px - self._at(guess))

    def _at(self, points_px: Array) -> Array:
        rows, columns = self.shift_px.shape[:2]
        cell = ((points_px + 0.5) / CELL_PX - 0.5).clip(0, [columns - 1, rows - 1])
        low = np.minimum(cell.astype(np.int64), np.maximum([columns - 2, rows - 2], 0))
        (x, y), (u, v) = low.T, (cell - low).T[:, :, None]
        right, below = np.minimum(x + 1, columns - 1), np.minimum(y + 1, rows - 1)
        upper = (1 - u) * self.shift_px[y, x] + u * self.shift_px[y, right]
        return np.asarray((1 - v) * upper + v * ((1 - u) * self.shift_px[below, x] + u * self.shift_px[below, right]))


def common_picture(frames: Iterable[tuple[NDArray[np.uint8], Array]]) -> Grey:
    """Return the median (h, w) of *frames*, pixels (H, W, 3) and poses (3, 3), on the grid of the first, reduced.

    The first is the reference: its pose is the identity. Of all frames small grey pictures are held at a time.
    """
    looks: list[Grey] = []
    for pixels, pose in frames:
        look = _look(pixels)
        # What a frame does not show, the reference does.
        beside = looks[0] if looks else look
        looks.append(_laid(look, pose, beside.copy(), cv2.BORDER_TRANSPARENT))
    picture = np.empty_like(looks[0])
    middle = (len(looks) - 1) // 2, len(looks) // 2
    for top in range(0, len(picture), _STRIP_ROWS):
        rows = slice(top, top + _STRIP_ROWS)
        low, high = take_ranks(np.stack([look[rows] for look in looks]), middle)
        picture[rows] = (low & high) + ((low ^ high) >> 1)  # their mean, in bytes
    return picture


def find_bend(pixels: NDArray[np.uint8], pose: Array, picture: Grey, *, params: RegistrationParams) -> Bend:
    """Return how the frame *pixels* (H, W, 3) with *pose* (3, 3) bends away from *picture*.

    A frame too small to tell is not bent.
    """
    cells = max(1, pixels.shape[0] // CELL_PX), max(1, pixels.shape[1] // CELL_PX)
    if min(pixels.shape[:2]) < _SMALLEST_PX:
        return Bend(np.zeros((*cells, 2), np.float32))
    look = _laid(_look(pixels), pose, np.empty_like(picture), cv2.BORDER_REPLICATE)
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    search.setFinestScale(_FINEST_SCALE)
    search.setGradientDescentIterations(_ITERATIONS)
    search.setVariationalRefinementIterations(0)
    search.setUseMeanNormalization(False)  # contrast is level
    flow: NDArray[np.float32] = np.zeros((*look.shape, 2), np.float32)
    search.calc(picture, look, flow)
    return Bend(_in_frame(_smooth(flow, params), pose, cells))


def straighten(pixels: NDArray[np.uint8], bend: Bend) -> NDArray[np.uint8]:
    """Return the frame *pixels* (H, W, 3) with the *bend* taken out, bilinearly, cell by cell."""
    steps = np.rint(bend.shift_px * _STEPS_PER_PX).astype(np.int32)
    straight = np.empty_like(pixels)
    _straighten(np.ascontiguousarray(pixels), steps, straight)
    return straight


def residual_px(patches_px: Array, centres_px: Array, pose: Array, bend: Bend | None) -> float:
    """Return the robust root mean square distance at patches that a frame shows at *patches_px* (m, 2), NaN = nowhere.

    They belong at *centres_px* (m, 2) of the reference; *pose* (3, 3) takes the frame there, straightened if it bends.
    """
    found = np.isfinite(patches_px).all(axis=1)
    seen = patches_px[found] if bend is None else bend.to_straight(patches_px[found])
    return robust_rms(distances(pose, seen, centres_px[found]))


def _look(pixels: NDArray[np.uint8]) -> Grey:
    return level_contrast(reduce(np.ascontiguousarray(green_of(pixels)), _FACTOR))


def _laid(look: Grey, pose: Array, there: Grey, border: int) -> Grey:
    """Return *look* of a frame where *pose* (3, 3, full pixels) puts it on *there*, which is overwritten."""
    down = to_reduced(_FACTOR)
    matrix, size = down @ pose @ np.linalg.inv(down), (there.shape[1], there.shape[0])
    return np.asarray(cv2.warpPerspective(look, matrix, size, there, flags=cv2.INTER_LINEAR, borderMode=border))


def _smooth(flow: NDArray[np.float32], params: RegistrationParams) -> NDArray[np.float32]:
    """Return the median of *flow* over the window around each cell, in full pixels."""
    rows, columns = (side * _FACTOR // CELL_PX for side in flow.shape[:2])
    side = CELL_PX // _FACTOR
    mean = cv2.resize(flow[: rows * side, : columns * side], (columns, rows), interpolation=cv2.INTER_AREA)
    window = 2 * (params.bend_window_px // (2 * CELL_PX)) + 1
    most = params.max_bend_px
    # Medians of large windows are quick for bytes: sixteenths of a pixel are fine enough.
    levels = np.rint(np.clip(mean * _FACTOR, -most, most) * _STEPS_PER_PX + 128).astype(np.uint8)
    middle = np.dstack([cv2.medianBlur(np.ascontiguousarray(part), window) for part in cv2.split(levels)])
    return np.asarray(cv2.blur((middle.astype(np.float32) - 128) / _STEPS_PER_PX, (3, 3)))


def _in_frame(shift: NDArray[np.float32], pose: Array, cells: tuple[int, int]) -> NDArray[np.float32]:
    """Return *shift*, found on the reference's grid, for the *cells* (rows, columns) of the frame, in its pixels."""
    down = to_reduced(CELL_PX)
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    matrix = down @ pose @ np.linalg.inv(down)
    there = cv2.warpPerspective(shift, matrix, (cells[1], cells[0]), flags=how, borderMode=cv2.BORDER_REPLICATE)
    middle = np.array([[CELL_PX * cells[1] / 2, CELL_PX * cells[0] / 2]])
    turn = np.linalg.inv(homography.jacobian(pose, middle)[0])
    return np.ascontiguousarray(there @ turn.T, np.float32)


@njit(cache=True, nogil=True)
def _straighten(pixels, steps, straight):  # type: ignore[no-untyped-def]
    """Fill *straight* with *pixels* moved by *steps* (rows, columns, 2) int32 sixteenths of a pixel."""
    height, width = pixels.shape[:2]
    flat, out = pixels.reshape(height, 3 * width), straight.reshape(height, 3 * width)
    for i in range(-(-height // CELL_PX)):
        for j in range(-(-width // CELL_PX)):
            first, left = i * CELL_PX, j * CELL_PX
            step = steps[min(i, steps.shape[0] - 1), min(j, steps.shape[1] - 1)]
            x, y = 16 * left + step[0], 16 * first + step[1]
            column, top = x >> 4, y >> 4
            whole = first + CELL_PX <= height and left + CELL_PX <= width
            if whole and column >= 0 and column + CELL_PX < width and top >= 0 and top + CELL_PX < height:
                u, v, right = x & 15, y & 15, 3 * (column + CELL_PX + 1)
                # 32 bits are enough, and compilers take twice as many of them at a time.
                a, b = np.int32((16 - u) * (16 - v)), np.int32(u * (16 - v))
                c, d = np.int32((16 - u) * v), np.int32(u * v)
                for row in range(CELL_PX):
                    upper, lower = flat[top + row, 3 * column : right], flat[top + row + 1, 3 * column : right]
                    target = out[first + row, 3 * left : 3 * (left + CELL_PX)]
                    for k in range(3 * CELL_PX):
                        above = np.int32(a * np.int32(upper[k]) + b * np.int32(upper[k + 3]))
                        below = np.int32(c * np.int32(lower[k]) + d * np.int32(lower[k + 3]))
                        target[k] = np.uint8(np.int32(above + below + np.int32(128)) >> np.int32(8))
            else:
                for row in range(first, min(first + CELL_PX, height)):
                    _at_border(pixels, straight, row, left, min(CELL_PX, width - left), x, y + 16 * (row - first))


@njit(cache=True, nogil=True)
def _at_border(pixels, straight, row, left, count, x, y):  # type: ignore[no-untyped-def]
    """Fill *count* pixels of a row where the source reaches beyond the frame: its last pixels go on for ever."""
    height, width = pixels.shape[:2]
    u, v = x & 15, y & 15
    top, below = min(max(y >> 4, 0), height - 1), min(max((y >> 4) + 1, 0), height - 1)
    for n in range(count):
        column = min(max((x >> 4) + n, 0), width - 1)
        right = min(max((x >> 4) + n + 1, 0), width - 1)
        for k in range(3):
            upper = (16 - u) * pixels[top, column, k] + u * pixels[top, right, k]
            lower = (16 - u) * pixels[below, column, k] + u * pixels[below, right, k]
            straight[row, left + n, k] = ((16 - v) * upper + v * lower + 128) >> 8
