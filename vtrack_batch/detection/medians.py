"""The median of a wide square around some places of a byte image, exact: only what is asked for costs time."""

from __future__ import annotations

import numpy as np
from numba import njit

REACH = 6
"""From the middle of the square to its edge."""

_HALF = (2 * REACH + 1) ** 2 // 2


@njit(cache=True, nogil=True)
def medians(plane, wanted):  # type: ignore[no-untyped-def]
    """Return *plane* (h, w) uint8 with the median of the square around it at each place where *wanted* (h, w) is not 0.

    The plane's edge goes on for ever. Source: a histogram that moves along (Huang et al. 1979).
    """
    height, width = plane.shape
    found = plane.copy()
    counts = np.zeros(256, np.int32)
    for r in range(height):
        top, bottom, last = max(r - REACH, 0), min(r + REACH, height - 1), -2
        # How often the first and the last row count: the edge goes on.
        above, beneath = top - (r - REACH), r + REACH - bottom
        for c in range(width):
            if not wanted[r, c]:
                continue
            if c != last + 1:
                counts[:] = 0
                median, below = 0, np.int64(0)
                for j in range(c - REACH, c + REACH + 1):
                    column = plane[:, min(max(j, 0), width - 1)]
                    for i in range(top, bottom + 1):
                        counts[column[i]] += 1
                    counts[column[top]] += above
                    counts[column[bottom]] += beneath
            else:
                gone, come = plane[:, max(c - REACH - 1, 0)], plane[:, min(c + REACH, width - 1)]
                for i in range(top, bottom + 1):
                    counts[gone[i]] -= 1
                    counts[come[i]] += 1
                    below += np.int64(come[i] < median) - np.int64(gone[i] < median)
                counts[gone[top]] -= above
                counts[come[top]] += above
                counts[gone[bottom]] -= beneath
                counts[come[bottom]] += beneath
                below += above * (np.int64(come[top] < median) - np.int64(gone[top] < median))
                below += beneath * (np.int64(come[bottom] < median) - np.int64(gone[bottom] < median))
            while below > _HALF:
                median -= 1
                below -= counts[median]
            while below + counts[median] <= _HALF:
                below += counts[median]
                median += 1
            found[r, c] = median
            last = c
    return found
