"""Step ``index``: walk the archive, give every file its time, sequence, id and content hash."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from vtrack_batch.archive.names import unescape
from vtrack_batch.archive.read import content_hash, read_bytes
from vtrack_batch.archive.scan import Period, Scan, scan
from vtrack_batch.archive.sequences import resolve_duplicates, split_sequences
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import UnusableFrame
from vtrack_batch.model.ids import frame_id
from vtrack_batch.pipeline.ground import world_files
from vtrack_batch.storage.hashes import HashStore


@dataclass(frozen=True)
class Index:
    """What the archive holds.

    ``frames``: one row per usable file, sorted by sequence and time: frame_id, path (printable text below the root),
    platform, sequence, date, t_utc, sha256, beside (hash of its world file, or ""). ``quarantine``: path, reason,
    detail of the files that are set aside.
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
    unreadable: list[tuple[str, str, str]] = []

    def hash_of(path: str) -> str | None:
        try:
            return content_hash(read_bytes(root, path))
        except UnusableFrame as problem:
            unreadable.append((path, problem.reason, problem.detail))
            return None

    files = found.files
    stats = zip(files["path"], files["size_bytes"].tolist(), files["mtime_ns"].tolist(), strict=True)
    files = files.assign(sha256=files["path"].map(hashes.fill(stats, hash_of))).dropna(subset=["sha256"])
    files, doubles = resolve_duplicates(files)
    files = split_sequences(files, max_gap_s=survey.archive.max_gap_s, time_zone=survey.survey.time_zone)
    frames = files.assign(frame_id=[frame_id(path) for path in files["path"]], beside=_world_file_hashes(root, files))
    frames = frames.sort_values(["sequence", "t_utc", "path"], kind="stable", ignore_index=True)
    parts = [found.quarantine, pd.DataFrame(unreadable, columns=_QUARANTINE), doubles]
    set_aside = pd.concat([part[_QUARANTINE] for part in parts if len(part)] or [pd.DataFrame(columns=_QUARANTINE)])
    return Index(root, frames, set_aside.sort_values("path", ignore_index=True), found)


_QUARANTINE = ["path", "reason", "detail"]


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


def _world_file_hashes(root: Path, files: pd.DataFrame) -> list[str]:
    """Return the hash of the world file beside each frame, "" where there is none."""
    folders = {(root / unescape(path)).parent for path in files["path"]}
    listed = {file for folder in folders for file in folder.iterdir()}
    beside = [world_files(root, path, listed) for path in files["path"]]
    return ["".join(content_hash(file.read_bytes()) for file in found[:1]) for found in beside]
