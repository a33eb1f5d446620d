"""``match``, ``track`` and ``learn`` on anybody's tables of detections; what is found is written as declared."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

from vtrack_batch.errors import ConfigError, UnusableData, VtrackError
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.match import match
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.model.tables import TABLES, Table
from vtrack_batch.pipeline.foreign import Declared, detection_parts, read_detections
from vtrack_batch.pipeline.stream import runs_of, survey
from vtrack_batch.storage.output import make_folder
from vtrack_batch.storage.parquet import write_table
from vtrack_batch.storage.spill import Spill
from vtrack_batch.tracking.learn import learn_flow
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.tracking.track import chosen_method, track_runs

TIMES = ("t_from_utc", "t_to_utc")
MADE = ("trajectories", "track_points", "matches")


def match_files(
    earlier: Path,
    later: Path,
    out: Path,
    *,
    method: str = "default",
    elapsed_s: float | None = None,
    flow_map: Path | None = None,
    declared: Declared | None = None,
) -> tuple[Path, int]:
    """Match two tables of detections and write ``matches.parquet`` into *out*; returns its path and the links.

    Without *elapsed_s* the time between them is told by ``t_utc``, of which each table then holds one value.
    """
    declared = declared or Declared()
    before, after = read_detections(earlier, declared), read_detections(later, declared)
    times = [_time_of(before, earlier), _time_of(after, later)]
    if elapsed_s is None:
        elapsed_s = _elapsed_s(*times)
    found = match(before, after, elapsed_s=elapsed_s, method=method, flow_map=load_map(flow_map))
    ids = found[["detection_id_from", "detection_id_to"]].astype("string")
    rows = found.assign(
        **ids,
        match_id=ids["detection_id_from"].fillna("") + ">" + ids["detection_id_to"].fillna(""),
        sequence=_sequence_of(before, after),
        t_from_utc=pd.Series([times[0]] * len(found), dtype="datetime64[us, UTC]"),
        t_to_utc=pd.Series([times[1]] * len(found), dtype="datetime64[us, UTC]"),
    )
    make_folder(out)
    write_table(out / "matches.parquet", _timeless(TABLES["matches"]), rows)
    return out / "matches.parquet", int(ids.notna().all(axis=1).sum())


def track_file(
    detections: Path,
    out: Path,
    *,
    method: str = "default",
    flow_map: Path | None = None,
    declared: Declared | None = None,
) -> dict[str, int]:
    """Track a table of detections; write trajectories, track_points and matches into *out*; returns their rows.

    The table is read part by part and tracked window by window: memory does not grow with its length, but for eight
    bytes a row. A Parquet table in order of time is read twice, another one oftener.
    """
    parts = detection_parts(detections, declared or Declared())
    matching, params, flow = MatchingParams(), TrackingParams(), load_map(flow_map)
    chosen, sigma_m = chosen_method(method, matching), params.motion.position_sigma_m
    sequences = [runs_of(course, parts, sigma_m) for course in survey(parts)]
    with _folder_of_success(out), TemporaryDirectory(dir=out, prefix=".spill-") as folder:
        spills = {name: Spill(TABLES[name], Path(folder) / name) for name in MADE}
        for runs in sequences:
            for tracks in track_runs(runs, chosen, flow, matching, params):
                for name, spill in spills.items():
                    spill.add(getattr(tracks, name))
        return {name: spill.write(out / f"{name}.parquet") for name, spill in spills.items()}


@contextmanager
def _folder_of_success(out: Path) -> Iterator[None]:
    """Make the folder *out*, and take it away again where what is to be written into it cannot be made."""
    fresh = not out.exists()
    make_folder(out)
    try:
        yield
    except VtrackError:
        if fresh:
            out.rmdir()
        raise


def learn_file(detections: Path, out: Path, *, declared: Declared | None = None) -> FlowMap:
    """Learn the flow map of the place from a table of detections, without truth; write it to the file *out*."""
    rows = read_detections(detections, declared or Declared())
    learned = learn_flow(rows)
    if not len(learned.xy):
        raise UnusableData(
            f"{detections}: no vehicle was followed surely enough to learn from ({len(rows)} detections); "
            "more frames, or frames closer in time, are needed"
        )
    make_folder(out.parent)
    learned.save(out)
    return learned


def load_map(path: Path | None) -> FlowMap | None:
    """Read a flow map; None if none is given."""
    if path is None:
        return None
    if not path.is_file():
        raise ConfigError(f"{path}: no such file; `vtrack-batch learn` makes a flow map")
    return FlowMap.load(path)


def _time_of(rows: pd.DataFrame, path: Path) -> pd.Timestamp | None:
    """Return the time of the one image that *rows* tells of, None if it tells none."""
    if "t_utc" not in rows or rows["t_utc"].isna().all():
        return None
    times = rows["t_utc"].drop_duplicates()
    if len(times) > 1:
        raise UnusableData(f"{path} holds {len(times)} different times; match takes one image a table: see track")
    return times.iloc[0]


def _elapsed_s(before: pd.Timestamp | None, after: pd.Timestamp | None) -> float:
    if before is None or after is None:
        raise ConfigError("the time between the tables is not known: give --elapsed-s, or a column t_utc in both")
    elapsed_s = float((after - before).total_seconds())
    if elapsed_s <= 0:
        raise ConfigError(f"the later table is {-elapsed_s:g} s earlier than the first: give them the other way round")
    return elapsed_s


def _sequence_of(before: pd.DataFrame, after: pd.DataFrame) -> str:
    """Return the sequence that both tables name, ``all`` where they name none or several."""
    names = {str(name) for rows in (before, after) if "sequence" in rows for name in rows["sequence"].dropna().unique()}
    return names.pop() if len(names) == 1 else "all"


def _timeless(table: Table) -> Table:
    """Return *table* with times that may be null: tables of detections need not tell any."""
    return replace(table, columns=tuple(replace(c, nullable=c.nullable or c.name in TIMES) for c in table.columns))
