"""Faults without number: each change of the disk made to fail or to be the last, and kills at random.

``python benchmarks/faults.py --kills 200 --seed 1`` (`make bench-faults`): the whole crash loop of
tests/pipeline/crash_loop.py, the same by strace where there is one (system calls of the libraries included), and kills
of parent, worker and group at random moments. After each, readers must find a whole snapshot or none, and a plain run
must end with 0 and the bytes of a run that nothing disturbed.
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
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1] / "tests" / "pipeline"
sys.path.insert(0, str(TESTS))

import stub  # noqa: E402
from little import tree  # noqa: E402

from vtrack_batch.storage.verify import check_snapshot  # noqa: E402

FAULTS = ("kill", "ENOSPC", "EIO", "EACCES")
CALLS = "rename,renameat,renameat2,fsync,fdatasync,unlink,unlinkat,link,linkat,symlink,symlinkat,mkdir,mkdirat"
FRAMES = 96
WORKERS = 2


def main() -> None:
    """Parse what is wanted, do it, print how much was survived."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200, help="random kills")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--step", type=int, default=1, help="try every n-th point only")
    chosen = parser.parse_args()
    for fault in FAULTS:
        print(f"{fault}: {loop(fault, chosen.step)} points survived", flush=True)
    if shutil.which("strace"):
        for fault in ("signal=KILL", "error=ENOSPC", "error=EIO", "error=EACCES"):
            print(f"strace {fault}: {straced(fault, chosen.step)} points survived", flush=True)
    print(f"seed {chosen.seed}: {killed(chosen.kills, chosen.seed)} of {chosen.kills} kills survived")


def loop(fault: str, step: int) -> int:
    """Return how many points of the crash loop were survived."""
    with tempfile.TemporaryDirectory(dir=quick_disk()) as folder:
        command = [sys.executable, str(TESTS / "crash_loop.py"), folder, fault, str(step)]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return int(done.stdout) // step


def straced(fault: str, step: int) -> int:
    """Return how many system calls could be made to fail before the run ended by itself."""
    with tempfile.TemporaryDirectory(dir=quick_disk()) as name:
        place = Place(Path(name), 24)
        point = tried = 0
        while True:
            point += step
            place.fresh()
            inject = f"inject={CALLS}:{fault}:when={point}"
            strace = ["strace", "-f", "-q", "-o", "/dev/null", "-e", f"trace={CALLS}", "-e", inject]
            code = subprocess.run([*strace, *place.command()], stderr=subprocess.DEVNULL, check=False).returncode
            place.require_whole(f"strace {fault} at {point}")
            place.require_golden(f"strace {fault} at {point}")
            tried += 1
            if code == 0 and point > MANY_CALLS:
                return tried


MANY_CALLS = 500
"""More than a run of the small archive makes: beyond, nothing is injected any more."""


def killed(rounds: int, seed: int) -> int:
    """Return how many random kills of parent, worker or group were survived."""
    chance = random.Random(seed)
    with tempfile.TemporaryDirectory(dir=quick_disk()) as name:
        place = Place(Path(name), FRAMES)
        for number in range(rounds):
            place.fresh()
            whom, after_s = chance.choice(("parent", "worker", "group")), chance.uniform(0.0, place.takes_s)
            with subprocess.Popen(
                place.command(WORKERS), start_new_session=True, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
            ) as process:
                time.sleep(after_s)
                kill(process, whom, chance)
                process.wait()
            told = f"kill {number} of seed {seed}: {whom} after {after_s:.2f} s"
            place.require_whole(told)
            place.require_golden(told)
    return rounds


def kill(process: subprocess.Popen[bytes], whom: str, chance: random.Random) -> None:
    """Kill *whom* of the run's processes."""
    workers = subprocess.run(["pgrep", "-P", str(process.pid)], capture_output=True, text=True, check=False).stdout
    try:
        if whom == "group":
            os.killpg(process.pid, signal.SIGKILL)
        elif whom == "worker" and workers:
            os.kill(int(chance.choice(workers.split())), signal.SIGKILL)
        else:
            process.kill()
    except ProcessLookupError:
        pass  # it ended by itself in that moment


class Place:
    """An archive, its results before, and the tables that a run must end with."""

    def __init__(self, folder: Path, frames: int) -> None:
        self.before, self.now = folder / "before", folder / "now"
        stub.stub_archive(self.before, frames // 2)
        self._run(self.before)
        self.known = [{}, tree(self.before / "results" / "current")]
        for number in range(frames // 2, frames):
            stub.write_frame(self.before, number)
        self.fresh()
        began_s = time.monotonic()
        subprocess.run(self.command(WORKERS), check=True)
        self.takes_s = time.monotonic() - began_s
        self.known.append(tree(self.now / "results" / "current"))

    def fresh(self) -> None:
        """Put everything back to what it was before."""
        shutil.rmtree(self.now, ignore_errors=True)
        shutil.copytree(self.before, self.now, symlinks=True)

    def command(self, workers: int | None = None) -> list[str]:
        """Return the command of a quiet run."""
        more = ["--workers", str(workers)] if workers else []
        return [sys.executable, str(TESTS / "stub_run.py"), str(self.now / "survey.yaml"), "-q", *more]

    def require_whole(self, told: str) -> None:
        """Raise unless a reader now finds a whole snapshot or none."""
        current = self.now / "results" / "current"
        if tree(current) not in self.known or any(True for _ in check_snapshot(current.resolve())):
            raise SystemExit(f"{told}: a partial snapshot")

    def require_golden(self, told: str) -> None:
        """Raise unless a plain run ends well, with the golden bytes."""
        code = subprocess.run(self.command(), check=False).returncode
        if code != 0 or tree(self.now / "results" / "current") != self.known[-1]:
            raise SystemExit(f"{told}: the next run ends with {code}, or with other bytes")

    def _run(self, folder: Path) -> None:
        survey = str(folder / "survey.yaml")
        subprocess.run([sys.executable, str(TESTS / "stub_run.py"), survey, "-q"], check=True)


def quick_disk() -> str | None:
    """Return a folder in memory, where flushing costs nothing; None where there is none."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


if __name__ == "__main__":
    main()
