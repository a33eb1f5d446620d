"""What is known of the archive's files, remembered by path, size and modification time so that each is read once.

The store is a cache: lost or damaged, it is made anew from the files.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from vtrack_batch.model.known import KnownFile

_SCHEMA = (
    "create table if not exists seen "
    "(name blob primary key, size int, mtime_ns int, sha256 text, stamp text) without rowid"
)

_READ_ON = "begin"
"""Questions in one transaction: asking for the file's lock each time costs more than the answer."""
_ASK = "select size, mtime_ns, sha256, stamp from seen where name = ?"


class FileStore:
    """Remembers files by path; without a place of its own it remembers nothing.

    Rows are asked for one by one, so that no archive is too large for it.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._db = self._open() if path is not None and path.parent.is_dir() else None

    def get(self, path: str) -> KnownFile | None:
        """Return what is known of the file at *path*."""
        if self._db is None:
            return None
        try:
            row = self._db.execute(_ASK, (_bytes(path),)).fetchone()
        except sqlite3.DatabaseError:  # held by another process, or damaged: the files themselves tell
            self._db = None
            return None
        return KnownFile(*row) if row else None

    def __len__(self) -> int:
        if self._db is None:
            return 0
        try:
            return int(self._db.execute("select count(*) from seen").fetchone()[0])
        except sqlite3.DatabaseError:
            return 0

    def remember(self, files: Iterable[tuple[str, KnownFile]]) -> None:
        """Remember *files* by path, all or none."""
        if self._path is None or not self._path.parent.is_dir():
            return
        rows = [(_bytes(path), *file) for path, file in files]
        for _ in range(2):
            self._db = self._db or self._open()
            if self._db is None:
                return
            try:
                with self._db:
                    self._db.executemany("insert or replace into seen values (?, ?, ?, ?, ?)", rows)
                self._db.execute(_READ_ON)
                return
            except sqlite3.OperationalError:  # held by another process, or the disk is full: it is only a cache
                return
            except sqlite3.DatabaseError:
                self._forget()

    def close(self) -> None:
        """Let go of the file."""
        if self._db is not None:
            self._db.close()
            self._db = None

    def _open(self) -> sqlite3.Connection | None:
        assert self._path is not None
        for _ in range(2):
            try:
                db = sqlite3.connect(self._path, timeout=5.0)
                db.execute(_SCHEMA)
                db.execute("select count(*) from (select 1 from seen limit 1)").fetchone()
                db.execute(_READ_ON)
                return db
            except sqlite3.OperationalError:  # held by another process, or not ours to write
                return None
            except sqlite3.DatabaseError:
                self._forget()
        return None

    def _forget(self) -> None:
        self._db = None
        with suppress(OSError):
            assert self._path is not None
            self._path.unlink(missing_ok=True)


def _bytes(name: str) -> bytes:
    return name.encode("utf-8", "surrogateescape")
