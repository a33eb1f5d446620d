"""Anybody's tables of detections: CSV or Parquet, with names of columns and units as their owner declares them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd

from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.storage.spill import row_groups

NAMES = (
    "detection_id", "sequence", "t_utc", "x_m", "y_m", "red", "green", "blue", "length_m", "width_m",
    "vx_mps", "vy_mps",
)  # fmt: skip
Read = TypeVar("Read")
PLACES, UPWARD = ("x_m", "y_m"), ("y_m", "vy_mps")
CSV = (".csv", ".csv.gz", ".txt")


@dataclass(frozen=True)
class Declared:
    """What the owner of a table says of it.

    ``columns`` maps our names to theirs; ``metres_per_unit`` is the unit of coordinates (0.33 for pixels of 33 cm) and
    ``y_down`` tells that y grows downward, as the rows of an image do; ``seconds_per_unit`` is the unit of times that
    are numbers, counted from 1970-01-01 UTC; ``time_zone`` that of times which name none.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    metres_per_unit: float = 1.0
    y_down: bool = False
    seconds_per_unit: float | None = None
    time_zone: str | None = None


def read_detections(path: Path, declared: Declared) -> pd.DataFrame:
    """Read a table and return it in our names, metres and UTC; columns that are missing stay missing.

    A missing file, a column that is not there, or an unknown zone raises ``ConfigError``, contents that cannot be read
    ``UnusableData``.
    """
    parts = [read() for read in detection_parts(path, declared)]
    return parts[0] if len(parts) == 1 else pd.concat(parts, ignore_index=True)


def detection_parts(path: Path, declared: Declared) -> list[Callable[[], pd.DataFrame]]:
    """Return what reads a table as ``read_detections`` does, part by part: the row groups of Parquet, all of a CSV."""
    if path.name.lower().endswith(CSV):
        return [lambda: _in_our_terms(_checked(lambda: _read_csv(path, declared), path, "CSV"), path, declared)]
    groups = _checked(lambda: row_groups(path), path, "Parquet")

    def reader(read: Callable[[], pd.DataFrame]) -> Callable[[], pd.DataFrame]:
        return lambda: _in_our_terms(_checked(read, path, "Parquet"), path, declared)

    return [reader(read) for read in groups]


def _in_our_terms(rows: pd.DataFrame, path: Path, declared: Declared) -> pd.DataFrame:
    rows = _renamed(rows, path, declared.columns)
    for column in (*PLACES, "vy_mps"):
        if column in rows and pd.api.types.is_numeric_dtype(rows[column]):
            sign = -1.0 if declared.y_down and column in UPWARD else 1.0
            unit = declared.metres_per_unit if column in PLACES else 1.0
            rows[column] = rows[column].astype(float) * (sign * unit)
    if "detection_id" in rows:
        rows["detection_id"] = rows["detection_id"].astype("string")  # as in our tables, whatever it was
    if "t_utc" in rows:
        rows["t_utc"] = _utc(rows["t_utc"], path, declared)
    return rows


def _read_csv(path: Path, declared: Declared) -> pd.DataFrame:
    as_text = {declared.columns.get(name, name): "str" for name in ("detection_id", "sequence")}
    return pd.read_csv(path, dtype=as_text)


def _checked(read: Callable[[], Read], path: Path, kind: str) -> Read:
    try:
        return read()
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except (OSError, ValueError) as problem:
        raise UnusableData(f"{path}: not a {kind} table ({str(problem).splitlines()[0]})") from None


def _renamed(rows: pd.DataFrame, path: Path, columns: Mapping[str, str]) -> pd.DataFrame:
    unknown = [name for name in columns if name not in NAMES]
    if unknown:
        raise ConfigError(f"no column is called {', '.join(unknown)}; these are: {', '.join(NAMES)}")
    missing = [theirs for theirs in columns.values() if theirs not in rows.columns]
    if missing:
        raise ConfigError(f"{path} has no column {', '.join(missing)}; it has {', '.join(map(str, rows.columns))}")
    taken = {name: rows[columns.get(name, name)] for name in NAMES if columns.get(name, name) in rows.columns}
    return pd.DataFrame(taken, index=rows.index)


def _utc(times: pd.Series, path: Path, declared: Declared) -> pd.Series:
    """Return *times* in UTC, whether they are times, texts in ISO 8601, or numbers of a declared unit."""
    if pd.api.types.is_numeric_dtype(times):
        if declared.seconds_per_unit is None:
            raise ConfigError(f"{path}: t_utc holds numbers: say how many seconds one is (--seconds-per-unit)")
        seconds = times.to_numpy(float, na_value=np.nan) * declared.seconds_per_unit
        micro = pd.Series(np.round(seconds * 1e6), index=times.index).astype("Int64")
        return pd.to_datetime(micro, unit="us", utc=True)
    try:
        parsed = pd.to_datetime(times, format="ISO8601")
        if not isinstance(parsed.dtype, pd.DatetimeTZDtype):
            if declared.time_zone is None:
                raise ConfigError(f"{path}: t_utc holds times without a time zone: say which (--time-zone)")
            parsed = parsed.dt.tz_localize(_zone(declared.time_zone))
        return parsed.dt.tz_convert("UTC")
    except (ValueError, TypeError, AttributeError) as problem:
        raise UnusableData(f"{path}: t_utc is not all times ({str(problem).splitlines()[0]})") from None


def _zone(name: str) -> ZoneInfo:
    try:
        return ZoneInfo(name)
    except (KeyError, ValueError, OSError):
        raise ConfigError(f"{name!r} is no time zone: UTC, Europe/Berlin and the like are") from None
