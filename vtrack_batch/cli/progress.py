"""How far a run is: a bar for people at a terminal, a line now and then for logs, every piece for those who ask."""

from __future__ import annotations

import os
import sys
import time
from typing import Any, TextIO

BAR = 24
EVERY_S = 60.0


class Progress:
    """Listens to a run and writes to *stream* (stderr): with ``quiet`` only what was lost is kept to itself too."""

    def __init__(self, *, quiet: bool, verbose: bool, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._quiet, self._verbose = quiet, verbose
        self._bar = not quiet and not verbose and self._stream.isatty() and os.environ.get("TERM") != "dumb"
        self._step, self._done, self._total, self._lost = "", 0, 0, 0
        self._began_s = self._spoke_s = time.monotonic()

    def __call__(self, event: str, **facts: Any) -> None:
        """Take note of an event of the run."""
        if event == "step":
            self._step, self._done, self._total = facts["step"], 0, facts["total"]
            self._began_s = time.monotonic()
        elif event == "done":
            self._done += 1
        elif event == "quarantined":
            self._lost += 1
        if self._quiet:
            return
        if self._verbose:
            self._tell(event, facts)
        elif self._bar:
            self._draw(last=event == "ended")
        elif time.monotonic() - self._spoke_s >= EVERY_S:
            self._spoke_s = time.monotonic()
            self._write(self._line() + "\n")

    def close(self) -> None:
        """Leave the terminal's line."""
        if self._bar:
            self._write("\r\x1b[K")

    def _tell(self, event: str, facts: dict[str, Any]) -> None:
        if event == "done":
            self._write(f"{facts['step']} {self._done}/{self._total}: {facts['piece']}\n")
        elif event == "died":
            at = f" at {facts['frame']}" if facts["frame"] else ""
            self._write(f"{facts['step']} {facts['piece']}: {facts['detail']}{at}; it is done again\n")
        elif event == "quarantined":
            self._write(f"set aside: {facts['frame']} ({facts['reason']}: {facts['detail']})\n")

    def _line(self) -> str:
        spent_s = time.monotonic() - self._began_s
        left = ""
        if 0 < self._done < self._total:
            left_s = spent_s / self._done * (self._total - self._done)
            left = f", about {int(left_s // 3600)}:{int(left_s // 60 % 60):02d}:{int(left_s % 60):02d} left"
        lost = f", {self._lost} frames set aside" if self._lost else ""
        return f"{self._step} {self._done}/{self._total}{lost}{left}"

    def _draw(self, *, last: bool) -> None:
        if last or not self._total:
            self.close()
            return
        filled = BAR * self._done // self._total
        self._write(f"\r\x1b[K[{'#' * filled}{'.' * (BAR - filled)}] {self._line()}")

    def _write(self, text: str) -> None:
        try:
            self._stream.write(text)
            self._stream.flush()
        except (OSError, ValueError):  # whoever listened is gone: the work goes on
            self._quiet = True
