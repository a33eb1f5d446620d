"""A north-up grid of square pixels on the ground, on which pictures of different blocks fall into register."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.errors import UnusableData

MOST_PIXELS = 2_000_000_000


@dataclass(frozen=True)
class GroundGrid:
    """Pixels of ``gsd_m`` whose edges lie at whole multiples of it.

    ``x_min_m``, ``y_max_m``: the outer corner at the top left; ``shape``: rows and columns; ``crs``: None = local.
    """

    crs: str | None
    x_min_m: float
    y_max_m: float
    gsd_m: float
    shape: tuple[int, int]

    @classmethod
    def covering(cls, corners_m: NDArray[np.float64], gsd_m: float, *, crs: str | None = None) -> GroundGrid:
        """Return the smallest grid that covers the points *corners_m* (n, 2).

        Raises `UnusableData` where that is more than 2 gigapixels, or where a point lies at infinity.
        """
        if not np.isfinite(corners_m).all():
            raise UnusableData(
                "the ground picture would reach to infinity: by the georeference the horizon is in view; check the "
                "control points, or take frames that look less aslant"
            )
        # A corner that lies on an edge but for rounding must not cost a row of empty pixels.
        slack = 1e-6
        left, bottom = np.floor(corners_m.min(axis=0) / gsd_m + slack)
        right, top = np.ceil(corners_m.max(axis=0) / gsd_m - slack)
        rows, columns = max(1, int(top - bottom)), max(1, int(right - left))
        if rows * columns > MOST_PIXELS:
            raise UnusableData(f"the ground picture would have {columns} x {rows} px; set a larger georeference.gsd_m")
        return cls(crs, float(left * gsd_m), float(top * gsd_m), gsd_m, (rows, columns))

    @property
    def to_ground(self) -> NDArray[np.float64]:
        """The map (3, 3) from pixels, (0, 0) = centre of the first, to ground metres."""
        g = self.gsd_m
        return np.array([[g, 0, self.x_min_m + g / 2], [0, -g, self.y_max_m - g / 2], [0, 0, 1]])
