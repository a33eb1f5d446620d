"""Whatever kills a run, and wherever: readers see a whole snapshot or none, and the next run ends with the same bytes.

The whole loop, point by point, and random kills are `make bench-faults`. Faults 35, 38, 39, 41, 42, 45 and 72.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

LOOP = Path(__file__).with_name("crash_loop.py")


@pytest.fixture
def quick_disk(tmp_path: Path) -> Iterator[Path]:
    """A folder in memory where there is one: what is flushed and renamed counts here, not how long a disk takes."""
    memory = Path("/dev/shm")
    folder = memory / f"vtrack-{tmp_path.parent.name}-{tmp_path.name}" if memory.is_dir() else tmp_path / "disk"
    folder.mkdir()
    yield folder
    shutil.rmtree(folder)


@pytest.mark.parametrize(
    ("fault", "step", "first"), [("kill", 29, 3), ("ENOSPC", 41, 5), ("EIO", 41, 19), ("EACCES", 41, 33)]
)
def test_no_fault_leaves_half_a_result(quick_disk: Path, fault: str, step: int, first: int) -> None:
    command = [sys.executable, str(LOOP), str(quick_disk), fault, str(step), str(first)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout) >= 3, "so many changes of the disk were made to fail, or the loop tests nothing"
