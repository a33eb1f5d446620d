"""Run independent jobs on two processes, in an order that does not depend on which is done first."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

Job = tuple[Callable[..., Any], tuple[Any, ...]]


def quick() -> bool:
    """Tell whether QUICK=1 was asked for."""
    return os.environ.get("QUICK", "0") not in ("", "0")


def called(command: str) -> str:
    """Return *command* as it was called: of a make target QUICK is an argument, else it is in the environment."""
    if not quick():
        return command
    return f"{command} QUICK=1" if command.startswith("make ") else f"QUICK=1 {command}"


def parallel(jobs: Sequence[Job]) -> list[Any]:
    """Return what each job returns, in the order given; PROCESSES (2) run side by side, each on one thread."""
    start = time.perf_counter()
    with ProcessPoolExecutor(int(os.environ.get("PROCESSES", "2")), mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(function, *given) for function, given in jobs]
        answers = []
        for number, (future, (function, given)) in enumerate(zip(futures, jobs, strict=True), 1):
            answers.append(future.result())
            print(
                f"[{time.perf_counter() - start:5.0f} s] {number}/{len(jobs)} {function.__name__} {given}",
                file=sys.stderr,
            )
    return answers
