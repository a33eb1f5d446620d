"""The frames of an archive and their times: one pass over the directory, nothing decoded."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from vtrack_batch.archive.clock import to_utc
from vtrack_batch.archive.names import escape
from vtrack_batch.archive.params import LOCAL, ArchiveParams
from vtrack_batch.archive.times import Findings, KnownFile, TimeSource, has_extension
from vtrack_batch.archive.walk import File, walk
from vtrack_batch.errors import ConfigError, NoArchive

OUT_OF_PERIOD = "time_out_of_range"
"""Reason of frames outside the survey's own start and end: set aside as asked, so no loss."""

_FILE_COLUMNS = ("path", "name", "size_bytes", "mtime_ns", "platform", "stamp", "t_utc", "sha256")


@dataclass(frozen=True)
class Period:
    """Bounds of the survey in UTC: frames from ``start`` on and before ``end``; None = unbounded."""

    start: pd.Timestamp | None = None
    end: pd.Timestamp | None = None


@dataclass(frozen=True)
class Scan:
    """What an archive holds.

    ``files``: path (below the root, with '/', odd characters escaped; ``read_bytes`` takes it), name (the same),
    size_bytes, mtime_ns, platform, stamp (the time as written), t_utc, sha256 (null unless known), sorted by path.
    ``quarantine``: path, reason, detail. ``pending``: paths of files too young to be read. ``others``: how many files
    are no frames, and examples. ``source``: where times came from, for people.
    """

    files: pd.DataFrame
    quarantine: pd.DataFrame
    pending: tuple[str, ...] = ()
    others: int = 0
    other_examples: tuple[str, ...] = ()
    source: str = ""


def scan(
    root: Path,
    params: ArchiveParams,
    *,
    base: Path,
    time_zone: str | None = None,
    known: Mapping[str, KnownFile] | None = None,
    period: Period | None = None,
) -> Scan:
    """Scan the archive at *root*.

    *base*: directory of the survey file, for ``params.index``; *time_zone*: the survey's, meant by ``local``; *known*:
    by path, facts that need not be read again (the caller leaves out files whose mtime lay within 2 s of the scan that
    recorded them, for such may have changed since). Raises NoArchive (missing, or no frame in it) and ConfigError (no
    name fits the pattern, no time zone for stamps without one, unreadable index).
    """
    known = known or {}
    listing = walk(root)
    findings = Findings([file for file in listing.files if _settled(file, params)])
    pending = [file for file in listing.files if not _settled(file, params) and has_extension(file.name, params)]
    for name, reason, detail in listing.refused:
        if reason != "not_a_regular_file" or has_extension(name, params) or (root / name).is_dir():
            findings.refuse(name, reason, detail)
    TimeSource(root, params, base, known).read(findings)
    if not findings.frames and not findings.refused and not pending:
        raise NoArchive(_nothing_found(root, findings, len(known)))
    files = _files(findings, _zone(findings, params, time_zone), params, known)
    files = _inside(files, period or Period(), findings)
    return Scan(
        files=files,
        quarantine=_quarantine(findings.refused),
        pending=tuple(escape(file.name) for file in pending),
        others=len(findings.others),
        other_examples=tuple(escape(name) for name in findings.others[:3]),
        source=findings.source,
    )


def _zone(findings: Findings, params: ArchiveParams, survey_zone: str | None) -> str | None:
    """Return the zone for stamps without one; ConfigError if there are such stamps and no zone was stated."""
    zone = survey_zone if params.time_zone == LOCAL else params.time_zone
    if zone is None:
        naive = next((frame for frame in findings.frames if frame.stamp.offset_s is None), None)
        if naive is not None:
            missing = "survey.time_zone is not given" if params.time_zone == LOCAL else "it is never guessed"
            raise ConfigError(
                f"archive.time_zone: the time in {escape(naive.text)} says no time zone, and {missing}; "
                "write archive.time_zone: UTC, or the zone of the camera's clock, such as Europe/Berlin"
            )
    return zone


def _files(findings: Findings, zone: str | None, params: ArchiveParams, known: Mapping[str, KnownFile]) -> pd.DataFrame:
    """Return the files table of all frames whose time is known; the others go to quarantine."""
    frames = findings.frames
    utc = to_utc(
        [frame.stamp for frame in frames],
        [frame.platform for frame in frames],
        time_zone=zone,
        max_gap_s=params.max_gap_s,
    )
    for at in np.flatnonzero(utc.ambiguous):
        detail = f"in {zone} this time came twice that night, and its neighbours do not tell which it is"
        findings.refuse(frames[at].file.name, "ambiguous_time", detail)
    for at in np.flatnonzero(utc.nonexistent):
        findings.refuse(
            frames[at].file.name, "nonexistent_time", f"in {zone} the clocks were put forward over this time"
        )
    rows = []
    for frame in frames:
        path = escape(frame.file.name)
        fact = known.get(path)
        sha256 = fact.sha256 if fact is not None and fact[:2] == frame.file[1:] else None
        rows.append((path, path, *frame.file[1:], frame.platform, escape(frame.text), None, sha256))
    files = pd.DataFrame(rows, columns=list(_FILE_COLUMNS), dtype=object)
    files = files.astype({"size_bytes": "int64", "mtime_ns": "int64"})
    files["t_utc"] = pd.DatetimeIndex(utc.t_utc).tz_localize("UTC")
    return files[files["t_utc"].notna()].sort_values("path", ignore_index=True)


def _inside(files: pd.DataFrame, period: Period, findings: Findings) -> pd.DataFrame:
    early = files["t_utc"] < period.start if period.start is not None else pd.Series(False, files.index)
    late = files["t_utc"] >= period.end if period.end is not None else pd.Series(False, files.index)
    for mask, text in ((early, "before survey.start"), (late, "not before survey.end")):
        for path, t_utc in files.loc[mask, ["path", "t_utc"]].itertuples(index=False):
            findings.refused.append((path, OUT_OF_PERIOD, f"{t_utc.isoformat()} lies {text}"))
    return files[~(early | late)].reset_index(drop=True)


def _quarantine(rows: list[tuple[str, str, str]]) -> pd.DataFrame:
    table = pd.DataFrame(rows, columns=["path", "reason", "detail"], dtype=object)
    return table.sort_values(["path", "reason"]).drop_duplicates("path").reset_index(drop=True)


def _settled(file: File, params: ArchiveParams) -> bool:
    return params.settle_s == 0 or time.time_ns() - file.mtime_ns >= params.settle_s * 1e9


def _nothing_found(root: Path, findings: Findings, known: int) -> str:
    text = f"the archive {root} holds no frame"
    if known:
        text += f": 0 of {known} known frames found; is it mounted?"
    elif findings.others:
        text += f": {len(findings.others)} other files, such as {escape(findings.others[0])}"
    return text
