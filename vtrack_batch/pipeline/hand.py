"""What a worker has in hand, noted before it is touched: a worker that dies leaves behind which frame it was at.

A worker that stays at one frame beyond the limit is ended by the system's alarm clock, whatever it is doing.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PID_BYTES = 12


class Hand:
    """The note of one worker at one piece of work."""

    def __init__(self, note: int, limit_s: float) -> None:
        self._note = note
        self._limit_s = limit_s

    def take(self, path: str) -> None:
        """Note that the frame *path* is now in hand, and wind the alarm up anew."""
        os.ftruncate(self._note, PID_BYTES)
        os.pwrite(self._note, path.encode("utf-8", "surrogateescape"), PID_BYTES)
        signal.setitimer(signal.ITIMER_REAL, self._limit_s)


@contextmanager
def holding(note: Path, *, limit_s: float) -> Iterator[Hand]:
    """Give the hand of a worker; its *note* stays behind only where the worker dies."""
    note.parent.mkdir(exist_ok=True)
    handle = os.open(note, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
    try:
        os.pwrite(handle, b"%*d" % (PID_BYTES, os.getpid()), 0)
        yield Hand(handle, limit_s)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        os.close(handle)
        note.unlink(missing_ok=True)


def left_behind(note: Path) -> str | None:
    """Return the frame that a dead worker had in hand, None if it had none; the note is taken away."""
    try:
        path = note.read_bytes()[PID_BYTES:].decode("utf-8", "surrogateescape")
        note.unlink()
    except FileNotFoundError:
        return None
    return path or None


def has_left(note: Path) -> bool:
    """Return whether the worker of this machine that wrote *note* is no more; no note, nobody who left."""
    try:
        pid = int(note.read_bytes()[:PID_BYTES] or b"0")
        if pid:
            os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except (FileNotFoundError, PermissionError):
        return False
    return False
