"""The frames of an archive and their times: one pass over the directory, nothing decoded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from vtrack_batch.archive.clock import to_utc
from vtrack_batch.archive.columns import CHUNK_ROWS
from vtrack_batch.archive.names import escape
from vtrack_batch.archive.params import LOCAL, ArchiveParams
from vtrack_batch.archive.times import Findings, TimeSource, has_extension
from vtrack_batch.archive.walk import File, Fingerprint, Refused, walk
from vtrack_batch.errors import ConfigError, NoArchive
from vtrack_batch.model.known import Known

OUT_OF_PERIOD = "time_out_of_range"
"""Reason of frames outside the survey's own start and end: set aside as asked, so no loss."""

WORLD_FILE_ENDINGS = ("w", ".wld")


@dataclass(frozen=True)
class Period:
    """Bounds of the survey in UTC: frames from ``start`` on and before ``end``; None = unbounded."""

    start: pd.Timestamp | None = None
    end: pd.Timestamp | None = None


@dataclass(frozen=True)
class Scan:
    """What an archive holds.

    ``files``: path (below the root, with '/', odd characters escaped; ``read_bytes`` takes it), size_bytes, mtime_ns,
    platform, stamp (the time as written), t_utc, sha256 (null unless known), sorted by path. ``quarantine``: path,
    reason, detail. ``pending``: paths of files too young to be read. ``others``: how many files are no frames, and
    examples. ``source``: where times came from, for people. ``beside``: paths of files named like world files.
    ``listing``: as ``walk.listing_of``.
    """

    files: pd.DataFrame
    quarantine: pd.DataFrame
    pending: tuple[str, ...] = ()
    others: int = 0
    other_examples: tuple[str, ...] = ()
    source: str = ""
    beside: frozenset[str] = frozenset()
    listing: str | None = None


def scan(
    root: Path,
    params: ArchiveParams,
    *,
    base: Path,
    time_zone: str | None = None,
    known: Known | None = None,
    period: Period | None = None,
) -> Scan:
    """Scan the archive at *root*.

    *base*: directory of the survey file, for ``params.index``; *time_zone*: the survey's, meant by ``local``; *known*:
    by path, facts that need not be read again (the caller leaves out files whose mtime lay within 2 s of the scan that
    recorded them, for such may have changed since). Raises NoArchive (missing, or no frame in it) and ConfigError (no
    name fits the pattern, no time zone for stamps without one, unreadable index).
    """
    known = {} if known is None else known
    sifter = _Sifter(root, params)
    findings = Findings(sifter.settled(), known)
    TimeSource(root, params, base).read(findings)
    findings.refused += sifter.refused
    if not len(findings.frames) and not findings.refused and not sifter.pending:
        raise NoArchive(_nothing_found(root, findings, len(known)))
    files = _files(findings, _zone(findings, params, time_zone), params)
    files = _inside(files, period or Period(), findings)
    return Scan(
        files=files,
        quarantine=_quarantine(findings.refused),
        pending=tuple(sifter.pending),
        others=findings.others,
        other_examples=tuple(escape(name) for name in findings.other_examples),
        source=findings.source,
        beside=frozenset(sifter.beside),
        listing=sifter.listing(),
    )


class _Sifter:
    """Passes on the files of an archive that may be read, and notes the rest."""

    def __init__(self, root: Path, params: ArchiveParams) -> None:
        self._root, self._params = root, params
        self._fingerprint = Fingerprint(params.settle_s)
        self.refused: list[tuple[str, str, str]] = []
        self.pending: list[str] = []
        self.beside: set[str] = set()

    def settled(self) -> Iterator[File]:
        """Yield the files that are old enough."""
        for found in walk(self._root):
            old_enough = self._fingerprint.add(found)
            if isinstance(found, Refused):
                name, reason, _ = found
                is_frame = has_extension(name, self._params)
                if reason != "not_a_regular_file" or is_frame or (self._root / name).is_dir():
                    self.refused.append((escape(name), *found[1:]))
            elif old_enough:
                if found.name[-1:] in "wWdD" and found.name.lower().endswith(WORLD_FILE_ENDINGS):
                    self.beside.add(escape(found.name))
                yield found
            elif has_extension(found.name, self._params):
                self.pending.append(escape(found.name))

    def listing(self) -> str | None:
        """Return the fingerprint of what was passed on or refused."""
        return self._fingerprint.value()


def _zone(findings: Findings, params: ArchiveParams, survey_zone: str | None) -> str | None:
    """Return the zone for stamps without one; ConfigError if there are such stamps and no zone was stated."""
    zone = survey_zone if params.time_zone == LOCAL else params.time_zone
    if zone is None:
        naive = findings.frames.first_naive()
        if naive is not None:
            missing = "survey.time_zone is not given" if params.time_zone == LOCAL else "it is never guessed"
            raise ConfigError(
                f"archive.time_zone: the time in {naive} says no time zone, and {missing}; "
                "write archive.time_zone: UTC, or the zone of the camera's clock, such as Europe/Berlin"
            )
    return zone


def _files(findings: Findings, zone: str | None, params: ArchiveParams) -> pd.DataFrame:
    """Return the files table of all frames whose time is known; the others go to quarantine."""
    frames, table = findings.frames, findings.frames.table()
    utc = to_utc(frames.clock_us(), frames.offset_s(), table["platform"], time_zone=zone, max_gap_s=params.max_gap_s)
    for at in np.flatnonzero(utc.ambiguous):
        detail = f"in {zone} this time came twice that night, and its neighbours do not tell which it is"
        findings.refused.append((table["path"].iloc[at], "ambiguous_time", detail))
    for at in np.flatnonzero(utc.nonexistent):
        detail = f"in {zone} the clocks were put forward over this time"
        findings.refused.append((table["path"].iloc[at], "nonexistent_time", detail))
    table["t_utc"] = pd.DatetimeIndex(utc.t_utc).tz_localize("UTC")
    if table["t_utc"].isna().any():
        table = table[table["t_utc"].notna()]
    if not _is_rising(table["path"]):
        table = table.sort_values("path")
    return table.reset_index(drop=True)


def _is_rising(texts: pd.Series) -> bool:
    """Tell whether *texts* are in order; asked piece by piece, for pandas makes an object of each to compare it."""
    starts = range(0, len(texts), CHUNK_ROWS)
    return all(texts.iloc[at : at + CHUNK_ROWS + 1].is_monotonic_increasing for at in starts)


def _inside(files: pd.DataFrame, period: Period, findings: Findings) -> pd.DataFrame:
    if period == Period():
        return files
    early = files["t_utc"] < period.start if period.start is not None else pd.Series(False, files.index)
    late = files["t_utc"] >= period.end if period.end is not None else pd.Series(False, files.index)
    for mask, text in ((early, "before survey.start"), (late, "not before survey.end")):
        for path, t_utc in files.loc[mask, ["path", "t_utc"]].itertuples(index=False):
            findings.refused.append((path, OUT_OF_PERIOD, f"{t_utc.isoformat()} lies {text}"))
    return files[~(early | late)].reset_index(drop=True)


def _quarantine(rows: list[tuple[str, str, str]]) -> pd.DataFrame:
    table = pd.DataFrame(rows, columns=["path", "reason", "detail"], dtype=object)
    return table.sort_values(["path", "reason"]).drop_duplicates("path").reset_index(drop=True)


def _nothing_found(root: Path, findings: Findings, known: int) -> str:
    text = f"the archive {root} holds no frame"
    if known:
        text += f": 0 of {known} known frames found; is it mounted?"
    elif findings.others:
        text += f": {findings.others} other files, such as {escape(findings.other_examples[0])}"
    return text
