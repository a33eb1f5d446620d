"""Every regular file below a directory, in an order that does not depend on the file system."""

from __future__ import annotations

import hashlib
import os
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vtrack_batch.archive.read import unreadable
from vtrack_batch.errors import NoArchive

RACY_S = 2.0
"""A file modified so recently may change again within the clock's resolution."""

_TEMPORARY_ENDINGS = ("~", ".part", ".partial", ".tmp", ".temp", ".crdownload", ".filepart", ".swp")


class File(NamedTuple):
    """A file as found: its path below the root with '/', bytes that are no UTF-8 as surrogates."""

    name: str
    size_bytes: int
    mtime_ns: int


class Refused(NamedTuple):
    """Something that is passed over: a link, pipe or socket, a directory that cannot be read."""

    name: str
    reason: str
    detail: str


def walk(root: Path) -> Iterator[File | Refused]:
    """Yield the regular files below *root* by the bytes of their paths, without following links.

    Hidden and temporary names are left out. No more than the names of one directory, and of those that lead to it, are
    held at a time. Raises NoArchive if *root* is missing, no directory or unreadable.
    """
    if not root.exists():
        raise NoArchive(f"the archive {root} does not exist; see `archive.root` in the survey file")
    if not root.is_dir():
        raise NoArchive(f"the archive {root} is not a directory; `archive.root` names the folder that holds the frames")
    try:
        top = _names(root)
    except OSError as error:
        reason = unreadable(error, root).detail
        raise NoArchive(f"the archive {root} cannot be read: {reason}; may this user list it?") from error
    yield from _below(os.fspath(root), top)


class Fingerprint:
    """Of the names, sizes and times of the files that are older than *settle_s*."""

    def __init__(self, settle_s: float) -> None:
        self._digest = hashlib.sha256()
        self._now_ns = time.time_ns()
        self._settle_ns = int(settle_s * 1e9)
        self._trusted = True

    def add(self, found: File | Refused) -> bool:
        """Take in what `walk` yields next; returns whether it is old enough to be read."""
        age_ns = self._now_ns - found.mtime_ns if isinstance(found, File) else self._settle_ns
        if age_ns < self._settle_ns and self._settle_ns:
            return False
        self._trusted &= age_ns >= RACY_S * 1e9 or isinstance(found, Refused)
        self._digest.update("\0".join(map(str, found)).encode("utf-8", "surrogateescape") + b"\n")
        return True

    def value(self) -> str | None:
        """Return the fingerprint; None where a file changed so recently that it may change again without a trace."""
        return self._digest.hexdigest() if self._trusted else None


def listing_of(root: Path, *, settle_s: float = 0.0) -> str | None:
    """Return the fingerprint of all files below *root*; raises NoArchive."""
    fingerprint = Fingerprint(settle_s)
    for found in walk(root):
        fingerprint.add(found)
    return fingerprint.value()


def is_temporary(name: str) -> bool:
    """Tell whether *name* is hidden (also: rsync's ``.name.XXXXXX``) or of a file still being written."""
    return name.startswith(".") or name.lower().endswith(_TEMPORARY_ENDINGS)


def _names(directory: str | Path) -> list[str]:
    """Return the names in *directory*, those of directories with a '/' at the end, in the order of whole paths."""
    with os.scandir(directory) as entries:
        names = [
            f"{entry.name}/" if entry.is_dir(follow_symlinks=False) else entry.name
            for entry in entries
            if not is_temporary(entry.name)
        ]
    names.sort(key=os.fsencode)
    return names


def _below(root: str, top: list[str]) -> Iterator[File | Refused]:
    # a stack rather than recursion: folders may be nested deeper than Python calls
    stack = [("", iter(top))]
    while stack:
        prefix, names = stack[-1]
        name = next(names, None)
        if name is None:
            stack.pop()
            continue
        path = prefix + name
        if not path.endswith("/"):
            found = _looked_at(f"{root}/{path}", path)
            if found is not None:
                yield found
            continue
        try:
            stack.append((path, iter(_names(f"{root}/{path}"))))
        except FileNotFoundError:
            continue  # removed while we looked: it is not there
        except OSError as error:
            problem = unreadable(error, Path(root, path))
            yield Refused(path[:-1], problem.reason, f"the directory cannot be read: {problem.detail}")


def _looked_at(place: str, name: str) -> File | Refused | None:
    try:
        status = os.stat(place, follow_symlinks=False)  # noqa: PTH116 # a path object costs more than the question
    except FileNotFoundError:
        return None
    except OSError as error:
        problem = unreadable(error, Path(place))
        return Refused(name, problem.reason, f"its size and time cannot be read: {problem.detail}")
    if stat.S_ISREG(status.st_mode):
        return File(name, status.st_size, status.st_mtime_ns)
    kind = "a symbolic link" if stat.S_ISLNK(status.st_mode) else "a pipe, socket or device"
    return Refused(name, "not_a_regular_file", f"{kind} is not followed")
