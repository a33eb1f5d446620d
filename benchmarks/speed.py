"""How many decodes a run costs, stage by stage, beside what is asked for: ``make bench-speed`` (QUICK=1: HD only).

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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import simplejpeg

import vtrack_batch as vt
from benchmarks.environment import ONE_THREAD
from benchmarks.jobs import called, quick
from benchmarks.page import PERFORMANCE, markdown_table, stamp, write_section
from vtrack_batch.archive.decode import decode
from vtrack_batch.pipeline import detect
from vtrack_batch.registration.alignment import register
from vtrack_batch.registration.bending import common_picture, find_bend, straighten
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.reference import prepare_reference
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.view_params import CameraParams
from vtrack_batch.simulation.write import simulate

COMMAND = "make bench-speed"
VERSIONS = ("vtrack-batch", "numpy", "numba", "scipy", "opencv-python-headless", "simplejpeg")
MAX_PIXELS = 200_000_000
DECODES, FLOOR_BYTES = 3, 100_000_000
BENT_FRAMES = 12
LARGE = 20_000_000
"""Pixels from which a profile takes little of a run, which is long enough once."""
UNIT_FRAMES = 200
"""Over so many frames the first pass of 48 MP is spread, as a unit of a real archive spreads it."""
TILE_PX = 96
GSD_M = 0.33
WHO = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)

STAGES = {
    "decode, strict": ("archive/decode.py", "decode"),
    "register": ("registration/alignment.py", "register"),
    "settle poses": ("pipeline/laying.py", "lay_samples"),
    "learn the background": ("background/learn.py", "learn_background"),
    "difference": ("background/subtract.py", "subtract"),
    "faint bodies": ("background/faint.py", "add_faint"),
    "boxes": ("detection/boxes.py", "fit_boxes"),
    "adjust boxes": ("detection/refine.py", "refine"),
    "place model": ("detection/place.py", "learn_place"),
    "looks of vehicles": ("detection/examples.py", "add"),
    "standing vehicles": ("detection/standing.py", "find_standing"),
    "link": ("pipeline/track.py", "track_sequence"),
    "traffic": ("pipeline/traffic.py", "measure_date"),
    "pictures": ("pipeline/picture.py", "draw_sequence"),
}
"""Stage -> the function, by file and name, whose cumulated time it is."""
PASSES = {"first pass": "_first_pass", "second pass": "_second_pass"}
"""Pass -> the function of step ``detect`` that is it; a profile would slow down small ones."""


def main() -> None:
    """Render archives, run them, write the section; with an argument: run one survey and print figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--survey", type=Path, help="run this survey alone")
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--unit-s", type=float, default=None)
    parser.add_argument("--memory", action="store_true", help="only the peak of memory is asked for")
    parser.add_argument("--bend", action="store_true", help="what straightening the survey's frames costs")
    given = parser.parse_args()
    if given.survey and given.bend:
        print(json.dumps(bending(given.survey)))
        return
    if given.survey:
        print(json.dumps(one_run(given.survey, given.workers, given.unit_s, only_memory=given.memory)))
        return
    with tempfile.TemporaryDirectory() as place:
        section = performance_page(Path(place), quick())
    write_section(PERFORMANCE, "bench-speed", section)


def performance_page(folder: Path, few: bool) -> str:
    """Return the section on speed and memory."""
    wanted = {"HD": Scenario(seed=9001, duration_s=90 if few else 150, camera=CameraParams(gsd_m=GSD_M))}
    if not few:
        wanted["48 MP"] = Scenario(seed=9002, duration_s=90, camera=camera(8000, 6000))
    measured = {}
    for name, scenario in wanted.items():
        place = folder / name.replace(" ", "")
        simulate(scenario, place, workers=min(2, os.cpu_count() or 1))
        measured[name] = in_process(place / "survey.yaml")
        print(name, json.dumps(measured[name]), flush=True)
    hd, half_s = folder / "HD" / "survey.yaml", wanted["HD"].duration_s / 2
    bend = in_process(hd, "--bend")
    runs = [in_process(hd, "--workers", workers, "--unit-s", half_s) for workers in (1, 2)]
    huge = None
    if not few:
        simulate(Scenario(seed=9003, duration_s=9, camera=camera(10_000, 10_000)), folder / "huge", workers=1)
        huge = in_process(folder / "huge" / "survey.yaml", "--memory")
    return "\n\n".join(
        [
            "## A run in units of decoding",
            HEAD,
            target_table(measured, bend, huge, runs),
            workers_text(*runs),
            ratio_table(measured),
            "### Where the time goes",
            stage_table(measured),
            stamp(called(COMMAND), VERSIONS),
        ]
    )


def camera(width_px: int, height_px: int) -> CameraParams:
    """Return a camera that hovers over the crossing and sees much land around it."""
    return CameraParams(gsd_m=GSD_M, width_px=width_px, height_px=height_px)


HEAD = """\
Processor time, one thread, JPEG of quality 90, warm page cache and compiled code; the floor is the fastest decode that
is sound but not strict (simplejpeg, fast DCT and fast upsampling), of the same files in the same process. The first
pass learns the ground from up to 31 frames of the unit; it weighs less the longer the unit is, and at 48 MP counts as
for a unit of 200 frames. A whole run is from the index to the published tables, trajectories and report included.
Memory is the peak of the process. Registration beside stabilo: see docs/accuracy.md."""


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


def in_process(survey: Path, *arguments: object) -> dict[str, Any]:
    """Measure a survey in a fresh process with these *arguments* of this program; return its figures."""
    command = [sys.executable, "-m", "benchmarks.speed", "--survey", survey, *arguments]
    environment = {**os.environ, **ONE_THREAD}
    done = subprocess.run(list(map(str, command)), check=True, env=environment, stdout=subprocess.PIPE)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def one_run(path: Path, workers: int, unit_s: float | None, *, only_memory: bool = False) -> dict[str, Any]:
    """Run the survey at *path* after a short run that compiles and loads; return seconds, stages and memory."""
    cv2.setNumThreads(1)
    frames = frames_of(path)
    survey = vt.load_survey(path)
    section = survey.execution if unit_s is None else survey.execution.model_copy(update={"unit_s": unit_s})
    detailed = not workers and not only_memory
    with tempfile.TemporaryDirectory() as place:

        def run(name: str, source: Any) -> None:
            out = source.output.model_copy(update={"root": str(Path(place) / name)})
            vt.run_survey(source.model_copy(update={"output": out, "execution": section}), workers=workers)

        if detailed:
            run("warm", shortened(survey, path))
        floor = 0.0 if only_memory else floor_s(frames)
        profile, size = cProfile.Profile(time.process_time), cv2.imread(str(frames[0])).shape
        large = size[0] * size[1] > LARGE
        load, start, start_cpu = os.getloadavg()[0], time.perf_counter(), processor_s()
        with timed_passes() as passes:
            if detailed and large:
                profile.runcall(run, "full", survey)
            else:
                run("full", survey)
        wall, processor = time.perf_counter() - start, processor_s() - start_cpu
        if detailed and not large:
            profile.runcall(run, "profiled", survey)
        active = active_share(Path(place) / "full" / "current" / "detections", size)
    return {
        "frames": len(frames),
        "megapixels": size[0] * size[1] / 1e6,
        "floor_s": floor,
        "wall_s": wall,
        "cpu_s": processor,
        "memory_gb": max(resource.getrusage(who).ru_maxrss for who in WHO) / 1e6,
        "load": load,
        "vehicles_per_mp": vehicles(path) / (size[0] * size[1] / 1e6),
        "active": active,
        "stages": {**stages(profile), **passes} if detailed else {},
    }


@contextmanager
def timed_passes() -> Iterator[dict[str, float]]:
    """Give the seconds of each pass, of all units that this process runs meanwhile; nothing else is slowed down."""
    spent, before = dict.fromkeys(PASSES, 0.0), {name: getattr(detect, name) for name in PASSES.values()}

    def timed(which: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def run(*given: Any) -> Any:
            start = time.process_time()
            found = function(*given)
            spent[which] += time.process_time() - start
            return found

        return run

    for which, name in PASSES.items():
        setattr(detect, name, timed(which, before[name]))
    try:
        yield spent
    finally:
        for name, function in before.items():
            setattr(detect, name, function)


def frames_of(path: Path) -> list[Path]:
    """Return the files of the frames of the survey at *path*, in order of time."""
    return sorted(file for file in (path.parent / "frames").rglob("*") if file.is_file())


def vehicles(path: Path) -> float:
    """Return how many vehicles a frame of a simulated archive shows: on the move or in a queue, and parked."""
    truth = path.parent / "truth"
    moving = pd.read_parquet(truth / "detections.parquet", columns=["t_utc"]).groupby("t_utc").size().mean()
    return float(moving) + len(pd.read_csv(truth / "parked.csv"))


def active_share(tables: Path, size: Sequence[int]) -> float:
    """Return the share of all tiles in which anything was ever detected."""
    places = pd.read_parquet(tables, columns=["row_px", "col_px"]).to_numpy() // TILE_PX
    return len(np.unique(places, axis=0)) / float(np.prod(np.ceil(np.array(size[:2]) / TILE_PX)))


def bending(path: Path) -> dict[str, float]:
    """Return what telling how frames bend, and straightening them, costs on top of a plane pose, ms a megapixel."""
    cv2.setNumThreads(1)
    params = RegistrationParams()
    frames = [decode(file.read_bytes(), max_pixels=MAX_PIXELS).pixels for file in frames_of(path)[:BENT_FRAMES]]
    reference = prepare_reference(frames[0], params=params)
    poses = [register(frame, reference, params=params).frame_to_reference for frame in frames]
    picture = common_picture(zip(frames, poses, strict=True))
    spent = []
    for frame, pose in zip(frames, poses, strict=True):
        start = time.process_time()
        straighten(frame, find_bend(frame, pose, picture, params=params))
        spent.append(time.process_time() - start)
    return {"ms_per_mp": 1e9 * float(np.median(spent)) / (frames[0].shape[0] * frames[0].shape[1])}


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
    files = [path.read_bytes() for path in frames[: max(1, FLOOR_BYTES // frames[0].stat().st_size)]]
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
    """Return the seconds of each stage."""
    table = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    found = {}
    for stage, (file, function) in STAGES.items():
        rows = [row for (path, _, name), row in table.items() if path.endswith(file) and name == function]
        if not rows:
            raise LookupError(f"{stage}: {file} {function} was not called in this process")
        found[stage] = float(sum(row[3] for row in rows))
    return found


def target_table(
    measured: Mapping[str, Mapping[str, Any]],
    bend: Mapping[str, float],
    huge: Mapping[str, Any] | None,
    runs: Sequence[Mapping[str, Any]],
) -> str:
    """Return what was measured beside what is asked for."""
    hd, large = measured["HD"], measured.get("48 MP")
    rows = [
        [f"HD, {hd['vehicles_per_mp']:.0f} vehicles/MP: second pass", f"{ratio(hd, 'second pass'):.1f}", "3.5", "3.0"],
        ["the same: whole run", f"{hd['cpu_s'] / hd['floor_s']:.1f}", "4.5", "4.0"],
    ]
    if large is not None:
        saved = large["stages"]["first pass"] * (1 - min(1.0, large["frames"] / UNIT_FRAMES))
        name = f"48 MP, {100 * large['active']:.0f} % of tiles active: second pass"
        rows += [
            [name, f"{ratio(large, 'second pass'):.1f}", "1.8", "1.6"],
            ["the same: whole run", f"{(large['cpu_s'] - saved) / large['floor_s']:.1f}", "2.1", "1.9"],
            ["peak memory, one worker, 48 MP, GB", f"{large['memory_gb']:.2f}", "1.2", "1.0"],
        ]
    if huge is not None:
        rows.append(["peak memory, one worker, 10,000 x 10,000 px, GB", f"{huge['memory_gb']:.2f}", "1.8", "1.5"])
    rows += [
        ["straightening frames that bend, ms/MP", f"{bend['ms_per_mp']:.1f}", "15", "8"],
        ["two workers against one", f"{runs[0]['wall_s'] / runs[1]['wall_s']:.2f}", "1.8", "1.9"],
    ]
    return markdown_table(["decodes, where nothing else is said", "measured", "must", "aim"], rows)


def ratio(measured: Mapping[str, Any], stage: str) -> float:
    """Return how many decodes of all files a stage took."""
    return float(measured["stages"][stage] / measured["floor_s"])


def ratio_table(measured: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the table of ratios to the decode floor."""
    rows = []
    for name, m in measured.items():
        both = ratio(m, "first pass") + ratio(m, "second pass")
        figures = 1e3 * m["floor_s"] / m["frames"], ratio(m, "second pass"), both, m["cpu_s"] / m["floor_s"]
        cells = [f"{figure:.1f}" for figure in figures]
        rows.append([f"{name}, {m['frames']} frames", *cells, f"{m['memory_gb']:.2f}"])
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
