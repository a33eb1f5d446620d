"""What the engine costs around the steps: publishing years, its share of a run, workers, clusters.

``python -m benchmarks.engine`` (`make bench-engine`) writes the section ``engine`` of docs/performance.md; with names
of its parts (publish, share, workers, cluster) it prints these alone. Wall clock where machines wait for each other:
let nothing else run.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import vtrack_batch as vt
from benchmarks.page import PERFORMANCE, PROJECT, markdown_table, stamp, write_section
from vtrack_batch.archive.sequences import split_sequences
from vtrack_batch.pipeline import run
from vtrack_batch.pipeline.index import Index
from vtrack_batch.pipeline.parts import Context
from vtrack_batch.pipeline.plan import Piece, Plan, make_plan
from vtrack_batch.pipeline.prepare import Prepared
from vtrack_batch.pipeline.publish import OF_DATE, OF_SEQUENCE
from vtrack_batch.pipeline.workers import InProcess, Local, Work, Workers
from vtrack_batch.storage.output import Output

sys.path.insert(0, str(PROJECT / "tests" / "pipeline"))

from little import little_archive

DAYS = 3650
FRAMES_A_DAY = 8
UNITS = 200
SCENARIO = PROJECT / "configs" / "scenario-crossing.yaml"


def main(wanted: list[str]) -> None:
    """Measure what is *wanted*; all of it also goes to the page."""
    rows = []
    for name in wanted or list(PARTS):
        with tempfile.TemporaryDirectory(prefix="vtrack-engine-") as folder:
            rows += PARTS[name](Path(folder))
        print(*(": ".join(row) for row in rows), sep="\n", flush=True)
    if not wanted:
        table = markdown_table(["", "measured", "promised"], rows)
        versions = stamp("python -m benchmarks.engine", ("vtrack-batch", "numpy", "pandas", "pyarrow", "distributed"))
        write_section(PERFORMANCE, "engine", f"{INTRODUCTION}\n\n{table}\n\n{versions}")


INTRODUCTION = f"""## What the engine costs

*Publish*: {DAYS:,} dates x {len(OF_SEQUENCE) + len(OF_DATE) + 1} tables as parts of real rows, one date changed; from \
the finished parts to the new snapshot, all that a run does after its last step. *Engine's share*: processor time of a \
run on the archive of `make demo` in one process, outside of the four steps: indexing, planning, publishing, the report.
*Two workers*: `run` on the same archive, a sequence on each of two days; wall clock, from the start of the processes \
to the snapshot. *A unit on Dask*: wall clock of units of {FRAMES_A_DAY} frames that do nothing, one worker thread, \
over the same in one process."""


def publish_years(folder: Path) -> list[list[str]]:
    """Publish ten years of finished parts, then again with one date changed."""
    template = template_parts(folder / "template")
    survey = vt.load_survey(folder / "template" / "survey.yaml")
    survey = survey.model_copy(update={"output": survey.output.model_copy(update={"root": str(folder / "years")})})
    output = Output(folder / "years")
    output.create()
    context = Context(survey, folder, output.root, None)
    frames = frames_of_years(DAYS)
    seconds = []
    for changed in (None, DAYS // 2):
        if changed is not None:
            frames.loc[changed * FRAMES_A_DAY, "sha256"] = "f" * 64
        plan = make_plan(frames, survey, zones_text=None, learned={})
        write_parts(plan, output, template)
        os.sync()
        nothing = pd.DataFrame(columns=["path", "reason", "detail"])
        prepared = Prepared(context, Index(folder, frames, nothing, "listing"), plan, ())
        began_s = time.monotonic()
        report = run._publish(prepared, {}, run.Orders(), late=False)
        seconds.append(time.monotonic() - began_s)
        assert report.published, "the bench measures nothing"
    return [
        ["publish ten years, first time", f"{seconds[0]:.1f} s", "-"],
        ["publish ten years, one date changed", f"{seconds[1]:.1f} s", "5 s"],
    ]


def template_parts(folder: Path) -> dict[str, Path]:
    """Return step → the part of a little archive that was run in earnest."""
    little_archive(folder)
    vt.run_survey(vt.load_survey(folder / "survey.yaml"))
    data = folder / "results" / "data"
    return {step: sorted((data / step).iterdir())[0] for step in ("detect", "track", "traffic", "picture")}


def frames_of_years(days: int) -> pd.DataFrame:
    """Return the index of an archive of some frames on each of so many days."""
    starts = np.datetime64("2016-01-01T12:00", "us") + np.arange(days) * np.timedelta64(1, "D")
    times = (starts[:, None] + np.arange(FRAMES_A_DAY) * np.timedelta64(2_500_000, "us")).ravel()
    paths = [f"{at}.jpg" for at in times.astype(str)]
    files = pd.DataFrame({"path": paths, "platform": "main", "t_utc": pd.DatetimeIndex(times, tz="UTC")})
    files["sha256"] = [f"{number:064x}" for number in range(len(files))]
    return split_sequences(files, max_gap_s=60.0, time_zone="UTC")


def write_parts(plan: Plan, output: Output, template: dict[str, Path]) -> None:
    """Make each piece of *plan* that has no part one, of the rows of the *template* of its step."""
    made = {step: output.keys(step) for step in template}
    about = {step: json.loads((part / "part.json").read_bytes()) for step, part in template.items()}
    for piece in plan.pieces():
        if piece.key not in made[piece.step]:
            folder = output.data / piece.step / piece.key
            shutil.copytree(template[piece.step], folder)
            own = {"name": piece.name, "made_of": dict(piece.ingredients), "needs": [need.key for need in piece.needs]}
            (folder / "part.json").write_text(json.dumps({**about[piece.step], **own}))


def engines_share(folder: Path) -> list[list[str]]:
    """Return how much of a run's processor time is spent outside of the steps."""
    survey = vt.load_survey(demo_archive(folder) / "survey.yaml")
    steps_s = 0.0
    real = run._work

    def timed(step: Any) -> Work:
        work = real(step)

        def call(piece: Piece, context: Context) -> None:
            nonlocal steps_s
            began_s = time.process_time()
            work(piece, context)
            steps_s += time.process_time() - began_s

        return call

    run._work = timed
    try:
        for name in ("warm", "measured"):
            steps_s, began_s = 0.0, time.process_time()
            vt.run_survey(into(survey, folder / name))
            whole_s = time.process_time() - began_s
    finally:
        run._work = real
    share = 100 * (whole_s - steps_s) / whole_s
    return [["the engine's share of a run", f"{share:.1f} % of {whole_s:.0f} s", "5 %"]]


def two_workers(folder: Path) -> list[list[str]]:
    """Return how much faster `run` is with two workers than with one, on the demo archive."""
    survey = demo_archive(folder) / "survey.yaml"
    walls = []
    for number, count in enumerate((1, 1, 2)):  # the first compiles
        out = folder / f"out-{number}"
        command = [sys.executable, "-m", "vtrack_batch", "run", survey, "--out", out, "--workers", str(count), "-q"]
        began_s = time.monotonic()
        subprocess.run(list(map(str, command)), cwd=PROJECT, check=True)
        walls.append(time.monotonic() - began_s)
    told = f"{walls[1] / walls[2]:.2f} ({walls[1]:.0f} s, {walls[2]:.0f} s)"
    return [["two workers against one, the demo's archive", told, "1.8"]]


def units_dealt_out(folder: Path) -> list[list[str]]:
    """Return what dealing out a unit costs, on Dask and to a process of this machine."""
    from distributed import LocalCluster

    from vtrack_batch.pipeline.cluster import Cluster

    little_archive(folder / "survey", 1)
    survey = vt.load_survey(folder / "survey" / "survey.yaml")
    output = Output(folder / "out")
    output.create()
    context = Context(survey, folder, output.root, None)
    plan = make_plan(frames_of_years(UNITS), survey, zones_text=None, learned={})
    own_s = seconds_a_unit(InProcess, plan, context)
    local_s = seconds_a_unit(lambda: Local(1), plan, context)
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        dask_s = seconds_a_unit(lambda: Cluster(cluster.scheduler_address), plan, context)
    return [
        ["a unit on Dask", f"{1e3 * (dask_s - own_s):.1f} ms", "50 ms"],
        ["a unit to a process of this machine", f"{1e3 * (local_s - own_s):.1f} ms", "-"],
    ]


def seconds_a_unit(begin: Callable[[], Workers], plan: Plan, context: Context) -> float:
    """Return the wall clock of a unit that does nothing; the first few, which load and start, do not count."""
    workers = begin()
    try:
        for pieces in (plan.detect[:4], plan.detect):
            began_s = time.monotonic()
            assert all(death is None for _, death in workers.run(pieces, idle, context))
    finally:
        workers.close()
    return (time.monotonic() - began_s) / UNITS


def idle(piece: Piece, context: Context) -> None:
    """Do nothing with *piece*, all of whose frames have come along."""
    assert piece.unit is not None
    assert len(list(piece.unit.frames)) == FRAMES_A_DAY


def demo_archive(folder: Path) -> Path:
    """Return the archive of `make demo`; DEMO names a folder where it was made before."""
    from vtrack_batch.config.load import load_params
    from vtrack_batch.simulation.params import Scenario
    from vtrack_batch.simulation.write import simulate

    made = os.environ.get("DEMO")
    if not made:
        simulate(load_params(SCENARIO, Scenario), folder / "demo", base=SCENARIO.parent)
    return Path(made or folder / "demo")


def into(survey: Any, out: Path) -> Any:
    """Return *survey* with its results in *out*."""
    return survey.model_copy(update={"output": survey.output.model_copy(update={"root": str(out)})})


PARTS = {"publish": publish_years, "share": engines_share, "workers": two_workers, "cluster": units_dealt_out}

if __name__ == "__main__":
    main(sys.argv[1:])
