"""Content hashes of the archive's files, remembered by path, size and modification time so that each is read once.

The store is a cache: lost or damaged, it is made anew from the files.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable, Iterable
from contextlib import closing, suppress
from pathlib import Path

_SCHEMA = "create table if not exists files (name blob primary key, size int, mtime_ns int, sha256 text)"


RACY_NS = 2_000_000_000
"""A file modified so recently may change again within the clock's resolution; it is hashed again next time."""


class HashStore:
    """Remembers SHA-256 by (name, size, mtime_ns); without a path it remembers nothing."""

    def __init__(self, path: Path | None) -> None:
        self._path = path

    def fill(self, files: Iterable[tuple[str, int, int]], hash_of: Callable[[str], str | None]) -> dict[str, str]:
        """Return the hash of every (name, size, mtime_ns), calling *hash_of* only for new or changed files.

        Files for which *hash_of* returns None (unreadable) are left out, and asked for again next time.
        """
        known = self._load()
        hashes: dict[str, str] = {}
        fresh: list[tuple[str, int, int, str]] = []
        for name, size, mtime_ns in files:
            seen = known.get(name)
            if seen is not None and seen[:2] == (size, mtime_ns):
                hashes[name] = seen[2]
                continue
            digest = hash_of(name)
            if digest is not None:
                hashes[name] = digest
                if time.time_ns() - mtime_ns > RACY_NS:
                    fresh.append((name, size, mtime_ns, digest))
        if fresh:
            self._store(fresh)
        return hashes

    def _load(self) -> dict[str, tuple[int, int, str]]:
        if self._path is None:
            return {}
        try:
            with closing(self._open(self._path)) as db:
                rows = db.execute("select name, size, mtime_ns, sha256 from files").fetchall()
        except sqlite3.OperationalError:  # held by another process, or not ours to read: the files themselves tell
            return {}
        except sqlite3.DatabaseError:
            self._path.unlink(missing_ok=True)
            return {}
        return {_text(name): (size, mtime_ns, sha256) for name, size, mtime_ns, sha256 in rows}

    def _store(self, rows: list[tuple[str, int, int, str]]) -> None:
        if self._path is None:
            return
        with suppress(sqlite3.OperationalError), closing(self._open(self._path)) as db, db:
            db.executemany(
                "insert or replace into files values (?, ?, ?, ?)",
                [(_bytes(name), size, mtime_ns, sha256) for name, size, mtime_ns, sha256 in rows],
            )

    @staticmethod
    def _open(path: Path) -> sqlite3.Connection:
        db = sqlite3.connect(path)
        db.execute(_SCHEMA)
        return db


def _bytes(name: str) -> bytes:
    return name.encode("utf-8", "surrogateescape")


def _text(name: bytes) -> str:
    return name.decode("utf-8", "surrogateescape")
