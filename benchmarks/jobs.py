"""Run independent jobs on two processes, in an order that does not depend on which is done first.

What a job returned is kept below `build/answers` and not asked for again by the same code: a bench of hours goes on
where it was stopped.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from typing import Any

from benchmarks.page import PROJECT

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
        futures = [pool.submit(answer, job) for job in jobs]
        answers = []
        for number, (future, (function, given)) in enumerate(zip(futures, jobs, strict=True), 1):
            answers.append(future.result())
            print(
                f"[{time.perf_counter() - start:5.0f} s] {number}/{len(jobs)} {function.__name__} {given}",
                file=sys.stderr,
            )
    return answers


def answer(job: Job) -> Any:
    """Return what *job* returns, or returned before to this very code."""
    function, given = job
    asked = f"{function.__module__}.{function.__qualname__}{given!r}"
    kept = PROJECT / "build" / "answers" / fingerprint() / hashlib.sha256(asked.encode()).hexdigest()[:32]
    if kept.exists():
        return pickle.loads(kept.read_bytes())  # written below, by this user
    found = function(*given)
    kept.parent.mkdir(parents=True, exist_ok=True)
    draft = kept.with_suffix(f".{os.getpid()}")
    draft.write_bytes(pickle.dumps(found))
    draft.replace(kept)
    return found


@cache
def fingerprint() -> str:
    """Return the hash of the program and of the benchmarks."""
    sources = sorted(path for name in ("vtrack_batch", "benchmarks") for path in (PROJECT / name).rglob("*.*"))
    files = [path for path in sources if path.is_file() and "__pycache__" not in path.parts]
    told = (f"{path.relative_to(PROJECT)} {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in files)
    return hashlib.sha256("\n".join(told).encode()).hexdigest()[:16]
