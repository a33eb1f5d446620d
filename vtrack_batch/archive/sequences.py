"""Frames of one platform: one per instant, in unbroken runs."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray


def resolve_duplicates(files: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Keep one frame per platform and instant: the first by its path.

    *files* as ``Scan.files``, with ``sha256`` known at least where ``shares_instant`` is true. Returns the files kept,
    in their order, and the others as path, reason (``duplicate_content`` if bytes equal the kept frame's, else
    ``duplicate_time``), detail.
    """
    if not shares_instant(files).any():
        return files.reset_index(drop=True), pd.DataFrame(columns=["path", "reason", "detail"], dtype=object)
    by_path = files.sort_values("path")
    kept = by_path.groupby(["platform", "t_utc"], sort=False)[["path", "sha256"]].transform("first", skipna=False)
    extra = by_path.duplicated(["platform", "t_utc"])
    same = extra & (by_path["sha256"] == kept["sha256"]) & by_path["sha256"].notna()
    dropped = by_path[extra]
    quarantine = pd.DataFrame(
        {
            "path": dropped["path"].to_numpy(object),
            "reason": np.where(same[extra], "duplicate_content", "duplicate_time").astype(object),
            "detail": ("the same instant as " + kept.loc[extra, "path"].astype(object)).to_numpy(object),
        }
    )
    return files[~extra.reindex(files.index)].reset_index(drop=True), quarantine.sort_values("path", ignore_index=True)


def shares_instant(files: pd.DataFrame) -> pd.Series:
    """Tell, row by row of *files*, whether another frame of its platform has the same t_utc: bool, index of *files*."""
    return files.duplicated(["platform", "t_utc"], keep=False)


def split_sequences(files: pd.DataFrame, *, max_gap_s: float, time_zone: str | None) -> pd.DataFrame:
    """Return *files* sorted by platform and time, with the columns ``sequence`` and ``date`` (categories in order).

    A sequence is an unbroken run of one platform: it ends where the next frame is more than *max_gap_s* away, or at
    midnight in *time_zone* (None = UTC). Its name is the platform and the first frame's UTC, such as
    ``north/20260517T060000Z``; ``date`` is the local date as text, YYYY-MM-DD. *max_gap_s* of a second or more makes
    names unique.
    """
    ordered = files if _in_order(files) else files.sort_values(["platform", "t_utc", "path"], ignore_index=True)
    day = ordered["t_utc"].dt.tz_convert(time_zone or "UTC").dt.tz_localize(None).to_numpy().astype("datetime64[D]")
    apart = ordered["t_utc"].diff() > pd.Timedelta(seconds=max_gap_s)
    platform = ordered["platform"]
    next_day = np.diff(day, prepend=day[:1]) != np.timedelta64(0, "D")
    begins = (apart | (platform != platform.shift())).to_numpy(bool) | next_day
    first = ordered.loc[begins, ["platform", "t_utc"]]
    names = first["platform"].astype(object) + "/" + first["t_utc"].dt.strftime("%Y%m%dT%H%M%SZ").astype(object)
    number = np.cumsum(begins) - 1
    days, which = np.unique(day, return_inverse=True)
    return ordered.assign(
        sequence=_categories(names.to_numpy(object), number), date=_categories(days.astype(str).astype(object), which)
    )


def median_interval_s(files: pd.DataFrame) -> float | None:
    """Return the median time between frames of *files*, as ``split_sequences`` gives them; None where all are alone."""
    gaps = files.groupby("sequence", observed=True)["t_utc"].diff().dt.total_seconds().dropna()
    return round(float(gaps.median()), 3) if len(gaps) else None


def _in_order(files: pd.DataFrame) -> bool:
    """Return whether *files* are one platform's in order of time, as most archives name them."""
    rising = files["t_utc"].is_monotonic_increasing and files["t_utc"].is_unique
    return bool(rising and files["platform"].nunique() <= 1 and files.index.equals(pd.RangeIndex(len(files))))


def _categories(names: NDArray[np.object_], codes: NDArray[np.int64]) -> pd.Categorical:
    """Return ``names[codes]`` as categories in the order of their names."""
    order = np.argsort(names.astype(str), kind="stable")
    rank = np.empty(len(names), np.int64)
    rank[order] = np.arange(len(names))
    return pd.Categorical.from_codes(rank[codes], pd.Index(names[order], dtype="str"))
