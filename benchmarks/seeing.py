"""Ours and peers on the same frames in the same run: ``make bench-seeing`` (QUICK=1: two short archives).

Background: MOG2, KNN, running average and sliding median get our poses, exposure, box fit and place model, and the best
settings of a grid on an archive that is not scored. Registration: stabilo, ORB, ECC against the renderer's true poses.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import vtrack_batch as vt
from benchmarks.archives import CITY, CITY_GSD_M, MUNICH, MUNICH_GSD_M, survey_of
from benchmarks.environment import pinned
from benchmarks.jobs import called, quick
from benchmarks.page import ACCURACY, FIGURES, PERFORMANCE, SHARED, markdown_table, stamp, write_section
from benchmarks.seeing_detection import PEERS, Settings, aligned, detect, scores, tuned
from benchmarks.seeing_realism import LABELS, differences, draw, real, rendered
from benchmarks.seeing_registration import compare, flown
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.view_params import CameraParams
from vtrack_batch.simulation.write import simulate

TUNING_SEED, FIRST_SEED = 7001, 8001
GSD_M = 0.33
COMMAND = "make bench-seeing"
VERSIONS = ("vtrack-batch", "numpy", "numba", "scipy", "opencv-python-headless")
DRAWS = 2000


@dataclass(frozen=True)
class Extent:
    """How much is run."""

    archives: int
    duration_s: float
    large: bool


QUICK, FULL = Extent(2, 60.0, False), Extent(10, 120.0, True)


def main() -> None:
    """Run all three parts and write their sections of the pages."""
    extent = QUICK if quick() else FULL
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if (SHARED / "kit-ais").is_dir():
            write_section(ACCURACY, "bench-seeing-realism", realism_page(folder))
        write_section(PERFORMANCE, "bench-seeing-registration", registration_page(folder, extent))
        write_section(ACCURACY, "bench-seeing-detection", detection_page(folder, extent))


# detection ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Archive:
    """An archive that has been run."""

    name: str
    frames: Path
    truth: Path
    results: Path
    gsd_m: float


def detection_page(folder: Path, extent: Extent) -> str:
    """Return the section on detection."""
    tuning = made(folder, TUNING_SEED, extent.duration_s / 2)
    work = aligned(tuning.frames, tuning.results, tuning.gsd_m)
    chosen = {name: tuned(work, tuning.results, tuning.truth, name) for name in PEERS}
    del work
    print("tuned:", chosen, flush=True)
    unseen = [made(folder, FIRST_SEED + i, extent.duration_s) for i in range(extent.archives)]
    groups = {f"{extent.archives} rendered crossings, {GSD_M} m, 1.5 s": [measured(a, chosen) for a in unseen]}
    for archive in shared(folder):
        groups[archive.name] = [measured(archive, chosen)]
    parts = [HEAD.format(count=extent.archives, seconds=extent.duration_s, settings=settings_text(chosen))]
    for name, results in groups.items():
        parts += [f"**{name}**", detection_table(results)]
    return "\n\n".join(["## Detection beside other backgrounds", *parts, stamp(called(COMMAND), VERSIONS)])


HEAD = """\
Everything but the background is the same for all: registration, exposure, shadow ratio and direction, box fit, place
model, gates. Peers work on frames laid on the reference; recursive ones are shown the archive twice, the sliding median
looks both ways. Ours has default parameters; peers have the settings with the best F1 of a grid on a rendered
crossing that is not scored: {settings}. Crossings: {count} seeds never looked at, {seconds:g} s each. Scores are of all
detections before tracking; brackets are 95 % intervals, over archives where there are several, else over blocks of
time. MunichStreet02: movers only; what lies on another labelled vehicle is neither right nor wrong. Its figures before
tracking are lower in precision than those of moving tracks above."""


def made(folder: Path, seed: int, duration_s: float) -> Archive:
    """Render a crossing, run it with default parameters."""
    place = folder / f"crossing-{seed}"
    simulate(Scenario(seed=seed, duration_s=duration_s, camera=CameraParams(gsd_m=GSD_M)), place, workers=workers())
    vt.run_survey(vt.load_survey(place / "survey.yaml"), workers=1)
    print(place.name, flush=True)
    return Archive(place.name, place / "frames", place / "truth", place / "results", GSD_M)


def shared(folder: Path) -> Iterator[Archive]:
    """Run the archives beside the project."""
    for source, gsd_m in ((CITY, CITY_GSD_M), (MUNICH, MUNICH_GSD_M)):
        if source.is_dir():
            survey = survey_of(source, gsd_m, folder / source.name)
            vt.run_survey(vt.load_survey(survey), workers=1)
            name = source.relative_to(SHARED).as_posix()
            yield Archive(name, source / "frames", source, survey.parent / "results", gsd_m)


def measured(archive: Archive, chosen: Mapping[str, Settings]) -> dict[str, dict[str, Any]]:
    """Return the scores of every method on an archive."""
    found = {"ours": scores(archive.results, archive.truth)}
    work = aligned(archive.frames, archive.results, archive.gsd_m)
    for name, settings in chosen.items():
        detected = detect(work, name, settings)
        found[name] = {**scores(archive.results, archive.truth, detected.rows), "ms": detected.background_ms}
    shown = {name: round(part["f1"]["value"], 3) for name, part in found.items()}
    print(archive.name, shown, flush=True)
    return found


def detection_table(results: Sequence[Mapping[str, Mapping[str, Any]]]) -> str:
    """Return the table of a group of archives: a row a score, a column a method."""
    names = list(results[0])
    rows = [
        ["F1, %", *(cell([r[n]["f1"] for r in results], 100) for n in names)],
        ["precision, %", *(cell([r[n]["precision"] for r in results], 100) for n in names)],
        ["recall, %", *(cell([r[n]["recall"] for r in results], 100) for n in names)],
    ]
    for stratum in results[0]["ours"]["strata"]:
        scored = [{n: r[n]["strata"].get(stratum) for n in names} for r in results]
        cells = [cell([r[n]["recall"] for r in scored if r[n] is not None], 100) for n in names]
        rows.append([f"recall {stratum}, %", *cells])
    for key, label in (("centroid_error_median_px", "median"), ("centroid_error_rms_px", "RMS")):
        rows.append([f"centroid error {label}, px", *(cell([r[n][key] for r in results], 1, 2) for n in names)])
    times = ["–" if n == "ours" else f"{np.median([r[n]['ms'] for r in results]):.0f}" for n in names]
    rows.append(["background, ms a frame", *times])
    return markdown_table(["", *names], rows)


def cell(values: Sequence[Mapping[str, float | None]], factor: float, digits: int = 1) -> str:
    """Return the mean over archives and its interval by drawing archives; of one archive its own interval."""
    known = [value["value"] for value in values if value["value"] is not None]
    if not known:
        return "–"
    mean = float(np.mean(known))
    if len(values) == 1:
        lo, hi = values[0]["lo"], values[0]["hi"]
    else:
        drawn = np.random.default_rng(1).choice(known, (DRAWS, len(known))).mean(axis=1)
        lo, hi = (float(x) for x in np.percentile(drawn, [2.5, 97.5]))
    ends = f" [{factor * lo:.{digits}f}, {factor * hi:.{digits}f}]" if lo is not None and hi is not None else ""
    return f"{factor * mean:.{digits}f}{ends}"


def settings_text(chosen: Mapping[str, Settings]) -> str:
    """Return the peers' settings in words."""
    return "; ".join(f"{name} " + ", ".join(f"{k} {v:g}" for k, v in chosen[name].items()) for name in chosen)


def workers() -> int:
    """Return how many processes render frames: nothing that is timed."""
    return min(2, os.cpu_count() or 1)


# registration ---------------------------------------------------------------------------------------------------------


def registration_page(folder: Path, extent: Extent) -> str:
    """Return the section on registration."""
    half_s = extent.duration_s / 2
    wanted = {
        "HD, hovering": Scenario(seed=8101, duration_s=half_s, camera=CameraParams(gsd_m=GSD_M)),
        "HD, helicopter": Scenario(
            seed=8102,
            duration_s=half_s,
            camera=CameraParams(gsd_m=GSD_M, drift_px=250, rotation_deg=3, jitter_px=4),
        ),
    }
    if extent.large:
        wanted["48 MP, hovering"] = Scenario(
            seed=8103, duration_s=12, camera=CameraParams(gsd_m=GSD_M, width_px=8000, height_px=6000)
        )
    tables = []
    for name, scenario in wanted.items():
        place = folder / name.replace(", ", "-").replace(" ", "-")
        simulate(scenario, place, workers=workers())
        tables.append(compare(flown(place)).assign(scene=name))
        print(tables[-1].round(3).to_string(), flush=True)
    rows = [
        [f"{row.scene}: {row.method}", f"{row.median_px:.3f}", f"{row.max_px:.3f}", str(row.lost), f"{row.ms:.0f}"]
        for row in pd.concat(tables).itertuples()
    ]
    text = (
        "RMS distance over a grid of the whole frame from the renderer's true poses, and the median processor time "
        "of one frame without its decoding, one thread, in the same run; lost = refused or no answer. "
        "No method is told where the frame before it was."
    )
    head = ["", "median, px", "max over frames, px", "lost", "ms a frame"]
    made_by = stamp(called(COMMAND), VERSIONS, [pinned("stabilo")])
    return "\n\n".join(["## Registration beside others", text, markdown_table(head, rows), made_by])


# realism --------------------------------------------------------------------------------------------------------------


def realism_page(folder: Path) -> str:
    """Return the section that lays rendered beside real frames."""
    clip = MUNICH
    pairs = {
        gsd_m: (
            rendered(folder / f"realism-{gsd_m}", gsd_m),
            real(clip, MUNICH_GSD_M / gsd_m),
        )
        for gsd_m in (MUNICH_GSD_M, GSD_M)
    }
    draw(pairs, FIGURES / "realism.svg")
    apart = {gsd_m: differences(*both) for gsd_m, both in pairs.items()}
    rows = [[label, *(f"{apart[gsd_m][name]:.2f}" for gsd_m in apart)] for name, label in LABELS.items()]
    text = (
        "Curves of rendered frames (blue, dashed) and of KIT AIS MunichStreet02 (orange), as taken and shrunk to "
        "the coarser distance. The table holds the greatest difference of the two distribution functions: 0 = alike, "
        "1 = nothing in common."
    )
    table = markdown_table(["", *(f"{gsd_m:g} m a pixel" for gsd_m in apart)], rows)
    return "\n\n".join(
        ["## Rendered beside real frames", "![](figures/realism.svg)", text, table, stamp(called(COMMAND), VERSIONS)]
    )


if __name__ == "__main__":
    main()
