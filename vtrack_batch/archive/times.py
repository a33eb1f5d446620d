"""What each file says about its time: by its name, a line of an index, or EXIF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from vtrack_batch.archive.clock import Stamp, stamp_from_text
from vtrack_batch.archive.exif import exif_stamp
from vtrack_batch.archive.index import read_index
from vtrack_batch.archive.names import escape
from vtrack_batch.archive.params import ArchiveParams
from vtrack_batch.archive.patterns import AmbiguousNameError, IsoLikeNames, NamePattern, compile_pattern
from vtrack_batch.archive.walk import File
from vtrack_batch.errors import ConfigError, UnusableFrame

NO_PLATFORM = "main"


class KnownFile(NamedTuple):
    """What an earlier scan and read found of a file; it holds as long as size and mtime are the same."""

    size_bytes: int
    mtime_ns: int
    sha256: str | None = None
    stamp: str | None = None


class Frame(NamedTuple):
    """A frame, its time as written and as understood, and its platform."""

    file: File
    text: str
    stamp: Stamp
    platform: str


@dataclass
class Findings:
    """What has been found so far, frame by frame."""

    files: list[File]
    frames: list[Frame] = field(default_factory=list)
    refused: list[tuple[str, str, str]] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    source: str = ""

    def refuse(self, name: str, reason: str, detail: str) -> None:
        """Put the file *name* aside."""
        self.refused.append((escape(name), reason, detail))


@dataclass(frozen=True)
class TimeSource:
    """Where times come from: an index, EXIF, a pattern, or ISO-like names."""

    root: Path
    params: ArchiveParams
    base: Path
    known: Mapping[str, KnownFile]

    def read(self, findings: Findings) -> None:
        """Sort ``findings.files`` into frames, refused and others; ConfigError if the source fits none of them."""
        if self.params.index is not None:
            self._from_index(self.base / self.params.index, findings)
        elif self.params.exif:
            self._from_exif(findings)
        elif self.params.pattern is not None:
            self._from_names(compile_pattern(self.params.pattern), findings)
        else:
            self._from_names(IsoLikeNames(), findings)

    def _from_index(self, path: Path, findings: Findings) -> None:
        findings.source = f"the index {path.name}"
        entries = read_index(path)
        by_name = {file.name: file for file in findings.files}
        for file in findings.files:
            if file.name not in entries:
                self._other(file, "not_in_index", f"{path.name} has no line for it", findings)
        for name, lines in entries.items():
            first = lines[0]
            stamp = stamp_from_text(first.time)
            if name not in by_name:
                findings.refuse(
                    name, "file_missing", f"named in line {first.line} of {path.name}, but not in the archive"
                )
            elif any(line[1:] != first[1:] for line in lines):
                numbers = ", ".join(str(line.line) for line in lines[:5])
                findings.refuse(name, "index_contradicts", f"lines {numbers} of {path.name} do not agree on it")
            elif stamp is None:
                detail = f"line {first.line} of {path.name}: {escape(first.time)[:60]!r} is no ISO 8601 date and time"
                findings.refuse(name, "time_unreadable", detail)
            else:
                platform = escape(first.platform) if first.platform else self._directory(name)
                findings.frames.append(Frame(by_name[name], first.time, stamp, platform))
        if entries and not findings.frames and not any(name in by_name for name in entries):
            example = escape(next(iter(entries)))
            raise ConfigError(
                f"archive.index: none of the {len(entries)} files in {path} lies below {self.root}, e.g. {example}"
            )

    def _from_exif(self, findings: Findings) -> None:
        findings.source = "EXIF"
        for file in findings.files:
            if not has_extension(file.name, self.params):
                findings.others.append(file.name)
                continue
            fact = self.known.get(escape(file.name))
            try:
                if fact is not None and fact.stamp and fact[:2] == file[1:]:
                    text = fact.stamp
                else:
                    text = exif_stamp(self.root, file.name)
            except UnusableFrame as error:
                findings.refuse(file.name, error.reason, error.detail)
                continue
            stamp = stamp_from_text(text)
            if stamp is None:
                findings.refuse(file.name, "time_unreadable", f"EXIF says {escape(text)[:60]!r}")
            else:
                findings.frames.append(Frame(file, text, stamp, self._directory(file.name)))
        if (
            findings.files
            and findings.refused
            and all(row[1] == "no_exif_time" for row in findings.refused)
            and not findings.frames
        ):
            raise ConfigError(
                "archive.exif: no frame holds DateTimeOriginal; write archive.pattern or archive.index instead"
            )

    def _from_names(self, pattern: NamePattern | IsoLikeNames, findings: Findings) -> None:
        findings.source = pattern.text
        strangers: list[File] = []
        given = isinstance(pattern, NamePattern)
        for file in findings.files:
            if not given and not has_extension(file.name, self.params):
                findings.others.append(file.name)
                continue
            try:
                reading = pattern.read(file.name)
            except AmbiguousNameError as error:
                raise ConfigError(_advice(f"{escape(file.name)}: {error}")) from error
            if reading is None:
                strangers.append(file)
                continue
            if reading.stamp is None:
                findings.refuse(file.name, "time_unreadable", "its digits are no date and time of day")
                continue
            platform = escape(reading.platform) if reading.platform else self._directory(file.name, pattern.whole_path)
            findings.frames.append(Frame(file, _base(file.name), reading.stamp, platform))
        self._judge_strangers(strangers, pattern, findings)

    def _judge_strangers(self, strangers: list[File], pattern: NamePattern | IsoLikeNames, findings: Findings) -> None:
        images = [file for file in strangers if has_extension(file.name, self.params)]
        fitting = len(findings.frames)
        if isinstance(pattern, NamePattern):
            if images and not fitting and not any(row[1] == "time_unreadable" for row in findings.refused):
                what = "the path" if pattern.whole_path else "the file name"
                example = escape(images[0].name)
                raise ConfigError(
                    f"archive.pattern: none of {len(images)} names fits {pattern.text!r}, e.g. {example}; "
                    f"the pattern must describe {what} from its beginning to its end"
                )
        elif len(images) > fitting:
            example = escape(images[0].name)
            raise ConfigError(
                _advice(f"{len(images)} of {len(images) + fitting} names hold no date and time, e.g. {example}")
            )
        for file in strangers:
            self._other(file, "name_not_matched", f"its name does not fit {pattern.text}", findings)

    def _other(self, file: File, reason: str, detail: str, findings: Findings) -> None:
        if has_extension(file.name, self.params):
            findings.refuse(file.name, reason, detail)
        else:
            findings.others.append(file.name)

    def _directory(self, name: str, directories_are_spoken_for: bool = False) -> str:
        if self.params.platform_from == "none" or directories_are_spoken_for:
            return NO_PLATFORM
        return escape(name.rpartition("/")[0]) or NO_PLATFORM


def has_extension(name: str, params: ArchiveParams) -> bool:
    """Tell whether *name* ends like a frame's."""
    return name.lower().endswith(params.extensions)


def _base(name: str) -> str:
    return name.rpartition("/")[2]


def _advice(trouble: str) -> str:
    return (
        f"archive: {trouble}. Say how times are known: archive.pattern, such as "
        "'{camera}_{time:%Y%m%d_%H%M%S}.jpg'; or archive.index, a CSV with the columns file and time; "
        "or archive.exif: true"
    )
