"""Every regular file below a directory, in an order that does not depend on the file system."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from vtrack_batch.errors import NoArchive

_TEMPORARY_ENDINGS = ("~", ".part", ".partial", ".tmp", ".temp", ".crdownload", ".filepart", ".swp")


class File(NamedTuple):
    """A file as found: its path below the root with '/', bytes that are no UTF-8 as surrogates."""

    name: str
    size_bytes: int
    mtime_ns: int


@dataclass
class Listing:
    """Regular files by the bytes of their paths; what was passed over (name, reason, detail); directories entered."""

    files: list[File] = field(default_factory=list)
    refused: list[tuple[str, str, str]] = field(default_factory=list)


def walk(root: Path) -> Listing:
    """List the regular files below *root*, without following links and without hidden or temporary names.

    Links, pipes and sockets with any name, and directories that cannot be read, are in ``refused``. Raises NoArchive if
    *root* is missing, no directory or unreadable.
    """
    if not root.exists():
        raise NoArchive(f"the archive {root} does not exist")
    if not root.is_dir():
        raise NoArchive(f"the archive {root} is not a directory")
    listing = Listing()
    pending = [""]
    while pending:
        directory = pending.pop()
        try:
            with os.scandir(root / directory) as entries:
                found = list(entries)
        except OSError as error:
            if not directory:
                raise NoArchive(f"the archive {root} cannot be read: {error.strerror}") from error
            listing.refused.append((directory, "permission", f"the directory cannot be read: {error.strerror}"))
            continue
        for entry in found:
            if not is_temporary(entry.name):
                _sort_in(entry, f"{directory}/{entry.name}" if directory else entry.name, listing, pending)
    listing.files.sort(key=lambda file: os.fsencode(file.name))
    listing.refused.sort(key=lambda row: os.fsencode(row[0]))
    return listing


def is_temporary(name: str) -> bool:
    """Tell whether *name* is hidden (also: rsync's ``.name.XXXXXX``) or of a file still being written."""
    return name.startswith(".") or name.lower().endswith(_TEMPORARY_ENDINGS)


def _sort_in(entry: os.DirEntry[str], name: str, listing: Listing, pending: list[str]) -> None:
    try:
        status = entry.stat(follow_symlinks=False)
    except FileNotFoundError:
        return  # removed while we looked: it is not there
    except OSError as error:
        listing.refused.append((name, "io_error", f"its size and time cannot be read: {error.strerror}"))
        return
    if stat.S_ISDIR(status.st_mode):
        pending.append(name)
    elif stat.S_ISREG(status.st_mode):
        listing.files.append(File(name, status.st_size, status.st_mtime_ns))
    else:
        kind = "a symbolic link" if stat.S_ISLNK(status.st_mode) else "a pipe, socket or device"
        listing.refused.append((name, "not_a_regular_file", f"{kind} is not followed"))
