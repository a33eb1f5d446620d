"""Which bit of a word is its lowest, in compiled code: to walk through a set that is kept as bits."""

from __future__ import annotations

import numpy as np
from numba import njit

SEQUENCE = 0x077CB531  # multiplied by a lone bit, its upper five bits tell which bit that is (de Bruijn sequence)
RANK = np.zeros(32, np.int64)
RANK[[((SEQUENCE << n) & 0xFFFFFFFF) >> 27 for n in range(32)]] = np.arange(32)


@njit(cache=True, nogil=True)
def lowest(bits):  # type: ignore[no-untyped-def]
    """Return the number of the lowest bit of *bits*, a uint32 that is not 0."""
    alone = bits & (~bits + np.uint32(1))
    return RANK[np.uint32(alone * np.uint32(SEQUENCE)) >> np.uint32(27)]
