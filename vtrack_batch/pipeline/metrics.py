"""What a run came to, as a text file for Prometheus' node exporter."""

from __future__ import annotations

import re
import time
from pathlib import Path

from vtrack_batch.errors import CannotCreate
from vtrack_batch.pipeline.run import RunReport
from vtrack_batch.storage.durable import replace_durable

_SUCCESS = "vtrack_last_success_timestamp_seconds"


def write_metrics(path: Path, survey: str, *, exit_code: int, seconds: float, report: RunReport | None) -> None:
    """Replace the file *path*; the time of the last success is kept when a run fails. Raises ``CannotCreate``."""
    now = time.time()
    success = now if exit_code in (0, 3) else _former_success(path)
    rows = [
        ("vtrack_last_run_timestamp_seconds", "End of the last run.", "", now),
        (_SUCCESS, "End of the last run that published or had nothing to do.", "", success),
        ("vtrack_last_run_seconds", "How long the last run took.", "", seconds),
        ("vtrack_last_run_exit_code", "Exit code of the last run.", "", exit_code),
    ]
    if report is not None:
        rows += [
            ("vtrack_frames_used", "Frames behind the published results.", "", report.frames_used),
            ("vtrack_frames_quarantined", "Frames set aside.", "", report.frames_quarantined),
            ("vtrack_pieces_left", "Pieces of work still due.", "", report.left),
        ]
        pieces = "Pieces of work that the last run did."
        rows += [("vtrack_pieces_done", pieces, f',step="{step}"', count) for step, count in report.done.items()]
    lines: list[str] = []
    for name, meaning, label, value in rows:
        if f"# HELP {name} {meaning}" not in lines:
            lines += [f"# HELP {name} {meaning}", f"# TYPE {name} gauge"]
        lines.append(f'{name}{{survey="{_escaped(survey)}"{label}}} {value:.3f}')
    try:
        replace_durable(path, "\n".join(lines) + "\n")
    except OSError as problem:
        raise CannotCreate(f"{path}: the metrics cannot be written ({problem.strerror or problem})") from None


def _former_success(path: Path) -> float:
    try:
        found = re.search(rf"^{_SUCCESS}\{{.*\}} (\S+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
        return float(found[1]) if found else 0.0
    except (OSError, ValueError):
        return 0.0


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
