"""One run at a time: a lock that the kernel frees when its holder ends, however it ends, and a note for people."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from vtrack_batch.errors import Busy, CannotCreate


@dataclass(frozen=True)
class Holder:
    """Who holds an output: process, machine, and since when (UTC)."""

    pid: int
    host: str
    since: str

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host} since {self.since}"


@contextmanager
def locked(state: Path, *, what: str, wait_s: float = 0.0) -> Iterator[None]:
    """Hold the folder *state* against others for the length of the block; raises ``Busy`` that names the holder.

    A file system without kernel locks is refused: a lock that outlives its holder would stop every later run.
    """
    from filelock import FileLock, SoftFileLock, Timeout

    lock = FileLock(state / "lock")
    try:
        lock.acquire(timeout=wait_s)
    except Timeout:
        told = holder(state) or "holder unknown"
        raise Busy(f"{what}: another run holds it ({told}); wait for its end with --wait SECONDS") from None
    except (OSError, NotImplementedError) as problem:
        raise CannotCreate(f"{what}: cannot be locked ({problem}); put output.root on a local disk or NFS 4") from None
    if isinstance(lock, SoftFileLock):
        lock.release()
        raise CannotCreate(f"{what}: its file system has no locks; put output.root on a local disk or NFS 4")
    try:
        _write_note(state)
        yield
    finally:
        with suppress(OSError):
            _note(state).unlink(missing_ok=True)
        lock.release()


def holder(state: Path) -> Holder | None:
    """Return who wrote the note in *state*, None if there is none; it does not say that the lock is still held."""
    try:
        about = json.loads(_note(state).read_bytes())
        return Holder(int(about["pid"]), str(about["host"]), str(about["since"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def at_work(state: Path) -> Holder | None:
    """Return who holds *state* now, None if none does; the lock itself is not touched, so that no run is kept out."""
    found = holder(state)
    if found is None or found.host != socket.gethostname():
        return found
    try:
        os.kill(found.pid, 0)
    except ProcessLookupError:
        return None  # killed before it could take its note away
    except PermissionError:
        pass
    return found


def _note(state: Path) -> Path:
    return state / "holder.json"


def _write_note(state: Path) -> None:
    now = datetime.now(UTC).isoformat(timespec="seconds")
    about = {"pid": os.getpid(), "host": socket.gethostname(), "since": now}
    # only a courtesy: a full disk is told where it matters
    with suppress(OSError):
        _note(state).write_text(json.dumps(about) + "\n")
