"""Run a survey by the command line with a slow detect step; says ``done`` after the first piece."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import stub

from vtrack_batch import cli
from vtrack_batch.cli import progress
from vtrack_batch.pipeline import run


def slow(piece: Any, context: Any) -> None:
    stub.detect(piece, context)
    time.sleep(2.0)


class Loud(progress.Progress):
    def __call__(self, event: str, **facts: Any) -> None:
        if event == "done":
            print("done", flush=True)


if __name__ == "__main__":
    run._work = lambda step: slow if step == "detect" else stub.work(step)
    progress.Progress = Loud  # type: ignore[misc]
    sys.argv = ["vtrack-batch", "run", str(Path(sys.argv[1]) / "survey.yaml"), "-q"]
    cli.main()
