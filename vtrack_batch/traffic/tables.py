"""Small helpers shared by the tables: grids of bins, counting into them, and the declared columns and types."""

from __future__ import annotations

import numpy as np
import pandas as pd
from pandas.api.types import pandas_dtype

from vtrack_batch.model.tables import TABLES
from vtrack_batch.traffic.bins import Bins
from vtrack_batch.traffic.intervals import count_intervals
from vtrack_batch.traffic.paths import Floats

_TYPES = {"text": "str", "category": "str", "float64": "float64", "bool": "bool", "time": "datetime64[us, UTC]"}


def declared(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return *frame* with exactly the columns, types and order of rows that the table *name* declares.

    Missing columns come out null; nullable integers as pandas' nullable integers.
    """
    table = TABLES[name]
    out = pd.DataFrame(index=frame.index)
    for column in table.columns:
        values = frame[column.name] if column.name in frame else pd.Series(np.nan, index=frame.index, dtype=float)
        if column.type.startswith("int"):
            out[column.name] = values.astype(pandas_dtype(column.type.capitalize() if column.nullable else column.type))
        elif column.type == "geometry":
            out[column.name] = values
        else:
            out[column.name] = values.astype(pandas_dtype(_TYPES[column.type]))
    return out.sort_values(list(table.key), kind="stable", ignore_index=True)


def grid(cells: pd.DataFrame, bins: Bins) -> pd.DataFrame:
    """Return every row of *cells* in every bin, with columns ``bin``, ``bin_start_utc`` and ``bin_s``."""
    row, of_bin = np.divmod(np.arange(len(cells) * len(bins)), max(len(bins), 1))
    out = cells.iloc[row].reset_index(drop=True)
    return out.assign(bin=of_bin, bin_start_utc=bins.start_utc[of_bin], bin_s=bins.length_s[of_bin])


def with_all_classes(events: pd.DataFrame) -> pd.DataFrame:
    """Return the events twice: under their own ``vehicle_class`` and under ``all``."""
    return pd.concat([events, events.assign(vehicle_class="all")], ignore_index=True)


def counted(cells: pd.DataFrame, events: pd.DataFrame, keys: list[str], *, uncertain: bool) -> pd.DataFrame:
    """Add ``count`` (sum of the events' ``weight``) and, where *uncertain*, its interval, to each row of *cells*.

    *cells* is unique by *keys*; every event belongs to one of its rows. Without uncertainty the interval is null.
    """
    row = cell_of(cells, events, keys)
    weight = events["weight"].to_numpy(float)
    nothing = np.full(len(cells), np.nan)
    lo, hi = count_intervals(weight, row, len(cells)) if uncertain else (nothing, nothing)
    return cells.assign(count=np.bincount(row, weight, len(cells)), count_lo=lo, count_hi=hi)


def cell_of(cells: pd.DataFrame, events: pd.DataFrame, keys: list[str]) -> np.ndarray:
    """Return the row number in *cells* of each event (n,)."""
    if events.empty:
        return np.empty(0, np.int64)
    lookup = cells[keys].assign(_row=np.arange(len(cells)))
    return events[keys].merge(lookup, on=keys, how="left")["_row"].to_numpy(np.int64)


def blank_where(frame: pd.DataFrame, unseen: np.ndarray, names: list[str]) -> pd.DataFrame:
    """Return *frame* with the named columns null in the rows where *unseen*."""
    return frame.assign(**{name: frame[name].mask(unseen) for name in names})


def per_hour(count: Floats, observed_s: Floats) -> Floats:
    """Return events per hour of observed time, NaN where there was none."""
    return np.divide(3600 * count, observed_s, out=np.full(len(observed_s), np.nan), where=observed_s > 0)
