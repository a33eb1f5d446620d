"""Which pixels of a frame hold data: wedges that an orthorectification left black are not ground."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_BLACK = 3
_WEDGE_PX = 15


def has_data(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return (H, W) uint8: 255 where the frame (H, W, 3) holds data, 0 in black areas of 15 px and more.

    JPEG blurs the edge of a wedge, so two pixels beside it count as empty too.
    """
    black = cv2.inRange(pixels, (0, 0, 0), (_BLACK, _BLACK, _BLACK))
    if not black.any():
        return np.full(pixels.shape[:2], 255, np.uint8)
    square = np.ones((_WEDGE_PX, _WEDGE_PX), np.uint8)
    wedge = cv2.morphologyEx(black, cv2.MORPH_OPEN, square)
    return np.asarray(cv2.bitwise_not(cv2.dilate(wedge, np.ones((5, 5), np.uint8))), np.uint8)
