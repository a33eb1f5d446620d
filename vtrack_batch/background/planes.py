"""Samples laid on each other, colour plane by colour plane: how far each is from the ground, and what none shows.

All of it is minima, maxima and masks over whole planes of bytes, which processors do dozens at a time.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]


def padded(stack: Bytes, covered: Bytes) -> Bytes:
    """Return *stack* (n, 3, h, w) with 0 and 255 in turn where not *covered* (n, h, w), 0 or 255.

    What a sample does not cover thus votes for neither side of the median.
    """
    full, fill = stack.copy(), np.zeros(covered.shape[1:], np.uint8)
    for planes, missing in _uncovered(full, covered):
        for plane in planes:
            cv2.copyTo(fill, missing, plane)
        cv2.bitwise_not(fill, fill, missing)
    return full


def deviations(stack: Bytes, covered: Bytes, pixels: Bytes, change: float) -> tuple[Bytes, NDArray[np.float32], Bytes]:
    """Return how far samples *stack* (n, 3, h, w) are from *pixels* (3, h, w), all uint8.

    That is the largest difference of a channel (n, h, w) uint8, 255 and 0 in turn where not *covered* (n, h, w); the
    share (h, w) of the samples there in which it exceeds *change*; and how many these are (h, w) uint8.
    """
    shape = covered.shape[1:]
    away, other = np.empty(covered.shape, np.uint8), np.empty(shape, np.uint8)
    changed, fill = np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8)
    for largest, planes in zip(away, stack, strict=True):
        cv2.absdiff(planes[0], pixels[0], largest)
        for plane, ground in zip(planes[1:], pixels[1:], strict=True):
            cv2.max(largest, cv2.absdiff(plane, ground, other), largest)
    for largest, there in zip(away, covered, strict=True):
        beyond = cv2.threshold(largest, change, 1, cv2.THRESH_BINARY)[1]
        cv2.add(changed, cv2.bitwise_and(beyond, there), changed)
    seen, one = np.full(shape, len(stack), np.uint8), np.ones(shape, np.uint8)
    for largest, missing in _uncovered(away, covered):
        cv2.copyTo(fill, missing, largest)
        cv2.bitwise_not(fill, fill, missing)
        cv2.subtract(seen, one, seen, missing)
    share = np.divide(changed, np.maximum(seen, one), dtype=np.float32)
    return away, share, seen


def _uncovered(layers: Bytes, covered: Bytes) -> Iterator[tuple[Bytes, Bytes]]:
    """Yield each of *layers* (n, ...) that does not cover all, and where it does not (h, w), 255 or 0."""
    for layer, there in zip(layers, covered, strict=True):
        missing = np.asarray(cv2.bitwise_not(there), np.uint8)
        if missing.any():
            yield layer, missing
