"""Which pixels of a frame hold data: wedges that an orthorectification left black are not ground."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_BLACK = 3
_WEDGE_PX = 15


def without_data(pixels: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Return (H, W) uint8: 255 where the frame (H, W, 3) is black over 15 px and more, else 0; None if nowhere.

    JPEG blurs the edge of such a wedge, so two pixels beside it count as empty too.
    """
    # A square of 15 px that is black holds a point of any grid that is finer.
    points = pixels[:: _WEDGE_PX // 2, :: _WEDGE_PX // 2]
    if not ((points[:, :, 1] <= _BLACK).any() and (points <= _BLACK).all(axis=2).any()):
        return None
    black = cv2.inRange(pixels, (0, 0, 0), (_BLACK, _BLACK, _BLACK))
    square = np.ones((_WEDGE_PX, _WEDGE_PX), np.uint8)
    wedge = cv2.morphologyEx(black, cv2.MORPH_OPEN, square)
    return np.asarray(cv2.dilate(wedge, np.ones((5, 5), np.uint8)), np.uint8) if wedge.any() else None
