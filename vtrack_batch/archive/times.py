"""What each file says about its time: by its name, a line of an index, or EXIF."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from vtrack_batch.archive.columns import FrameColumns
from vtrack_batch.archive.exif import exif_stamp
from vtrack_batch.archive.index import Entry, read_index
from vtrack_batch.archive.names import escape
from vtrack_batch.archive.params import ArchiveParams
from vtrack_batch.archive.patterns import AmbiguousNameError, IsoLikeNames, NamePattern, compile_pattern
from vtrack_batch.archive.stamps import Stamp, stamp_from_text
from vtrack_batch.archive.walk import File
from vtrack_batch.errors import ConfigError, UnusableFrame
from vtrack_batch.model.known import Known

NO_PLATFORM = "main"
MOST_EXAMPLES = 3


@dataclass
class Findings:
    """What has been found so far, file by file."""

    files: Iterable[File]
    known: Known
    frames: FrameColumns = field(default_factory=FrameColumns)
    refused: list[tuple[str, str, str]] = field(default_factory=list)
    others: int = 0
    other_examples: list[str] = field(default_factory=list)
    source: str = ""

    def accept(self, file: File, text: str, stamp: Stamp, platform: str) -> None:
        """Keep a frame whose time is known."""
        path = escape(file.name)
        fact = self.known.get(path)
        sha256 = fact.sha256 if fact is not None and fact[:2] == file[1:] else None
        self.frames.append(path, file, escape(text), stamp, platform, sha256)

    def refuse(self, name: str, reason: str, detail: str) -> None:
        """Put the file *name* aside."""
        self.refused.append((escape(name), reason, detail))

    def pass_over(self, name: str) -> None:
        """Count a file that is no frame."""
        self.others += 1
        if len(self.other_examples) < MOST_EXAMPLES:
            self.other_examples.append(name)


@dataclass(frozen=True)
class TimeSource:
    """Where times come from: an index, EXIF, a pattern, or ISO-like names."""

    root: Path
    params: ArchiveParams
    base: Path

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
        total, found = len(entries), 0
        for file in findings.files:
            lines = entries.pop(file.name, None)
            if lines is None:
                self._other(file, "not_in_index", f"{path.name} has no line for it", findings)
            else:
                found += 1
                self._indexed(file, lines, path.name, findings)
        for name, lines in entries.items():
            findings.refuse(
                name, "file_missing", f"named in line {lines[0].line} of {path.name}, but not in the archive"
            )
        if total and not found:
            example = escape(next(iter(entries)))
            raise ConfigError(
                f"archive.index: none of the {total} files in {path} lies below {self.root}, e.g. {example}"
            )

    def _indexed(self, file: File, lines: list[Entry], index: str, findings: Findings) -> None:
        first = lines[0]
        stamp = stamp_from_text(first.time)
        if any(line[1:] != first[1:] for line in lines):
            numbers = ", ".join(str(line.line) for line in lines[:5])
            findings.refuse(file.name, "index_contradicts", f"lines {numbers} of {index} do not agree on it")
        elif stamp is None:
            detail = f"line {first.line} of {index}: {escape(first.time)[:60]!r} is no ISO 8601 date and time"
            findings.refuse(file.name, "time_unreadable", detail)
        else:
            platform = escape(first.platform) if first.platform else self._directory(file.name)
            findings.accept(file, first.time, stamp, platform)

    def _from_exif(self, findings: Findings) -> None:
        findings.source = "EXIF"
        for file in findings.files:
            if not has_extension(file.name, self.params):
                findings.pass_over(file.name)
                continue
            fact = findings.known.get(escape(file.name))
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
                findings.accept(file, text, stamp, self._directory(file.name))
        timeless = findings.refused and all(row[1] == "no_exif_time" for row in findings.refused)
        if timeless and not len(findings.frames):
            raise ConfigError(
                "archive.exif: no frame holds DateTimeOriginal; write archive.pattern or archive.index instead"
            )

    def _from_names(self, pattern: NamePattern | IsoLikeNames, findings: Findings) -> None:
        findings.source = pattern.text
        strangers: list[File] = []
        given = isinstance(pattern, NamePattern)
        for file in findings.files:
            if not given and not has_extension(file.name, self.params):
                findings.pass_over(file.name)
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
            findings.accept(file, _base(file.name), reading.stamp, platform)
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
            findings.pass_over(file.name)

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
