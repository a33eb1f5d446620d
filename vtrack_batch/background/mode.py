"""Half-sample mode of pixels that are occupied too often for a median.

Source: Robertson and Cryer 1974; Bickel and Fruehwirth 2006. The densest half of the grey levels is halved again until
three samples are left; the colour is their mean.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def replace_by_mode(image, stack, covered, busy):  # type: ignore[no-untyped-def]
    """Overwrite *image* (h, w, 3) uint8, where *busy* (h, w) bool, with the mode of *stack* (n, h, w, 3) uint8.

    Only samples that *covered* (n, h, w) bool marks take part.
    """
    count = stack.shape[0]
    grey = np.empty(count, np.int64)
    member = np.empty(count, np.int64)
    for r in range(busy.shape[0]):
        for c in range(busy.shape[1]):
            if not busy[r, c]:
                continue
            n = 0
            for i in range(count):
                if covered[i, r, c]:
                    level = np.int64(stack[i, r, c, 0]) + np.int64(stack[i, r, c, 1]) + np.int64(stack[i, r, c, 2])
                    j = n
                    while j > 0 and grey[j - 1] > level:
                        grey[j], member[j] = grey[j - 1], member[j - 1]
                        j -= 1
                    grey[j], member[j] = level, i
                    n += 1
            first, size = 0, n
            while size > 3:
                half = (size + 1) // 2
                best, width = first, grey[first + half - 1] - grey[first]
                for j in range(first + 1, first + size - half + 1):
                    if grey[j + half - 1] - grey[j] < width:
                        best, width = j, grey[j + half - 1] - grey[j]
                first, size = best, half
            if size > 0:
                for k in range(3):
                    total = 0
                    for j in range(first, first + size):
                        total += np.int64(stack[member[j], r, c, k])
                    image[r, c, k] = (total + size // 2) // size
