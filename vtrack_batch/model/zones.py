"""Places that a user draws (or the traffic chapter proposes): where vehicles are counted, and where ignored."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry import LineString, Polygon

Role = Literal["gate", "zone", "approach", "lane", "exclusion"]
ROLES: tuple[Role, ...] = get_args(Role)
TEMPLATE_NAME = "example: replace by your own"


@dataclass(frozen=True)
class Zone:
    """One drawn feature, in ground metres.

    ``gate``: a line across a road. ``zone``: an area where trips begin and end. ``approach``: an arm of ``junction``.
    ``lane``: an area, or a line with property ``width_m``. ``exclusion``: an area whose detections are dropped.
    ``properties`` holds what else the feature said (``inward``, ``width_m``, ``length_m``, ``traffic``, ...).
    """

    id: str
    name: str
    role: Role
    geometry: LineString | Polygon
    junction: str | None = None
    properties: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))


def excluded(zones: Iterable[Zone], x_m: ArrayLike, y_m: ArrayLike) -> NDArray[np.bool_]:
    """Return for each ground point (n,) whether it lies in, or on the border of, any exclusion."""
    x, y = np.asarray(x_m, float), np.asarray(y_m, float)
    mask = np.zeros(x.shape, bool)
    for zone in zones:
        if zone.role == "exclusion":
            shapely.prepare(zone.geometry)
            mask |= shapely.intersects_xy(zone.geometry, x, y)
    return mask
