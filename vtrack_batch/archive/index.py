"""Times from an index: a CSV file that names each frame's file and time."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple

from vtrack_batch.errors import ConfigError

_FILE = ("file", "path", "filename", "name", "image", "frame")
_TIME = ("time", "t_utc", "timestamp", "datetime", "time_utc")
_PLATFORM = ("platform", "camera", "sequence")


class Entry(NamedTuple):
    """One line of the index: its number, the time as written, and the platform (None = it does not say)."""

    line: int
    time: str
    platform: str | None


def read_index(path: Path) -> dict[str, list[Entry]]:
    """Return the lines of the index by file, in their order; ConfigError if it is no readable table of file and time.

    The separator is a comma, a semicolon or a tab; the header names the columns.
    """
    try:
        with path.open(encoding="utf-8-sig", errors="surrogateescape", newline="") as file:
            header = file.readline()
            separator = max(",;\t", key=header.count)
            columns = [cell.strip().lower() for cell in next(csv.reader([header], delimiter=separator), [])]
            at_file, at_time = _column(columns, _FILE), _column(columns, _TIME)
            if at_file is None or at_time is None:
                raise ConfigError(
                    f"archive.index: {path} needs a header line with the columns file and time; "
                    f"it begins with {header.strip()[:80]!r}"
                )
            return _entries(csv.reader(file, delimiter=separator), at_file, at_time, _column(columns, _PLATFORM))
    except FileNotFoundError:
        raise ConfigError(f"archive.index: {path} does not exist (it is looked for beside the survey file)") from None
    except (OSError, csv.Error) as error:
        raise ConfigError(f"archive.index: {path} cannot be read: {error}") from error


def _entries(
    rows: csv._reader,  # type: ignore[name-defined] # the type has no public name
    at_file: int,
    at_time: int,
    at_platform: int | None,
) -> dict[str, list[Entry]]:
    entries: dict[str, list[Entry]] = {}
    for row in rows:
        if not row:
            continue
        cells = [cell.strip() for cell in row] + [""] * max(0, max(at_file, at_time, at_platform or 0) + 1 - len(row))
        platform = cells[at_platform] or None if at_platform is not None else None
        name = cells[at_file].removeprefix("./")
        entries.setdefault(name, []).append(Entry(rows.line_num + 1, cells[at_time], platform))
    return entries


def _column(columns: list[str], names: tuple[str, ...]) -> int | None:
    return next((columns.index(name) for name in names if name in columns), None)
