"""The bytes of one file of the archive, opened so that no name can lead outside or block."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from vtrack_batch.archive.names import escape, unescape
from vtrack_batch.errors import UnusableFrame

MAX_FILE_BYTES = 2**30
_RETRIES, _RETRY_AFTER_S = 2, 0.2
_PASSING = (errno.EIO, errno.ESTALE)
_OF_THE_MACHINE = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)
_REASONS = {
    errno.ENOENT: "file_missing",
    errno.ENOTDIR: "file_missing",
    errno.EACCES: "permission",
    errno.EPERM: "permission",
    errno.ELOOP: "not_a_regular_file",
    errno.EISDIR: "not_a_regular_file",
    errno.ENXIO: "not_a_regular_file",
}


def read_bytes(root: Path, path: str, *, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """Return the bytes of the file at *path* (as in ``Scan.files``, odd characters escaped) below *root*.

    Raises UnusableFrame with reason file_missing, permission, not_a_regular_file, too_large, changed_while_reading,
    io_error (after two retries: network file systems recover) or outside_archive; OSError where it is the machine that
    has no more memory or open files to give.
    """
    name, tried = unescape(path), 0
    while True:
        try:
            with open_regular(root, name) as file:
                return _read_settled(file, max_bytes)
        except OSError as error:
            if error.errno not in _PASSING or tried == _RETRIES:
                raise unreadable(error, root / name) from error
            tried += 1
            time.sleep(_RETRY_AFTER_S)


def content_hash(data: bytes) -> str:
    """Return the SHA-256 of *data* in hexadecimal, the identity of a frame's content."""
    return hashlib.sha256(data).hexdigest()


def unreadable(error: OSError, path: Path) -> UnusableFrame:
    """Return what *error*, met when opening or reading *path*, means for the frame; raises it if it is not about it."""
    if error.errno in _OF_THE_MACHINE:
        raise error
    return UnusableFrame(_REASONS.get(error.errno or 0, "io_error"), _detail(error, path))


@contextmanager
def open_regular(root: Path, name: str) -> Iterator[BinaryIO]:
    """Open a regular file below *root* for reading, following no link; OSError or UnusableFrame if that cannot be."""
    if name.startswith("/") or ".." in name.split("/") or "\0" in name:
        raise UnusableFrame("outside_archive", f"{escape(name)} does not name a file below the archive's root")
    # Not to block: a pipe put in place of a file would wait for its writer for ever.
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0)
    descriptor = os.open(root / name, flags)
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise UnusableFrame("not_a_regular_file", "a directory, pipe, socket or device")
        yield file


def _read_settled(file: BinaryIO, max_bytes: int) -> bytes:
    before = os.fstat(file.fileno())
    if before.st_size > max_bytes:
        raise UnusableFrame("too_large", f"a file of {before.st_size} bytes; at most {max_bytes} are read")
    data = file.read(before.st_size + 1)  # a buffer of just this size is taken: not more than the file may need
    after = os.fstat(file.fileno())
    if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns) or len(data) != after.st_size:
        raise UnusableFrame("changed_while_reading", "its size or time moved while it was read: still being written")
    return data


def _detail(error: OSError, path: Path) -> str:
    text = error.strerror or type(error).__name__
    if error.errno in (errno.EACCES, errno.EPERM):
        try:
            status = path.lstat()
        except OSError:
            return text
        return f"{text}; owner {status.st_uid}, mode {stat.filemode(status.st_mode)}"
    return text
