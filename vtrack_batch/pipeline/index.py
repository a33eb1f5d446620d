"""Step ``index``: walk the archive, give every file its time, sequence, id and content hash."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.archive.names import unescape
from vtrack_batch.archive.read import content_hash, read_bytes
from vtrack_batch.archive.scan import Period, Scan, scan
from vtrack_batch.archive.sequences import resolve_duplicates, split_sequences
from vtrack_batch.archive.walk import RACY_S
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import NoArchive, StorageError, UnusableFrame
from vtrack_batch.model.known import Known, KnownFile
from vtrack_batch.pipeline.culprits import Culprits
from vtrack_batch.pipeline.ground import world_files
from vtrack_batch.storage.hashes import FileStore
from vtrack_batch.storage.memory import pack_tightly

MOST_IO_ERRORS = 20
"""After so many files in a row that the disk refuses, it is the disk and not the files."""

BATCH = 10_000
_QUARANTINE = ["path", "reason", "detail"]
_NEEDED = ["path", "platform", "t_utc", "sha256"]


@dataclass(frozen=True)
class Index:
    """What the archive holds.

    ``frames``: one row per usable file, sorted by sequence and time: path (printable text below the root), platform,
    sequence, date, t_utc, sha256, and, where there are world files, beside (the hash of its own, or "").
    ``quarantine``: path, reason, detail of the files that are set aside. ``listing``: fingerprint of the archive's
    files, None where one is too young to be trusted.
    """

    root: Path
    frames: pd.DataFrame
    quarantine: pd.DataFrame
    listing: str | None

    def content(self) -> str:
        """Return the hash of the contents of all frames, whatever their names and order."""
        ordered = self.frames["sha256"].sort_values(ignore_index=True)
        whole = hashlib.sha256()
        for start in range(0, len(ordered), BATCH):
            whole.update("".join(ordered.iloc[start : start + BATCH]).encode("ascii"))
        return whole.hexdigest()[:32]


def make_index(survey: Survey, store: FileStore, culprits: Culprits) -> Index:
    """Walk the archive of *survey*; frames that workers died of are set aside.

    Raises ``NoArchive`` when it is missing or holds no frame, ``ConfigError`` when no time can be told,
    ``StorageError`` when the disk under it fails.
    """
    pack_tightly()
    root = survey.resolve(survey.archive.root)
    found = scan_archive(survey, known=store)
    frames, unreadable = _hashed(root, found.files, store)
    # of a million frames each column counts: what is not needed any more is let go
    frames = frames.drop(columns=[name for name in frames.columns if name not in _NEEDED])
    found = replace(found, files=frames)
    frames, fatal = culprits.sifted(frames)
    frames, doubles = resolve_duplicates(frames)
    frames = split_sequences(frames, max_gap_s=survey.archive.max_gap_s, time_zone=survey.survey.time_zone)
    if not frames["sequence"].cat.codes.is_monotonic_increasing:
        frames = frames.sort_values(["sequence", "t_utc", "path"], kind="stable", ignore_index=True)
    if found.beside:
        frames["beside"] = _texts(_world_file_hashes(root, frames["path"], found.beside))
    parts = [part for part in (found.quarantine, unreadable, fatal, doubles) if len(part)]
    set_aside = pd.concat(parts or [pd.DataFrame(columns=_QUARANTINE)])
    return Index(root, frames, set_aside.sort_values("path", ignore_index=True), found.listing)


def _texts(values: Iterable[str]) -> pd.Series:
    """Return *values* as packed text, never all as objects at once."""
    values = iter(values)
    chunks = []
    while chunk := list(islice(values, BATCH)):
        chunks.append(pd.Series(chunk, dtype="str"))
    return pd.concat(chunks, ignore_index=True) if chunks else pd.Series([], dtype="str")


def scan_archive(survey: Survey, known: Known | None = None) -> Scan:
    """Walk the archive of *survey* without reading its files."""
    bounds = (pd.Timestamp(moment) if moment else None for moment in (survey.survey.start, survey.survey.end))
    return scan(
        survey.resolve(survey.archive.root),
        survey.archive,
        base=survey.base,
        time_zone=survey.survey.time_zone,
        known=known,
        period=Period(*bounds),
    )


class _Read(NamedTuple):
    row: int
    path: str
    sha256: str


def _hashed(root: Path, files: pd.DataFrame, store: FileStore) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return *files* with the hashes of all that can be read, and those that cannot with their reasons."""
    unknown = np.flatnonzero(files["sha256"].isna())
    if not len(unknown):
        return files, pd.DataFrame(columns=_QUARANTINE)
    refused: list[tuple[str, str, str]] = []
    hashes = []
    youngest_ns = time.time_ns() - int(RACY_S * 1e9)
    for batch in _batches(_read(root, files["path"], unknown, refused)):
        hashes.append(pd.Series([read.sha256 for read in batch], [read.row for read in batch], dtype="str"))
        rows = files.iloc[hashes[-1].index].assign(sha256=hashes[-1])
        store.remember(_facts(rows[rows["mtime_ns"] <= youngest_ns]))
    if len(refused) == len(unknown) == len(files) and all(reason == "file_missing" for _, reason, _ in refused):
        raise NoArchive(f"{root}: all files vanished while they were read; is it mounted?")
    if hashes:
        read = pd.concat(hashes)
        files["sha256"] = read if len(read) == len(files) else files["sha256"].fillna(read)
    if refused:
        files = files[files["sha256"].notna()].reset_index(drop=True)
    return files, pd.DataFrame(refused, columns=_QUARANTINE)


def _read(
    root: Path, paths: pd.Series, rows: NDArray[np.int64], refused: list[tuple[str, str, str]]
) -> Iterator[_Read]:
    failures = 0
    for row, path in zip(rows, paths.iloc[rows], strict=True):
        try:
            digest = content_hash(read_bytes(root, path))
        except UnusableFrame as problem:
            refused.append((path, problem.reason, problem.detail))
            failures = failures + 1 if problem.reason == "io_error" else 0
            if failures >= MOST_IO_ERRORS:
                raise StorageError(
                    f"{root}: {failures} files in a row cannot be read, the last is {path} ({problem.detail}); "
                    "is the disk failing or the mount gone?"
                ) from None
            continue
        failures = 0
        yield _Read(int(row), path, digest)


def _batches(reads: Iterator[_Read]) -> Iterator[list[_Read]]:
    batch: list[_Read] = []
    for read in reads:
        batch.append(read)
        if len(batch) >= BATCH:
            yield batch
            batch = []
    if batch:
        yield batch


def _facts(rows: pd.DataFrame) -> Iterator[tuple[str, KnownFile]]:
    columns = (rows[name].tolist() for name in ("path", "size_bytes", "mtime_ns", "sha256", "stamp"))
    for path, *facts in zip(*columns, strict=True):
        yield path, KnownFile(*facts)


def _world_file_hashes(root: Path, paths: Iterable[str], beside: frozenset[str]) -> Iterator[str]:
    """Yield the hash of the world file beside each frame, "" where there is none."""
    listed = {root / unescape(path) for path in beside}
    for path in paths:
        found = world_files(root, path, listed)[:1]
        yield "".join(content_hash(file.read_bytes()) for file in found)
