"""Faults without number: each change of the disk made to fail or to be the last, and kills at random.

``python -m benchmarks.faults --kills 200 --seed 1`` (`make bench-faults`) writes what was survived into
docs/reliability.md: the whole crash loop of tests/pipeline/crash_loop.py by Python's calls, the same by strace where
there is one (system calls of the libraries included), and kills of parent, worker and group at random moments. After
each, readers must find a whole snapshot or none, and a plain run must end with 0 and the bytes of a run that nothing
disturbed; the first that does not ends it all.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from benchmarks.page import DOCS, markdown_table, stamp, write_section

TESTS = Path(__file__).resolve().parents[1] / "tests" / "pipeline"
sys.path.insert(0, str(TESTS))

from crash_loop import Scene, begin_child, code_of, survive  # noqa: E402

FAULTS = ("kill", "ENOSPC", "EIO", "EACCES")
LOOPS = {
    **{fault: (f"{fault} at every change of the disk", 1) for fault in FAULTS},
    **{f"strace-{fault}": (f"{fault} at every such system call (strace)", 1) for fault in FAULTS},
    **{f"write-{fault}": (f"{fault} at every 7th write (strace)", 7) for fault in ("ENOSPC", "EIO")},
}
"""Fault of the crash loop → what it is called, and its step."""
FIRST, FRAMES, WORKERS = 48, 96, 2
PAGE = DOCS / "reliability.md"


def main() -> None:
    """Parse what is wanted, do it, write how much was survived."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200, help="random kills")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--step", type=int, default=1, help="try every n-th point only, and write no page")
    chosen = parser.parse_args()
    rows = []
    for fault, (name, step) in LOOPS.items():
        if "-" in fault and not shutil.which("strace"):
            continue
        tries = loop(fault, step * chosen.step)
        rows.append([name, str(tries), str(tries)])
        print(*rows[-1], sep=": ", flush=True)
    hits = killed(chosen.kills, chosen.seed)
    for whom, count in sorted(hits.items()):
        rows.append([f"SIGKILL of {whom} at a random moment, two workers", str(count), str(count)])
        print(*rows[-1], sep=": ", flush=True)
    command = f"python -m benchmarks.faults --kills {chosen.kills} --seed {chosen.seed}"
    if chosen.step == 1:
        table = markdown_table(["fault", "tries", "survived"], rows)
        write_section(PAGE, "faults", f"{INTRODUCTION}\n\n{table}\n\n{stamp(command, ('vtrack-batch', 'pyarrow'))}")


INTRODUCTION = """## Faults tried

Survived: a whole snapshot for readers after the fault, and after one plain run more the bytes of a run that nothing
disturbed, nothing left lying. The command ends at the first that is not."""


def loop(fault: str, step: int) -> int:
    """Return how many points of the crash loop were survived; raises at one that was not."""
    with tempfile.TemporaryDirectory(dir=quick_disk()) as folder:
        command = [sys.executable, str(TESTS / "crash_loop.py"), folder, fault, str(step)]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return int(done.stdout)


def killed(rounds: int, seed: int) -> Counter[str]:
    """Return how many random kills of whom were survived; raises at one that was not."""
    chance = random.Random(seed)
    hits: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(dir=quick_disk()) as name:
        scene = Scene(Path(name), FIRST, FRAMES)
        takes_s = duration_s(scene)
        while hits.total() < rounds:
            whom, after_s = chance.choice(("parent", "worker", "group")), chance.uniform(0.0, takes_s)
            scene.fresh()
            run = begin_run(scene.place)
            time.sleep(after_s)
            hit = kill(run, whom, chance)
            code_of(run)
            told = f"kill {hits.total()} of seed {seed}: {whom} after {after_s:.2f} s"
            scene.require_whole(told)
            scene.require_golden(told)
            hits.update(hit)
    return hits


def duration_s(scene: Scene) -> float:
    """Return how long a run with workers takes that nothing disturbs."""
    scene.fresh()
    began_s = time.monotonic()
    if code_of(begin_run(scene.place)) != 0:
        raise SystemExit("a run that nothing disturbs fails")
    return time.monotonic() - began_s


def begin_run(place: Path) -> int:
    """Begin a run with workers in a process group of its own; returns the process's number."""

    def act() -> int:
        os.setsid()
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 2)
        return survive(place, workers=WORKERS)

    return begin_child(act)


def kill(run: int, whom: str, chance: random.Random) -> list[str]:
    """Kill *whom* of the processes of *run*; returns who was killed: none if it had ended by itself."""
    if os.waitid(os.P_PID, run, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
        return []
    workers = Path(f"/proc/{run}/task/{run}/children").read_text().split()
    try:
        if whom == "group":
            os.killpg(run, signal.SIGKILL)
        elif whom == "worker" and workers:
            os.kill(int(chance.choice(workers)), signal.SIGKILL)
        else:
            whom = "parent"
            os.kill(run, signal.SIGKILL)
    except ProcessLookupError:
        return []
    return [whom]


def quick_disk() -> str | None:
    """Return a folder in memory, where flushing costs nothing; None where there is none."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


if __name__ == "__main__":
    main()
