"""What every part of seeing is worth: each switched off in turn, ``make bench-ablation`` (QUICK=1: one crossing).

Whole runs on rendered crossings that are never looked at and on the real clip; a part that is off is a parameter of
the survey at the value that leaves it without effect. Writes the section ``ablation`` of docs/accuracy.md.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import vtrack_batch as vt
from benchmarks.archives import MUNICH, MUNICH_GSD_M, survey_of
from benchmarks.jobs import called, parallel, quick
from benchmarks.page import ACCURACY, markdown_table, stamp, write_section
from vtrack_batch.config.survey import Survey
from vtrack_batch.evaluation.evaluate import evaluate
from vtrack_batch.evaluation.load import load_result, load_truth
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.view_params import CameraParams
from vtrack_batch.simulation.write import simulate

FIRST_SEED, GSD_M = 8301, 0.33
COMMAND = "make bench-ablation"
VERSIONS = ("vtrack-batch", "numpy", "numba", "scipy", "opencv-python-headless")


@dataclass(frozen=True)
class Part:
    """A part of seeing, and the sections of the survey with which it does nothing."""

    name: str
    off: Mapping[str, Mapping[str, Any]]


PARTS = (
    Part("nothing off", {}),
    Part("patches chosen for lying still (registration)", {"registration": {"steady_share": 1.0}}),
    Part("straightening of frames that no plane fits (registration)", {"registration": {"bend": "never"}}),
    Part("tolerance by the local range of the ground (background)", {"background": {"range_share": 0.0}}),
    Part("tolerance by the spread over time (background)", {"background": {"spread_factor": 0.0}}),
    Part("mode where ground is occupied long (background)", {"background": {"busy_share": 0.999}}),
    Part("smooth gain of exposure (detection)", {"detection": {"gain_tile_m": 1e6}}),
    Part("weight of the rim of a box (detection)", {"detection": {"rim_weight": 0.0}}),
    Part("shadow as evidence (detection)", {"detection": {"shadow_evidence": 0.0, "shadow_weight": 0.0}}),
    Part("grey bodies by nine pixels together (background)", {"detection": {"faint_levels": 250.0}}),
    Part("looking again for what is due (detection)", {"detection": {"again_score": 0.5}}),
    Part("directions of boxes by the lanes (detection)", {"detection": {"lane_frames": 0}}),
    Part("boxes of many sizes (detection)", {"detection": {"sizes_m": ((4.4, 1.8), (12.2, 2.5))}}),
    Part("second, sensitive round on the road (detection)", {"detection": {"weak_score": 0.6}}),
    Part("standing vehicles by the looks of moving ones (detection)", {"detection": {"standing": False}}),
    Part("one box for the parts of a vehicle (revision)", {"revision": {"part_gap_s": 1e-6}}),
    Part("revision after tracking", {"revision": {"revise": False}}),
)
SCORES = {
    "F1": ("f1",),
    "precision": ("precision",),
    "recall": ("recall",),
    "moving": ("strata", "moving", "recall"),
    "standing": ("strata", "standing", "recall"),
    "touching": ("strata", "touching", "recall"),
    "grey": ("strata", "grey", "recall"),
}
TEXT = """\
Whole runs with one part switched off by a parameter, all else at its default: means over {count} rendered crossings of
{seconds:g} s (seeds never looked at), and MunichStreet02, movers only. After tracking and revision. All in %, with the
difference from the first row; *time* is the processor time of the run on the crossings."""


def main() -> None:
    """Run all parts, print the table, write the section."""
    count, seconds = (1, 60.0) if quick() else (3, 60.0)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        archives = [made(folder, FIRST_SEED + number, seconds) for number in range(count)]
        jobs = [(measured, (archives, folder, number)) for number in range(len(PARTS))]
        answers = parallel(jobs)
    rows = [row(part, answer, answers[0]) for part, answer in zip(PARTS, answers, strict=True)]
    heads = ["switched off", *SCORES, "time", "MunichStreet02: F1", "precision", "recall"]
    text = TEXT.format(count=count, seconds=seconds)
    table = markdown_table(heads, rows)
    print(table)
    section = ["## What each part of seeing is worth", text, table, stamp(called(COMMAND), VERSIONS)]
    write_section(ACCURACY, "ablation", "\n\n".join(section))


def made(folder: Path, seed: int, duration_s: float) -> Path:
    """Render a crossing; return its folder."""
    place = folder / f"crossing-{seed}"
    simulate(Scenario(seed=seed, duration_s=duration_s, camera=CameraParams(gsd_m=GSD_M)), place, workers=2)
    return place


def measured(archives: Sequence[Path], folder: Path, number: int) -> dict[str, float]:
    """Return the scores of a run without part *number*, means over the *archives*, and of the real clip."""
    _warmed(archives[0], folder)
    part, found = PARTS[number], []
    for archive in archives:
        survey = vt.load_survey(archive / "survey.yaml")
        numbers, seconds = run(without(part, survey), archive / f"without-{number}", archive / "truth")
        scores = {name: value_of(numbers["detection"]["detections"], path) for name, path in SCORES.items()}
        found.append({**scores, "time": seconds})
    means = {name: float(np.mean([scores[name] for scores in found])) for name in found[0]}
    if MUNICH.is_dir():
        survey = vt.load_survey(survey_of(MUNICH, MUNICH_GSD_M, folder / f"real-{number}"))
        movers = run(without(part, survey), folder / f"real-{number}" / "results", MUNICH)[0]["detection"]["movers"]
        means |= {f"real {name}": value_of(movers, (name,)) for name in ("precision", "recall")}
        precision, recall = means["real precision"], means["real recall"]
        means["real f1"] = 2 * precision * recall / max(precision + recall, 1e-9)
    return means


@cache
def _warmed(archive: Path, folder: Path) -> None:
    """Load and compile what a run needs, once a process, so that no part's time holds it."""
    run(vt.load_survey(archive / "survey.yaml"), folder / f"warm-{os.getpid()}", archive / "truth")


def without(part: Part, survey: Survey) -> Survey:
    """Return *survey* with the part switched off."""
    sections = {name: getattr(survey, name).model_copy(update=dict(values)) for name, values in part.off.items()}
    return survey.model_copy(update=sections)


def run(survey: Survey, out: Path, truth: Path) -> tuple[Mapping[str, Any], float]:
    """Run *survey* into *out*; return its evaluation, and the processor seconds it took."""
    placed = survey.model_copy(update={"output": survey.output.model_copy(update={"root": str(out)})})
    began = time.process_time()
    vt.run_survey(placed)
    seconds = time.process_time() - began
    return evaluate(load_result(out), load_truth(truth)).numbers, seconds


def value_of(numbers: Any, path: Sequence[str]) -> float:
    """Return one score; NaN where the truth says nothing."""
    for name in path:
        numbers = numbers.get(name) if isinstance(numbers, Mapping) else None
    value = numbers.get("value") if isinstance(numbers, Mapping) else numbers
    return float("nan") if value is None else float(value)


def row(part: Part, scores: Mapping[str, float], whole: Mapping[str, float]) -> list[str]:
    """Return the cells of a part: the first row's own values, of the others also how far they are from it."""
    names = [*SCORES, "time", "real f1", "real precision", "real recall"]
    return [part.name, *(cell(name, scores.get(name), whole.get(name), first=not part.off) for name in names)]


def cell(name: str, value: float | None, whole: float | None, *, first: bool) -> str:
    """Return one value with its difference from *whole*."""
    if value is None or whole is None or not np.isfinite(value):
        return "–"
    if name == "time":
        return f"{value:.0f} s" if first else f"{100 * (value / whole - 1):+.0f} %"
    return f"{100 * value:.1f}" if first else f"{100 * value:.1f} ({100 * (value - whole):+.1f})"


if __name__ == "__main__":
    main()
