"""Step ``index``: walk the archive, give every file its time, sequence, id and content hash."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from vtrack_batch.archive.read import read_bytes
from vtrack_batch.archive.scan import Period, Scan, scan
from vtrack_batch.archive.sequences import resolve_duplicates, split_sequences
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import UnusableFrame
from vtrack_batch.model.ids import frame_id
from vtrack_batch.storage.hashes import HashStore


@dataclass(frozen=True)
class Index:
    """What the archive holds.

    ``frames``: one row per usable file, sorted by sequence and time: frame_id, path (escaped), name (as on disk),
    platform, sequence, date, t_utc, sha256. ``quarantine``: path, reason, detail of files that are set aside.
    """

    root: Path
    frames: pd.DataFrame
    quarantine: pd.DataFrame
    scan: Scan


def make_index(survey: Survey, hashes: HashStore) -> Index:
    """Walk the archive of *survey*.

    Raises ``NoArchive`` when it is missing or holds no frame, ``ConfigError`` when no time can be told.
    """
    root = survey.resolve(survey.archive.root)
    found = scan_archive(survey)
    files, quarantine = found.files, [found.quarantine]
    unreadable: list[tuple[str, str, str]] = []

    def hash_of(name: str) -> str | None:
        try:
            return hashlib.sha256(read_bytes(root, name)).hexdigest()
        except UnusableFrame as problem:
            unreadable.append((name, problem.reason, problem.detail))
            return None

    stats = zip(files["name"], files["size_bytes"].tolist(), files["mtime_ns"].tolist(), strict=True)
    known = hashes.fill(stats, hash_of)
    escaped = dict(zip(files["name"], files["path"], strict=True))
    quarantine.append(
        pd.DataFrame([(escaped[name], reason, detail) for name, reason, detail in unreadable], columns=_QUARANTINE)
    )
    files = files.assign(sha256=files["name"].map(known)).dropna(subset=["sha256"])
    files, doubles = resolve_duplicates(files)
    quarantine.append(doubles)
    files = split_sequences(files, max_gap_s=survey.archive.max_gap_s, time_zone=survey.survey.time_zone)
    frames = files.assign(frame_id=[frame_id(name) for name in files["name"]])
    frames = frames.sort_values(["sequence", "t_utc", "name"], kind="stable", ignore_index=True)
    set_aside = pd.concat(
        [part[_QUARANTINE] for part in quarantine if len(part)] or [pd.DataFrame(columns=_QUARANTINE)]
    )
    return Index(root, frames, set_aside.sort_values("path", ignore_index=True), found)


def scan_archive(survey: Survey) -> Scan:
    """Walk the archive of *survey* without reading its files."""
    bounds = (pd.Timestamp(moment) if moment else None for moment in (survey.survey.start, survey.survey.end))
    return scan(
        survey.resolve(survey.archive.root),
        survey.archive,
        base=survey.base,
        time_zone=survey.survey.time_zone,
        period=Period(*bounds),
    )


_QUARANTINE = ["path", "reason", "detail"]
