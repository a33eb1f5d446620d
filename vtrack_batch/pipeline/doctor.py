"""What an installation and its machine are like, and what will give trouble: to be pasted into a report of trouble."""

from __future__ import annotations

import os
import platform
import resource
import shutil
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from vtrack_batch import __version__
from vtrack_batch.errors import VtrackError
from vtrack_batch.storage.lock import at_work
from vtrack_batch.storage.output import Output

PACKAGES = (
    "click", "distributed", "filelock", "geopandas", "matplotlib", "numba", "numpy", "opencv-python-headless", "pandas",
    "pebble", "pillow", "pyarrow", "pydantic", "pyproj", "rasterio", "ruamel.yaml", "scipy", "shapely", "simplejpeg",
)  # fmt: skip
LEAST_FREE_BYTES = 2 << 30
LEAST_OPEN_FILES = 256
MOST_CLOCK_SKEW_S = 5.0
OLDEST_CLOCK_S = 1_767_225_600  # 2026-01-01: before the program was written, no clock is right


@dataclass(frozen=True)
class Finding:
    """One fact, and what is wrong with it, if anything is."""

    name: str
    value: Any
    problem: str | None = None


def examine(survey: Any | None) -> list[Finding]:
    """Return the facts of the machine and, where a *survey* is given, of its archive and output."""
    found = [*_versions(), *_machine()]
    if survey is not None:
        found += _archive(survey.resolve(survey.archive.root))
        found += _output(Output(survey.resolve(survey.output.root)))
    return found


def _versions() -> Iterator[Finding]:
    yield Finding("vtrack-batch", __version__)
    yield Finding("python", platform.python_version())
    yield Finding("system", platform.platform())
    packages = {}
    for name in PACKAGES:
        try:
            packages[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            packages[name] = "-"
    lacking = sorted(name for name, version in packages.items() if version == "-" and name != "distributed")
    yield Finding("packages", packages, f"not installed: {', '.join(lacking)}" if lacking else None)
    other = [name for name in ("opencv-python", "opencv-contrib-python") if _is_installed(name)]
    problem = f"{', '.join(other)} overwrites opencv-python-headless: uninstall it" if other else None
    yield Finding("opencv", "headless", problem)


def _machine() -> Iterator[Finding]:
    yield Finding("processors", len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count())
    if hasattr(os, "sysconf"):
        yield Finding("memory_mb", (os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")) >> 20)
    files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    few = f"at most {files} files may be open; raise it with ulimit -n 1024" if files < LEAST_OPEN_FILES else None
    yield Finding("open_files", files, few)
    now_s = time.time()
    wrong = "the clock is before this program was written" if now_s < OLDEST_CLOCK_S else None
    yield Finding("clock_utc", time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(now_s)), wrong)
    yield Finding("encoding", sys.getfilesystemencoding())


def _archive(root: Path) -> Iterator[Finding]:
    if not root.is_dir():
        yield Finding("archive", str(root), "no such folder; is it mounted?")
        return
    readable = os.access(root, os.R_OK | os.X_OK)
    yield Finding("archive", str(root), None if readable else "cannot be read: permission")


def _output(output: Output) -> Iterator[Finding]:
    try:
        output.create()
    except VtrackError as problem:
        yield Finding("output", str(output.root), str(problem))
        return
    yield Finding("output", str(output.root))
    free = shutil.disk_usage(output.root).free
    yield Finding("free_mb", free >> 20, "the disk is nearly full" if free < LEAST_FREE_BYTES else None)
    yield _links(output)
    holder = at_work(output.state)
    yield Finding("at_work", str(holder) if holder else None)


def _links(output: Output) -> Finding:
    """Return whether the output's file system has hard links, and whether its clock is this machine's."""
    probe, second = output.state / f"probe-{os.getpid()}", output.state / f"probe-{os.getpid()}-link"
    try:
        probe.write_bytes(b"")
        skew_s = probe.stat().st_mtime - time.time()
        try:
            os.link(probe, second)
        except OSError as problem:
            return Finding("links", False, f"no hard links here ({problem.strerror}): every snapshot copies all files")
        if abs(skew_s) > MOST_CLOCK_SKEW_S:
            return Finding("links", True, f"the clock of the file server is {skew_s:+.0f} s off this machine's")
        return Finding("links", True)
    except OSError as problem:
        return Finding("links", None, f"cannot be tried: {problem.strerror}")
    finally:
        probe.unlink(missing_ok=True)
        second.unlink(missing_ok=True)


def _is_installed(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:
        return False
    return True
