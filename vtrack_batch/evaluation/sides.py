"""The two sides of an evaluation: what a run found, and what is true."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import pandas as pd

Layout = Literal["tables", "labelled", "pair", "rendered", "kit", "mot", "boxes", "geotrax"]
Plane = Literal["frame", "ground"]
"""Where sightings and vehicles are compared: in pixels of the frame, or in metres on the ground."""

ENDS_NOT_PLACES = ("unknown", "parked")
"""Origins and destinations that say that the place is not known."""

SIGHTING_NUMBERS = (
    "col_px", "row_px", "x_m", "y_m", "length_px", "length_m", "speed_mps", "standing_s", "luminance", "shadowed",
    "gap_m", "gap_px",
)  # fmt: skip
"""What a truth may tell of a sighting in numbers; NaN where it does not."""


@dataclass(frozen=True)
class Result:
    """The tables of one published snapshot, or of ``track`` and ``match``; columns as in ``model/tables.py``.

    ``borrowed``: it holds no detections, because its ids are those of the truth's detections. ``tracked``: it tells
    tracks (``match`` does not). ``counted``: it tells OD pairs, turns and flows.
    """

    frames: pd.DataFrame
    detections: pd.DataFrame
    track_points: pd.DataFrame
    trajectories: pd.DataFrame
    od_pairs: pd.DataFrame
    turns: pd.DataFrame
    quarantine: pd.DataFrame
    matches: pd.DataFrame = field(default_factory=pd.DataFrame)
    flows: pd.DataFrame = field(default_factory=pd.DataFrame)
    borrowed: bool = False
    tracked: bool = True
    counted: bool = True


@dataclass(frozen=True)
class Truth:
    """What is true, in one form for all layouts.

    ``frames``: ``frame`` (int64, the truth's own number), ``t_utc`` (may be NaT). ``sightings``, one row per vehicle
    and frame: ``frame``, ``vehicle`` (text), and as far as the layout tells (else NaN): ``col_px``, ``row_px``,
    ``x_m``, ``y_m``; ``length_px``, ``length_m`` (the gate is half of it; NaN = the common gate); ``motion`` (mover,
    creeper, parked), ``speed_mps``, ``standing_s``, ``luminance``, ``shadowed``, ``gap_m`` or ``gap_px`` (to the next
    vehicle's body), ``whole`` (whether the body lies inside the frame), ``detection_id``. ``parked``: ``frame``,
    ``col_px``, ``row_px`` and, if known, ``x_m``, ``y_m`` of parked cars. ``ignore``: ``frame``, ``left``, ``top``,
    ``width``, ``height`` in pixels. ``alarms``: ``frame``, ``detection_id``, ``x_m``, ``y_m`` of detections that are no
    vehicle. The other tables are as declared, empty where the layout has none.
    """

    layout: Layout
    frames: pd.DataFrame
    sightings: pd.DataFrame
    parked: pd.DataFrame
    ignore: pd.DataFrame
    trajectories: pd.DataFrame
    od_pairs: pd.DataFrame
    turns: pd.DataFrame
    flows: pd.DataFrame = field(default_factory=pd.DataFrame)
    crossings: pd.DataFrame = field(default_factory=pd.DataFrame)
    alarms: pd.DataFrame = field(default_factory=pd.DataFrame)

    @property
    def scores_movers(self) -> bool:
        """Whether parked vehicles are among the sightings, so that movers are scored apart."""
        return self.layout == "kit"
