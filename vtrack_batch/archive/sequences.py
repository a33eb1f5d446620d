"""Frames of one platform: one per instant, in unbroken runs."""

from __future__ import annotations

import numpy as np
import pandas as pd


def resolve_duplicates(files: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Keep one frame per platform and instant: the first by its path.

    *files* as ``Scan.files``, with ``sha256`` known at least where ``shares_instant`` is true. Returns the files kept,
    in their order, and the others as path, reason (``duplicate_content`` if bytes equal the kept frame's, else
    ``duplicate_time``), detail.
    """
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
    """Return *files* sorted by platform and time, with the columns ``sequence`` and ``date``.

    A sequence is an unbroken run of one platform: it ends where the next frame is more than *max_gap_s* away, or at
    midnight in *time_zone* (None = UTC). Its name is the platform and the first frame's UTC, such as
    ``north/20260517T060000Z``; ``date`` is the local date as text, YYYY-MM-DD. *max_gap_s* of a second or more makes
    names unique.
    """
    ordered = files.sort_values(["platform", "t_utc", "path"], ignore_index=True)
    date = ordered["t_utc"].dt.tz_convert(time_zone or "UTC").dt.strftime("%Y-%m-%d")
    gap_s = ordered["t_utc"].diff().dt.total_seconds()
    begins = (gap_s > max_gap_s) | (ordered["platform"] != ordered["platform"].shift()) | (date != date.shift())
    names = ordered["platform"].astype(str) + "/" + ordered["t_utc"].dt.strftime("%Y%m%dT%H%M%SZ")
    number = begins.cumsum() - 1
    sequence = names[begins].to_numpy(object)[number.to_numpy(np.int64)] if len(ordered) else names.to_numpy(object)
    return ordered.assign(sequence=sequence, date=date.astype(object))
