"""Kill a run at its 1st, 2nd, 3rd … change of the disk until it ends by itself; or let that change fail.

After each, readers must find a whole snapshot or none, and a plain run must end well with the bytes of a run that
nothing disturbed. ``crash_loop.py FOLDER kill|ENOSPC|EIO|EACCES [STEP [FIRST]]`` makes the calls of Python's ``os``
fail; with ``strace-`` before the fault, the system calls behind them, whoever makes them; with ``write-``, system calls
that write. Prints how many points there were. Forks, so that each try costs the run and not the imports.
"""

from __future__ import annotations

import errno
import importlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from functools import partial
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
CALLS = {
    "strace": "rename,renameat,renameat2,fsync,fdatasync,unlink,unlinkat,link,linkat,symlink,symlinkat,mkdir,mkdirat,"
    "rmdir,ftruncate",
    "write": "write,pwrite64",
}
LATE = ("publish", "prepare", "index", "plan", "carry", "record")
"""Modules of the pipeline that a run loads late: here once for all tries."""
FIRST, LATER = 16, 24
UNREACHED = 99
MOST = 10_000


def main(folder: Path, fault: str, step: int = 1, first: int = 1) -> None:
    scene = Scene(folder, FIRST, LATER)
    way, _, fault = fault.rpartition("-")
    if not way:
        reached = [loop(scene, fault, partial(disturbed, fault=fault), range(first, MOST, step))]
    else:
        # strace counts each call by itself
        harms = [partial(straced, call=call, fault=fault) for call in calls_made(scene, CALLS[way])]
        reached = [loop(scene, f"{fault} of {harm.keywords['call']}", harm, range(first, MOST, step)) for harm in harms]
    print(sum(reached))


def loop(scene: Scene, told: str, harm: Callable[..., int], points: Iterable[int]) -> int:
    """Do *harm* at each of *points* until the run ends by itself; returns how many it did not."""
    for tries, point in enumerate(points):
        scene.fresh()
        code = harm(scene.place, point=point)
        allowed = (-signal.SIGKILL,) if "kill" in told else (0, 73, 74)
        where = f"{told} at point {point}"
        assert code in (*allowed, UNREACHED), f"{where}: code {code}"
        scene.require_whole(where)
        scene.require_golden(where)
        if code == UNREACHED:
            return tries
    raise AssertionError("the run does not end by itself")


class Scene:
    """An archive with results of its first frames, and what the tables must be with all of them."""

    def __init__(self, folder: Path, first: int, later: int) -> None:
        run._work = stub.work
        for name in LATE:
            importlib.import_module(f"vtrack_batch.pipeline.{name}")
        for name in ("cv2", "pyarrow.parquet", "vtrack_batch.report.summary"):
            importlib.import_module(name)
        self.before, self.place = folder / "before", folder / "try"
        stub.stub_archive(self.before, first)
        assert in_child(lambda: survive(self.before)) == 0
        self.known = [tree(self.before / "results" / "current")]
        for number in range(first, later):
            stub.write_frame(self.before, number)
        self.fresh()
        assert in_child(lambda: survive(self.place)) == 0
        self.known.append(tree(self.place / "results" / "current"))

    def fresh(self) -> None:
        """Put everything back to what it was before."""
        shutil.rmtree(self.place, ignore_errors=True)
        shutil.copytree(self.before, self.place, symlinks=True)

    def require_whole(self, told: str) -> None:
        """Fail unless a reader now finds a whole snapshot."""
        current = self.place / "results" / "current"
        assert tree(current) in self.known, f"{told}: a partial snapshot"
        assert not list(check_snapshot(current.resolve())), f"{told}: a damaged snapshot"

    def require_golden(self, told: str) -> None:
        """Fail unless a plain run ends well, with the golden bytes and nothing left lying."""
        assert in_child(lambda: survive(self.place)) == 0, f"{told}: the next run fails"
        assert tree(self.place / "results" / "current") == self.known[1], f"{told}: other bytes"
        assert not list(Output(self.place / "results").staging.iterdir()), f"{told}: rubbish left"


def survive(place: Path, **orders: Any) -> int:
    """Run the survey at *place*; returns its exit code."""
    try:
        return run.run_survey(vt.load_survey(place / "survey.yaml"), orders=run.Orders(**orders)).exit_code
    except VtrackError as problem:
        return problem.exit_code


def disturbed(place: Path, fault: str, point: int) -> int:
    """Run the survey; the change of the disk number *point* is a *fault*."""

    def act() -> int:
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

    return in_child(act)


def straced(place: Path, call: str, fault: str, point: int) -> int:
    """Run the survey under strace, which makes the *point*-th *call* of the system a *fault*."""
    harm = "signal=KILL" if fault == "kill" else f"error={fault}"
    code, log = traced(place, call, "-e", f"inject={call}:{harm}:when={point}")
    return code if code < 0 or "(INJECTED)" in log else UNREACHED


def calls_made(scene: Scene, calls: str) -> list[str]:
    """Return those of the system calls *calls* that an undisturbed run makes."""
    scene.fresh()
    code, log = traced(scene.place, calls)
    assert code == 0
    return [call for call in calls.split(",") if re.search(rf"\b{call}\(", log)]


def traced(place: Path, calls: str, *more: str) -> tuple[int, str]:
    """Run the survey under strace; returns its exit code and the log."""
    log = place.with_name("strace.log")
    child = begin_child(lambda: survive(place) if is_traced() else 97)
    strace = ["strace", "-f", "-qq", "-o", str(log), "-p", str(child), "-e", f"trace={calls}", *more]
    with subprocess.Popen(strace, stderr=subprocess.DEVNULL):
        code = code_of(child)
    return code, log.read_text()


def is_traced() -> bool:
    """Wait for the tracer; returns whether it came."""
    end_s = time.monotonic() + 60
    while time.monotonic() < end_s:
        if "TracerPid:\t0\n" not in Path("/proc/self/status").read_text():
            return True
        time.sleep(0.005)
    return False


def in_child(action: Callable[[], int]) -> int:
    """Return the exit code of *action* in a process of its own; that of a signal is negative."""
    return code_of(begin_child(action))


def begin_child(action: Callable[[], int]) -> int:
    """Begin *action* in a process of its own, whose exit code is what it returns; returns the process's number."""
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
    return child


def code_of(child: int) -> int:
    """Wait for *child*; returns its exit code."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], *map(int, sys.argv[3:]))
