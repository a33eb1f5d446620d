"""Kill a run at its 1st, 2nd, 3rd … change of the disk until it ends by itself; or let that change fail.

After each, readers must find a whole snapshot or none, and a plain run must end well with the bytes of a run that
nothing disturbed. Usage: ``crash_loop.py FOLDER kill|ENOSPC|EIO|EACCES [STEP]``; prints how many points were tried.
Forks, so that each try costs the run and not the imports.
"""

from __future__ import annotations

import errno
import os
import shutil
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import stub
from little import tree

import vtrack_batch as vt
from vtrack_batch.errors import VtrackError
from vtrack_batch.pipeline import run
from vtrack_batch.storage.output import Output
from vtrack_batch.storage.verify import check_snapshot

POINTS = ("rename", "replace", "fsync", "unlink", "link", "symlink", "mkdir", "rmdir", "truncate")
FIRST, LATER = 16, 24


def main(folder: Path, fault: str, step: int, first: int = 1) -> None:
    run._work = stub.work
    before, golden = folder / "before", folder / "golden"
    stub.stub_archive(before, FIRST)
    assert in_child(lambda: survive(before)) == 0
    known = [tree(before / "results" / "current")]
    for number in range(FIRST, LATER):
        stub.write_frame(before, number)
    shutil.copytree(before, golden, symlinks=True)
    assert in_child(lambda: survive(golden)) == 0
    known.append(tree(golden / "results" / "current"))
    point, ended = first, False
    while not ended:
        place = folder / "try"
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(before, place, symlinks=True)
        code = in_child(lambda point=point, place=place: disturbed(place, fault, point))
        ended = code == UNREACHED
        allowed = (-signal.SIGKILL,) if fault == "kill" else (0, 73, 74)
        assert ended or code in allowed, f"{fault} at point {point}: code {code}"
        assert tree(place / "results" / "current") in known, f"{fault} at point {point}: a partial snapshot"
        assert not list(check_snapshot((place / "results" / "current").resolve())), f"{fault} at point {point}: damaged"
        assert in_child(lambda place=place: survive(place)) == 0, f"{fault} at point {point}: the next run fails"
        assert tree(place / "results" / "current") == known[1], f"{fault} at point {point}: other bytes"
        assert not list(Output(place / "results").staging.iterdir()), f"{fault} at point {point}: rubbish left"
        point += step
    print(point - step)


UNREACHED = 99


def survive(place: Path) -> int:
    """Run the survey at *place*; returns its exit code."""
    try:
        return run.run_survey(vt.load_survey(place / "survey.yaml")).exit_code
    except VtrackError as problem:
        return problem.exit_code


def disturbed(place: Path, fault: str, point: int) -> int:
    """Run the survey; the change of the disk number *point* is a *fault*."""
    count = 0

    def around(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            nonlocal count
            count += 1
            if count == point:
                if fault == "kill":
                    os.kill(os.getpid(), signal.SIGKILL)
                code = getattr(errno, fault)
                raise OSError(code, os.strerror(code), str(arguments[0]))
            return real(*arguments, **options)

        return call

    for name in POINTS:
        setattr(os, name, around(getattr(os, name)))
    code = survive(place)
    return UNREACHED if count < point else code


def in_child(action: Callable[[], int]) -> int:
    """Return the exit code of *action* in a process of its own; that of a signal is negative."""
    child = os.fork()
    if child == 0:
        code = 98
        try:
            code = action()
        except Exception:  # noqa: BLE001 # told here, judged by the code
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], *map(int, sys.argv[3:]))
