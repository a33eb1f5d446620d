"""The two sides of an evaluation: what a run found, and what is true."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import pandas as pd

Layout = Literal["tables", "rendered", "kit"]

ENDS_NOT_PLACES = ("unknown", "parked")
"""Origins and destinations that say that the place is not known."""


@dataclass(frozen=True)
class Result:
    """The tables of one published snapshot that an evaluation reads; columns as in ``model/tables.py``."""

    frames: pd.DataFrame
    detections: pd.DataFrame
    track_points: pd.DataFrame
    trajectories: pd.DataFrame
    od_pairs: pd.DataFrame
    turns: pd.DataFrame
    quarantine: pd.DataFrame


@dataclass(frozen=True)
class Truth:
    """What is true, in one form for all layouts.

    ``frames``: ``frame`` (int64, the truth's own number), ``t_utc`` (may be NaT). ``sightings``, one row per vehicle
    and frame: ``frame``, ``vehicle`` (text), ``col_px``, ``row_px``, ``length_px`` (longer side of the true box; NaN =
    use the common gate), ``motion`` (mover, creeper, parked), ``speed_mps``, ``standing_s``, ``luminance`` (NaN = not
    known), ``whole`` (whether the body lies inside the frame). ``parked``: ``frame``, ``col_px``, ``row_px`` of parked
    cars. ``ignore``: ``frame``, ``left``, ``top``, ``width``, ``height`` in pixels. The last three tables are the
    contract's own, empty where the layout has none.
    """

    layout: Layout
    frames: pd.DataFrame
    sightings: pd.DataFrame
    parked: pd.DataFrame
    ignore: pd.DataFrame
    trajectories: pd.DataFrame
    od_pairs: pd.DataFrame
    turns: pd.DataFrame

    @property
    def scores_movers(self) -> bool:
        """Whether parked vehicles are among the sightings, so that movers are scored apart."""
        return self.layout == "kit"
