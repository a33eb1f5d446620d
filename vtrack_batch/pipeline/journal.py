"""The log of each run: JSON lines under state/runs, the newest kept; what goes wrong with it never stops a run."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TextIO

from vtrack_batch.errors import VtrackError

KEPT = 50


class Journal:
    """One run's log: one event a line, with its time in UTC; ``failed`` or ``ended`` comes last."""

    def __init__(self, folder: Path) -> None:
        self._stream: TextIO | None = None
        try:
            folder.mkdir(exist_ok=True)
            for old in sorted(folder.glob("*.jsonl"))[: -KEPT + 1]:
                old.unlink(missing_ok=True)
            name = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{os.getpid()}.jsonl"
            self._stream = (folder / name).open("a", encoding="utf-8")
        except OSError:
            self._stream = None

    def __call__(self, event: str, **facts: Any) -> None:
        """Write an event."""
        if self._stream is None:
            return
        now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        line = {"time": now, "event": event, **facts}
        try:
            self._stream.write(json.dumps(line, ensure_ascii=True, default=str) + "\n")
            self._stream.flush()
        except OSError:  # a full disk is told by what needs it
            self._stream = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        if problem is not None:
            self("failed", error=type(problem).__name__, text=str(problem), exit_code=exit_code_of(problem))
        if self._stream is not None:
            self._stream.close()


def exit_code_of(problem: BaseException) -> int:
    """Return the exit code that ends a run with *problem*."""
    if isinstance(problem, VtrackError):
        return problem.exit_code
    if isinstance(problem, KeyboardInterrupt):
        return 130
    if isinstance(problem, SystemExit):
        return problem.code if isinstance(problem.code, int) else 1
    return 74 if isinstance(problem, OSError) else 1
