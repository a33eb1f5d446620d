"""Completeness by injection against true recall: ``python -m benchmarks.completeness`` (QUICK=1: one archive).

Crossings with seeds nobody looked at, long enough for 200 vehicles a place, run with ``injections_per_unit``; places
with fewer vehicles are left out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import shapely

import vtrack_batch as vt
from benchmarks.crossings import crossings
from benchmarks.jobs import called
from benchmarks.page import ACCURACY, markdown_table, stamp, write_section
from vtrack_batch.completeness.params import CompletenessParams
from vtrack_batch.evaluation.frames import joined_frames
from vtrack_batch.evaluation.load import load_result, load_truth
from vtrack_batch.evaluation.pairing import pair
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.scene import make_scene, sightings
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.places import places_of
from vtrack_batch.traffic.zones import parse_zones

FIRST_SEED, FEWEST = 9501, 200
COMMAND = "python -m benchmarks.completeness"
VERSIONS = ("vtrack-batch", "numpy", "opencv-python-headless")


def main() -> None:
    """Make the archives, run them, write the section."""
    rows = []
    for seed, folder in crossings(FIRST_SEED):
        run_with_injections(folder)
        rows.append(compared(folder).assign(seed=seed))
    write_section(ACCURACY, "completeness", page(pd.concat(rows), called(COMMAND)))


def run_with_injections(folder: Path) -> None:
    """Run the archive with 2000 injections a unit."""
    survey = vt.load_survey(folder / "survey.yaml")
    painted = survey.model_copy(update={"completeness": CompletenessParams(injections_per_unit=2000)})
    vt.run_survey(painted.based_at(folder), workers=1)


def compared(folder: Path) -> pd.DataFrame:
    """Return for each place with enough vehicles what was said of it, and what is true."""
    result, truth, params = load_result(folder / "results"), load_truth(folder / "truth"), EvaluationParams()
    frames, _ = joined_frames(result, truth)
    scene = make_scene(truth, frames, "frame", params)
    true = pair(sightings(result, truth, frames, "frame"), scene, params).true
    true = true[true["wanted"]]
    points = shapely.points(true["x_m"].to_numpy(float), true["y_m"].to_numpy(float))
    coverage = pd.read_parquet(folder / "results" / "current" / "coverage")
    zones = parse_zones((folder / "zones.geojson").read_text(), crs=None, source="zones.geojson")
    rows = []
    for place in places_of(zones, site_centre=None, params=TrafficParams()):
        near = shapely.dwithin(place.shape, points, CompletenessParams().near_gate_m if place.is_line else 0.0)
        said = coverage[(coverage["place"].astype(str) == place.id) & coverage["completeness"].notna()]
        if true["vehicle"][near].nunique() < FEWEST or said.empty:
            continue
        weight = said["frames"].to_numpy(float)
        columns = ["completeness", "completeness_lo", "completeness_hi"]
        share, lo, hi = (float(np.average(said[name], weights=weight)) for name in columns)
        found = float((true["row"][near] >= 0).mean())
        rows.append((place.id, place.role, true["vehicle"][near].nunique(), found, share, lo, hi))
    return pd.DataFrame(rows, columns=["place", "role", "vehicles", "true", "said", "lo", "hi"])


def page(rows: pd.DataFrame, command: str) -> str:
    """Return the section."""
    off = 100 * (rows["said"] - rows["true"]).abs()
    within = rows["true"].between(rows["lo"], rows["hi"]).mean()
    shown = rows.assign(
        seed=rows["seed"].astype(str),
        vehicles=rows["vehicles"].astype(str),
        true=[f"{100 * value:.1f}" for value in rows["true"]],
        said=[
            f"{100 * a:.1f} [{100 * b:.1f}, {100 * c:.1f}]" for a, b, c in rows[["said", "lo", "hi"]].to_numpy(float)
        ],
    )
    summary = (
        f"{len(rows)} places with at least {FEWEST} vehicles: off by {off.mean():.1f} points on average, "
        f"{off.max():.1f} at most; {100 * (off <= 3).mean():.0f} % within 3 points; true recall in "
        f"{100 * within:.0f} % of the intervals."
    )
    head = ["seed", "place", "vehicles", "true recall, %", "completeness by injection, %"]
    table = shown[["seed", "place", "vehicles", "true", "said"]].to_numpy(str).tolist()
    return "\n\n".join(["## Completeness by injection", summary, markdown_table(head, table), stamp(command, VERSIONS)])


if __name__ == "__main__":
    main()
