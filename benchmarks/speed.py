"""How many decodes a run costs, stage by stage: ``make bench-speed`` (QUICK=1: HD only).

Every figure is a ratio to the fastest decode of the same files in the same run; processor time, one thread. Each run
has a process of its own, so that its peak of memory is its own.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import os
import pstats
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import simplejpeg

import vtrack_batch as vt
from benchmarks.environment import ONE_THREAD
from benchmarks.jobs import called, quick
from benchmarks.page import PERFORMANCE, markdown_table, stamp, write_section
from vtrack_batch.archive.decode import decode
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.view_params import CameraParams
from vtrack_batch.simulation.write import simulate

COMMAND = "make bench-speed"
VERSIONS = ("vtrack-batch", "numpy", "numba", "scipy", "opencv-python-headless", "simplejpeg")
MAX_PIXELS = 200_000_000
DECODES = 3
WHO = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)

STAGES = {
    "decode, strict": ("archive/decode.py", "decode"),
    "register": ("registration/alignment.py", "register"),
    "learn the background": ("background/learn.py", "learn_background"),
    "difference": ("background/subtract.py", "subtract"),
    "boxes": ("detection/boxes.py", "fit_boxes"),
    "adjust boxes": ("detection/refine.py", "refine"),
    "place model": ("detection/place.py", "learn_place"),
    "link": ("pipeline/track.py", "track_sequence"),
    "traffic": ("pipeline/traffic.py", "measure_date"),
    "pictures": ("pipeline/picture.py", "draw_sequence"),
}
"""Stage -> the function, by file and name, whose cumulated time it is."""
PASSES = {"first pass": ("pipeline/detect.py", "_first_pass"), "second pass": ("pipeline/detect.py", "_second_pass")}


def main() -> None:
    """Render archives, run them, write the section; with an argument: run one survey and print figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--survey", type=Path, help="run this survey alone")
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--unit-s", type=float, default=None)
    given = parser.parse_args()
    if given.survey:
        print(json.dumps(one_run(given.survey, given.workers, given.unit_s)))
        return
    with tempfile.TemporaryDirectory() as place:
        section = performance_page(Path(place), quick())
    write_section(PERFORMANCE, "bench-speed", section)


def performance_page(folder: Path, few: bool) -> str:
    """Return the section on speed and memory."""
    wanted = {"HD": Scenario(seed=9001, duration_s=90 if few else 150, camera=CameraParams(gsd_m=0.33))}
    if not few:
        wanted["48 MP"] = Scenario(
            seed=9002, duration_s=18, camera=CameraParams(gsd_m=0.33, width_px=8000, height_px=6000)
        )
    measured = {}
    for name, scenario in wanted.items():
        place = folder / name.replace(" ", "")
        simulate(scenario, place, workers=min(2, os.cpu_count() or 1))
        measured[name] = in_process(place / "survey.yaml")
        print(name, json.dumps(measured[name]), flush=True)
    hd, half_s = folder / "HD" / "survey.yaml", wanted["HD"].duration_s / 2
    runs = [in_process(hd, workers=workers, unit_s=half_s) for workers in (1, 2)]
    return "\n\n".join(
        [
            "## A run in units of decoding",
            HEAD,
            ratio_table(measured),
            workers_text(*runs),
            "### Where the time goes",
            stage_table(measured),
            stamp(called(COMMAND), VERSIONS),
        ]
    )


HEAD = """\
Processor time, one thread, JPEG of quality 90, warm page cache and compiled code; the floor is the fastest decode that
is sound but not strict (simplejpeg, fast DCT and fast upsampling), of the same files in the same process. The first
pass learns the ground from up to 31 frames of the unit; it weighs less the longer the unit is. A whole run is from the
index to the published tables, trajectories and report included. Memory is the peak of the process."""


def workers_text(one: Mapping[str, Any], two: Mapping[str, Any]) -> str:
    """Return what two workers gain by the wall clock and cost in processor time."""
    text = (
        f"Two workers on an HD archive of two units: {one['wall_s'] / two['wall_s']:.2f} times as fast as one by the "
        f"wall clock ({one['wall_s']:.1f} s against {two['wall_s']:.1f} s, start of the processes included), for "
        f"{two['cpu_s'] / one['cpu_s']:.2f} times the processor time."
    )
    load = max(one["load"], two["load"])
    busy = f" The machine was busy with other work (load {load:.1f}): its wall clock says little." if load > 2 else ""
    return text + busy


def in_process(survey: Path, *, workers: int = 0, unit_s: float | None = None) -> dict[str, Any]:
    """Run a survey in a fresh process, which does all itself (0) or has *workers*; return its figures."""
    command = [sys.executable, "-m", "benchmarks.speed", "--survey", survey, "--workers", workers]
    command += ["--unit-s", unit_s] if unit_s else []
    environment = {**os.environ, **ONE_THREAD}
    done = subprocess.run(list(map(str, command)), check=True, env=environment, stdout=subprocess.PIPE)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def one_run(path: Path, workers: int, unit_s: float | None) -> dict[str, Any]:
    """Run the survey at *path* after a short run that compiles and loads; return seconds, stages and memory."""
    cv2.setNumThreads(1)
    frames = sorted(file for file in (path.parent / "frames").rglob("*") if file.is_file())
    survey = vt.load_survey(path)
    section = survey.execution if unit_s is None else survey.execution.model_copy(update={"unit_s": unit_s})
    with tempfile.TemporaryDirectory() as place:

        def run(name: str, source: Any) -> None:
            out = source.output.model_copy(update={"root": str(Path(place) / name)})
            vt.run_survey(source.model_copy(update={"output": out, "execution": section}), workers=workers)

        if not workers:
            run("warm", shortened(survey, path))
        floor = floor_s(frames)
        profile = cProfile.Profile(time.process_time)
        load, start, start_cpu = os.getloadavg()[0], time.perf_counter(), processor_s()
        if not workers:
            profile.runcall(run, "full", survey)
        else:
            run("full", survey)
        wall, processor = time.perf_counter() - start, processor_s() - start_cpu
    size = cv2.imread(str(frames[0])).shape
    return {
        "frames": len(frames),
        "megapixels": size[0] * size[1] / 1e6,
        "floor_s": floor,
        "wall_s": wall,
        "cpu_s": processor,
        "memory_gb": max(resource.getrusage(who).ru_maxrss for who in WHO) / 1e6,
        "load": load,
        "stages": {} if workers else stages(profile),
    }


def processor_s() -> float:
    """Return the processor time of this process and of those of its children that have ended."""
    return sum(use.ru_utime + use.ru_stime for use in map(resource.getrusage, WHO))


def shortened(survey: Any, path: Path) -> Any:
    """Return the survey of the archive's first seconds."""
    scenario = json.loads((path.parent / "scenario.json").read_text())
    end = datetime.fromisoformat(scenario["start"]).timestamp() + 4.5 * scenario["interval_s"]
    about = survey.survey.model_copy(update={"end": datetime.fromtimestamp(end, UTC)})
    return survey.model_copy(update={"survey": about})


def floor_s(frames: Sequence[Path]) -> float:
    """Return the least processor time, of some turns, in which all *frames* are decoded."""
    files = [path.read_bytes() for path in frames[: max(1, 400_000_000 // frames[0].stat().st_size)]]
    turns = []
    for _ in range(DECODES):
        start = time.process_time()
        for data in files:
            simplejpeg.decode_jpeg(data, "RGB", fastdct=True, fastupsample=True)
        turns.append(time.process_time() - start)
    for data in files[:1]:
        decode(data, max_pixels=MAX_PIXELS)
    return min(turns) * len(frames) / len(files)


def stages(profile: cProfile.Profile) -> dict[str, float]:
    """Return the seconds of each stage and pass."""
    table = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    found = {}
    for stage, (file, function) in {**STAGES, **PASSES}.items():
        rows = [row for (path, _, name), row in table.items() if path.endswith(file) and name == function]
        if not rows:
            raise LookupError(f"{stage}: {file} {function} was not called in this process")
        found[stage] = float(sum(row[3] for row in rows))
    return found


def ratio_table(measured: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the table of ratios to the decode floor."""
    rows = []
    for name, m in measured.items():
        floor = m["floor_s"] / m["frames"]
        whole = m["stages"]["first pass"] + m["stages"]["second pass"]
        rows.append(
            [
                f"{name}, {m['frames']} frames",
                f"{1e3 * floor:.1f}",
                f"{m['stages']['second pass'] / m['floor_s']:.1f}",
                f"{whole / m['floor_s']:.1f}",
                f"{m['cpu_s'] / m['floor_s']:.1f}",
                f"{m['memory_gb']:.2f}",
            ]
        )
    head = ["", "decode floor, ms a frame", "second pass", "both passes", "whole run", "peak memory, GB"]
    return markdown_table(head, rows)


def stage_table(measured: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the table of stages: share of the run, and ms a megapixel of all frames."""
    rows = []
    for stage in STAGES:
        cells = []
        for m in measured.values():
            seconds = m["stages"][stage]
            pixels = m["frames"] * m["megapixels"]
            cells += [f"{100 * seconds / m['cpu_s']:.0f} %", f"{1e3 * seconds / pixels:.1f}"]
        rows.append([stage, *cells])
    floors = [
        cell for m in measured.values() for cell in ("", f"{1e3 * m['floor_s'] / (m['frames'] * m['megapixels']):.1f}")
    ]
    rows.append(["decode floor", *floors])
    heads = [head for name in measured for head in (f"{name}, share", f"{name}, ms/MP")]
    return markdown_table(["", *heads], rows)


if __name__ == "__main__":
    main()
