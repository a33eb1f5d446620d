"""The median of a wide square around some places of a byte image, exact: only what is asked for costs time."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

REACH = 6
"""From the middle of the square to its edge."""

_SIDE = 2 * REACH + 1
_HALF = _SIDE * _SIDE // 2


def medians(plane: NDArray[np.uint8], wanted: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return *plane* (h, w) uint8 with the median of the square around it at each place where *wanted* (h, w) is not 0.

    The plane's edge goes on for ever. Source: a histogram that moves along (Huang et al. 1979).
    """
    found = plane.copy()
    _fill(found, np.asarray(cv2.copyMakeBorder(plane, REACH, REACH, REACH, REACH, cv2.BORDER_REPLICATE)), wanted)
    return found


@njit(cache=True, nogil=True)
def _fill(found, around, wanted):  # type: ignore[no-untyped-def]
    # Neighbours are alike: a processor that adds to one number again and again waits for itself. So there are four
    # histograms: of what came and what went, in even rows and in odd ones.
    counts = np.zeros((4, 256), np.int32)
    come, go, come_odd, go_odd = counts[0], counts[1], counts[2], counts[3]
    for r in range(found.shape[0]):
        last = -2
        for c in range(found.shape[1]):
            if not wanted[r, c]:
                continue
            first = c + _SIDE - 1
            if c != last + 1:
                first = c
                counts[:] = 0
                median, below = 0, np.int64(0)
            for column in range(first, c + _SIDE):
                for i in range(r, r + _SIDE - 1, 2):
                    even, odd = around[i, column], around[i + 1, column]
                    come[even] += 1
                    come_odd[odd] += 1
                    below += np.int64(even < median) + np.int64(odd < median)
                even = around[r + _SIDE - 1, column]
                come[even] += 1
                below += np.int64(even < median)
            if c == last + 1:
                for i in range(r, r + _SIDE - 1, 2):
                    even, odd = around[i, c - 1], around[i + 1, c - 1]
                    go[even] += 1
                    go_odd[odd] += 1
                    below -= np.int64(even < median) + np.int64(odd < median)
                even = around[r + _SIDE - 1, c - 1]
                go[even] += 1
                below -= np.int64(even < median)
            while below > _HALF:
                median -= 1
                below -= come[median] + come_odd[median] - go[median] - go_odd[median]
            while True:
                here = come[median] + come_odd[median] - go[median] - go_odd[median]
                if below + here > _HALF:
                    break
                below += here
                median += 1
            found[r, c] = median
            last = c
