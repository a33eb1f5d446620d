"""Which frame of the result is which frame of the truth."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vtrack_batch.errors import UnusableData
from vtrack_batch.evaluation.sides import Result, Truth


def joined_frames(result: Result, truth: Truth) -> tuple[pd.DataFrame, list[str]]:
    """Return the frames to be scored, in order of sequence and time, and remarks on those left out.

    Columns: ``true_frame`` (the truth's number), ``frame_id`` (null where the result knows the frame only from its
    quarantine), ``t_s`` (seconds since the first), ``sequence`` (code), ``width_px``, ``height_px`` (NaN = not known).
    Row number = the frame's index in all that follows. Frames are joined by exact time, or by the number in the file's
    name (see ``_by_time``). Frames that the result quarantined stay in, and all their vehicles count as missed; frames
    that are not in its archive at all are left out. Raises ``UnusableData`` when no frame is common.
    """
    if result.borrowed:
        return _frames_of_truth(truth), []
    found = _result_frames(result)
    found["number"] = file_number(found["path"])
    by_time = _by_time(found, truth)
    found["key"] = found["t_utc" if by_time else "number"]
    key = truth.frames["t_utc" if by_time else "frame"]
    if by_time:
        _refuse_doubles(key, "time stamp")
    found = found.dropna(subset=["key"])
    remarks = []
    if doubles := int(found["key"].duplicated().sum()):
        remarks.append(f"{doubles} frames of the result share their time or number with another one: left out")
    found = found.drop_duplicates("key")
    wanted = truth.frames.assign(key=key.astype(found["key"].dtype)).rename(columns={"frame": "true_frame"})
    both = wanted.merge(found, on="key", how="inner", suffixes=("_true", ""))
    if both.empty:
        by = "time stamp" if by_time else "number in the file name"
        raise UnusableData(_nothing_common(by, found["key"], wanted["key"]))
    both["t_utc"] = both["t_utc"].fillna(both["t_utc_true"])
    both["t_s"] = _seconds(both["t_utc"], both["true_frame"])
    both["sequence"] = pd.factorize(both["sequence"].ffill().bfill(), sort=True)[0]
    both = both.sort_values(["sequence", "t_s", "true_frame"]).reset_index(drop=True)
    if len(both) < len(wanted):
        remarks.append(f"{len(wanted) - len(both)} frames of the truth are not in the result's archive: left out")
    return both[["true_frame", "frame_id", "t_s", "sequence", "width_px", "height_px"]], remarks


def _by_time(found: pd.DataFrame, truth: Truth) -> bool:
    """Tell whether frames are joined by time: truths in tables always; others where the result has no numbered files.

    CSV truths are numbered as their frames are; their times, if any, may be nominal.
    """
    if truth.layout == "tables":
        return True
    if found["number"].notna().any() and not (truth.layout == "geotrax" and truth.frames["t_utc"].notna().all()):
        return False
    if truth.frames["t_utc"].isna().any():
        raise UnusableData(
            "the truth gives no times with a zone and the result no file numbers, so that their frames cannot be "
            "joined; give --time-zone if the truth holds local times"
        )
    return True


def _frames_of_truth(truth: Truth) -> pd.DataFrame:
    """Return the truth's own frames, for a result that was made from its detections."""
    frames = truth.frames.rename(columns={"frame": "true_frame"}).sort_values("true_frame", ignore_index=True)
    t_s = _seconds(frames["t_utc"], frames["true_frame"])
    return frames.assign(frame_id=None, t_s=t_s, sequence=0, width_px=np.nan, height_px=np.nan).drop(columns="t_utc")


def file_number(path: pd.Series) -> pd.Series:
    """Return the number that the digits of each file's name form, as float64; NaN without digits."""
    digits = path.astype(str).str.replace(r"^.*/", "", regex=True).str.replace(r"\.[^.]*$", "", regex=True)
    return pd.to_numeric(digits.str.replace(r"\D", "", regex=True), errors="coerce").astype(float)


def _result_frames(result: Result) -> pd.DataFrame:
    """Return the frames table, followed by quarantined files whose time is not known."""
    frames = result.frames[["frame_id", "path", "t_utc", "sequence", "width_px", "height_px"]].sort_values("path")
    only_path = result.quarantine.loc[~result.quarantine["path"].isin(frames["path"]), ["path"]].sort_values("path")
    if not len(only_path):
        return frames.copy()
    return pd.concat([frames, only_path.reindex(columns=frames.columns).astype(frames.dtypes.to_dict())])


def _nothing_common(by: str, found: pd.Series, true: pd.Series) -> str:
    """Return what to say where no key of the result is one of the truth."""
    own, other = (f"{keys.min()} to {keys.max()}" if keys.notna().any() else "none" for keys in (found, true))
    return (
        f"result and truth have no frame in common by {by}: the result has {own}, the truth {other}; "
        "are they of the same archive?"
    )


def _refuse_doubles(key: pd.Series, what: str) -> None:
    if key.duplicated().any():
        twice = key[key.duplicated()].iloc[0]
        raise UnusableData(f"the truth has several frames of the same {what}, {twice}: give it sequence by sequence")


def _seconds(t_utc: pd.Series, number: pd.Series) -> pd.Series:
    """Seconds since the first frame; frames without a time are put between their neighbours by number."""
    known = t_utc.notna().to_numpy()
    if not known.any():
        return number.astype(float) - float(number.min())
    t_s = ((t_utc - t_utc.min()) / pd.Timedelta(seconds=1)).to_numpy(float, na_value=np.nan)
    order = np.argsort(number.to_numpy()[known])
    numbers, times = number.to_numpy(float)[known][order], t_s[known][order]
    filled = np.interp(number.to_numpy(float), numbers, times)
    return pd.Series(np.where(known, t_s, filled), t_utc.index)
