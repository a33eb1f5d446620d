"""The columns ``completeness`` of table ``coverage``, from what was painted into the units of a date."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from vtrack_batch.completeness.estimate import completeness
from vtrack_batch.completeness.table import INJECTIONS
from vtrack_batch.config.survey import Survey
from vtrack_batch.model.zones import Zone
from vtrack_batch.pipeline.parts import Context
from vtrack_batch.pipeline.plan import Piece
from vtrack_batch.storage.parquet import read_table
from vtrack_batch.traffic.places import Place, places_of

_COLUMNS = ["completeness", "completeness_lo", "completeness_hi"]


def with_completeness(
    coverage: pd.DataFrame, tracked: Sequence[Piece], zones: Sequence[Zone], context: Context
) -> pd.DataFrame:
    """Return *coverage* with its columns filled, from the units below the *tracked* sequences; as it is without any."""
    units = [context.part(unit) for piece in tracked for unit in piece.needs]
    files = [unit.file(f"{INJECTIONS.name}.parquet") for unit in units]
    rows = read_table([file for file in files if file.is_file()], INJECTIONS)
    if rows.empty or coverage.empty:
        return coverage
    survey = context.survey
    places = places_of(zones, site_centre=None, params=survey.traffic)
    bins = coverage[["bin_start_utc", "bin_s"]].drop_duplicates().sort_values("bin_start_utc", ignore_index=True)
    inside = np.stack([_at(place, rows, survey) for place in places], axis=1)
    found = completeness(rows, inside, _bin_of(rows, bins), len(bins))
    found["place"] = np.array([place.id for place in places], object)[found["place"].to_numpy(int)]
    found["bin_start_utc"] = bins["bin_start_utc"].take(found["bin"].to_numpy(int)).to_numpy()
    key = ["place", "bin_start_utc"]
    names = coverage[key].assign(place=coverage["place"].astype(object))
    filled = names.merge(found[[*key, *_COLUMNS]], on=key, how="left")
    return coverage.assign(**{name: filled[name].to_numpy(float) for name in _COLUMNS})


def _at(place: Place, rows: pd.DataFrame, survey: Survey) -> NDArray[np.bool_]:
    """Return which sightings lie in an area, or near to a line."""
    shapely.prepare(place.shape)
    points = shapely.points(rows["x_m"].to_numpy(float), rows["y_m"].to_numpy(float))
    return np.asarray(shapely.dwithin(place.shape, points, survey.completeness.near_gate_m if place.is_line else 0.0))


def _bin_of(rows: pd.DataFrame, bins: pd.DataFrame) -> NDArray[np.int64]:
    """Return the bin of every sighting, -1 for none."""
    start = bins["bin_start_utc"].dt.tz_localize(None).to_numpy("datetime64[us]").astype(np.int64)
    t_us = rows["t_utc"].dt.tz_localize(None).to_numpy("datetime64[us]").astype(np.int64)
    number = np.searchsorted(start, t_us, "right") - 1
    within = (number >= 0) & (t_us < (start + bins["bin_s"].to_numpy(np.int64) * 1_000_000)[number])
    return np.where(within, number, -1)
