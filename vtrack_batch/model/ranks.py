"""Order statistics over a stack of byte images by a pruned sorting network: exact, and as fast as minima and maxima.

Source: merge exchange, Knuth, The Art of Computer Programming 3, section 5.2.2, algorithm M, for any number of inputs;
comparators on which the wanted ranks do not depend are left out.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray


def take_ranks(stack: NDArray[np.uint8], ranks: tuple[int, ...]) -> list[NDArray[np.uint8]]:
    """Return, for each of *ranks* (0 = smallest), that order statistic over the first axis of *stack* (n, ...) uint8.

    *stack* must be contiguous; its contents are spoilt.
    """
    flat = stack.reshape(len(stack), 1, -1)
    planes = [flat[i] for i in range(len(stack))]
    spare = np.empty_like(planes[0])
    for low, high in comparators(len(stack), ranks):
        cv2.min(planes[low], planes[high], spare)
        cv2.max(planes[low], planes[high], planes[high])
        planes[low], spare = spare, planes[low]
    return [planes[rank].reshape(stack.shape[1:]).copy() for rank in ranks]


@lru_cache(maxsize=64)
def comparators(count: int, ranks: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """Return the pairs (low, high) to be put in order, one after the other, so that *ranks* of *count* are right."""
    needed, kept = set(ranks), []
    for low, high in reversed(_merge_exchange(count)):
        if low in needed or high in needed:
            needed |= {low, high}
            kept.append((low, high))
    return tuple(reversed(kept))


def _merge_exchange(count: int) -> list[tuple[int, int]]:
    pairs: list[tuple[int, int]] = []
    if count < 2:
        return pairs
    top = 1 << ((count - 1).bit_length() - 1)
    p = top
    while p > 0:
        q, r, d = top, 0, p
        while True:
            pairs.extend((i, i + d) for i in range(count - d) if i & p == r)
            if q == p:
                break
            d, q, r = q - p, q // 2, p
        p //= 2
    return pairs
