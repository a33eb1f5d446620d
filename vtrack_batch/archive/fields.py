"""Interlaced frames: two fields of every other row, taken one after the other; what moved between them shows a comb.

A comb is light and dark by turns from row to row. Ground shows such turns too, but along rows as often as down columns:
what is upright tells what to expect lying down.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

STEP_DN = 10  # levels from row to row that are no noise
TURNS = 4  # so many steps, up and down by turns, are a comb
EVERY_PX, MOST_LINES = 3, 640  # columns (rows) looked at: every third one, in large frames fewer
LEAST = 40  # turns of a few frames that say anything
TIMES = 4.0  # as many as are expected, and the frames are interlaced


def turns(pixels: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return how often (2,) the levels of *pixels* (H, W, 3) go up and down by turns: down columns, and along rows."""
    green = pixels[:, :, 1]
    every = max(EVERY_PX, max(green.shape) // MOST_LINES)
    return np.array([_turns(green[:, ::every]), _turns(np.ascontiguousarray(green[::every].T))])


def _turns(levels: NDArray[np.uint8]) -> int:
    """Return how often ``TURNS`` successive steps down the columns are large and change their sign each time."""
    if len(levels) <= TURNS:
        return 0
    step = np.diff(levels.astype(np.int16), axis=0)
    sign = (step > STEP_DN).astype(np.int8) - (step < -STEP_DN).astype(np.int8)
    turned = sign[1:] * sign[:-1] < 0
    many = turned[: len(turned) - TURNS + 2]
    for later in range(1, TURNS - 1):
        many = many & turned[later : len(turned) - TURNS + 2 + later]
    return int(np.count_nonzero(many))


def are_interlaced(found: Sequence[NDArray[np.int64]]) -> bool:
    """Tell by the ``turns`` of some frames whether they hold two fields."""
    down, along = np.sum(found, axis=0) if found else (0, 0)
    return bool(down >= LEAST + TIMES * along)


def upper_field(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return *pixels* (H, W, 3) with the rows of the second field replaced by the mean of those of the first beside it.

    The first field is that of the top row; the last row, where nothing follows it, repeats the one above.
    """
    out = pixels.copy()
    above, below = pixels[:-1:2], pixels[2::2]
    out[1 : 2 * len(below) : 2] = (above[: len(below)].astype(np.uint16) + below + 1) // 2
    if len(pixels) % 2 == 0:
        out[-1] = pixels[-2]
    return out
