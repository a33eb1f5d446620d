"""What makes files and names survive a loss of power: written, flushed, renamed once, the folder flushed."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

FEW_FOLDERS = 64
"""Up to so many folders are flushed one by one; for more it is quicker to flush all that the system holds, once."""

NO_LINKS = (errno.EXDEV, errno.EPERM, errno.EMLINK, errno.ENOTSUP, errno.ENOSYS)


def write_durable(path: Path, content: str | bytes) -> None:
    """Write a new file and flush it to the disk."""
    with path.open("wb") as stream:
        stream.write(content.encode() if isinstance(content, str) else content)
        stream.flush()
        os.fsync(stream.fileno())


def replace_durable(path: Path, content: str | bytes) -> None:
    """Give *path* a new content at once: whoever reads it finds the former or the new one, whole."""
    draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        write_durable(draft, content)
        draft.replace(path)
        fsync(path.parent)
    finally:
        with suppress(FileNotFoundError):
            draft.unlink()


def fsync(path: str | Path) -> None:
    """Flush a file or a folder to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def fsync_folders(folders: Collection[str]) -> None:
    """Flush the names in *folders* to the disk."""
    if len(folders) > FEW_FOLDERS:
        os.sync()
        return
    for folder in sorted(folders):
        fsync(folder)


def make_durable_folder(folder: Path) -> None:
    """Make *folder* and what leads to it, names flushed to the disk."""
    missing = []
    while not folder.is_dir():
        missing.append(folder)
        folder = folder.parent
    for made in reversed(missing):
        made.mkdir(exist_ok=True)
        fsync(made.parent)


def link(source: str | Path, place: str) -> None:
    """Give the file *source* a second name *place*; where the file system has no links, a copy."""
    try:
        os.link(source, place)
    except OSError as problem:
        if problem.errno not in NO_LINKS:
            raise
        shutil.copyfile(source, place)
        fsync(Path(place))


def remove_tree(folder: Path) -> None:
    """Remove *folder*, if it is there, at once: it loses its name first, so that none ever sees it half."""
    doomed = folder.with_name(f".removed-{secrets.token_hex(8)}")
    with suppress(FileNotFoundError):
        folder.rename(doomed)
    if doomed.is_symlink():
        doomed.unlink()  # somebody laid it there: where it leads is not ours
    shutil.rmtree(doomed, ignore_errors=True)
