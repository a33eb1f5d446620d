"""``match`` and ``track`` on anybody's Parquet tables of detections."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.matching.match import match
from vtrack_batch.storage.output import make_folder
from vtrack_batch.tracking.track import track


def match_files(earlier: Path, later: Path, out: Path, *, method: str, elapsed_s: float | None) -> tuple[Path, int]:
    """Match two detection tables and write ``matches.parquet`` into *out*; returns its path and the number of links."""
    before, after = _read(earlier), _read(later)
    if elapsed_s is None:
        elapsed_s = _elapsed_s(before, after)
    matches = match(before, after, elapsed_s=elapsed_s, method=method)
    make_folder(out)
    matches.to_parquet(out / "matches.parquet", index=False)
    return out / "matches.parquet", int(
        (matches["detection_id_from"].notna() & matches["detection_id_to"].notna()).sum()
    )


def track_file(detections: Path, out: Path, *, method: str) -> dict[str, int]:
    """Track a detection table; write trajectories, track_points and matches into *out*; returns their rows."""
    tracks = track(_read(detections), method=method)
    make_folder(out)
    made = {"trajectories": tracks.trajectories, "track_points": tracks.track_points, "matches": tracks.matches}
    for name, rows in made.items():
        rows.to_parquet(out / f"{name}.parquet", index=False)
    return {name: len(rows) for name, rows in made.items()}


def _read(path: Path) -> pd.DataFrame:
    try:
        return pd.read_parquet(path)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except (OSError, ValueError) as problem:
        raise UnusableData(f"{path}: not a Parquet table ({str(problem).splitlines()[0]})") from None


def _elapsed_s(before: pd.DataFrame, after: pd.DataFrame) -> float:
    if "t_utc" not in before or "t_utc" not in after or before.empty or after.empty:
        raise ConfigError("the time between the tables is not known: give --elapsed-s, or a column t_utc in both")
    elapsed_s = float((after["t_utc"].min() - before["t_utc"].max()).total_seconds())
    if elapsed_s <= 0:
        raise ConfigError(f"the later table is not later: {elapsed_s} s between them")
    return elapsed_s
