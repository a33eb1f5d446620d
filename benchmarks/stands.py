"""Vehicles that stand: do they keep id and size? ``python -m benchmarks.stands`` (QUICK=1: one archive).

Crossings of ten minutes with seeds of their own are run with and without the section ``revision``. A stand is kept when
one track holds nine tenths of the frames from three before it to three after it; its area is steady when nine tenths of
its boxes are within 15 % of the median of the same track's boxes outside the stand.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial import KDTree

import vtrack_batch as vt
from benchmarks.crossings import crossings
from benchmarks.jobs import called
from benchmarks.page import ACCURACY, markdown_table, stamp, write_section
from vtrack_batch.revision.params import RevisionParams

FIRST_SEED = 9601
LEAST_S, STILL_MPS, NEAR_M, AROUND = 30.0, 0.3, 2.0, 3
MOST_OF, STEADY = 0.9, 0.15
COMMAND = "python -m benchmarks.stands"


def main() -> None:
    """Make the archives, run them both ways, write the section."""
    rows = []
    for seed, folder in crossings(FIRST_SEED):
        for revised in (False, True):
            rows.append(judged(folder, revised=revised).assign(seed=seed, revised=revised))
    write_section(ACCURACY, "stands", page(pd.concat(rows), called(COMMAND)))


def judged(folder: Path, *, revised: bool) -> pd.DataFrame:
    """Run the archive and return for each stand of 30 s or more: ``lasts_s``, ``kept``, ``steady``."""
    survey = vt.load_survey(folder / "survey.yaml")
    survey = survey.model_copy(update={"revision": RevisionParams(revise=revised)}).based_at(folder)
    vt.run_survey(survey, workers=1)
    tables = vt.open_results(folder / "results")
    points, boxes = tables["track_points"], tables["detections"]
    boxes = boxes.assign(area=boxes["length_m"] * boxes["width_m"])[["detection_id", "area"]]
    points = points.merge(boxes, on="detection_id", how="left").assign(vehicle_id=points["vehicle_id"].astype(str))
    truth = pd.read_parquet(folder / "truth" / "detections.parquet").sort_values(["vehicle_id", "t_utc"])
    truth = truth.assign(track=nearest_tracks(truth, points))
    return pd.DataFrame([judge(own, stand, points) for own, stand in stands(truth)])


def nearest_tracks(truth: pd.DataFrame, points: pd.DataFrame) -> np.ndarray:
    """Return for each true sighting the id of the track whose point is nearest then, empty where none is near."""
    found = np.full(len(truth), "", object)
    of_time = dict(list(points.groupby("t_utc")))
    for t_utc, rows in truth.reset_index(drop=True).groupby("t_utc"):
        if t_utc in of_time:
            there = of_time[t_utc]
            away, at = KDTree(there[["x_m", "y_m"]]).query(rows[["x_m", "y_m"]])
            found[rows.index] = np.where(away < NEAR_M, there["vehicle_id"].to_numpy(object)[at], "")
    return found


def stands(truth: pd.DataFrame) -> list[tuple[pd.DataFrame, np.ndarray]]:
    """Return the rows of a vehicle and the numbers of those in which it stands, for each stand that is long enough."""
    found = []
    for _, own in truth.groupby("vehicle_id"):
        still = np.hypot(own["vx_mps"].to_numpy(), own["vy_mps"].to_numpy()) < STILL_MPS
        run = np.cumsum(np.r_[True, still[1:] != still[:-1]])
        for number in np.unique(run[still]):
            rows = np.flatnonzero(run == number)
            if (own["t_utc"].iloc[rows[-1]] - own["t_utc"].iloc[rows[0]]).total_seconds() >= LEAST_S:
                found.append((own, rows))
    return found


def judge(own: pd.DataFrame, stand: np.ndarray, points: pd.DataFrame) -> dict[str, object]:
    """Return whether one track holds the stand, and whether the track's boxes keep their area meanwhile."""
    begin, end = own["t_utc"].iloc[stand[0]], own["t_utc"].iloc[stand[-1]]
    around = own["track"].iloc[max(0, stand[0] - AROUND) : stand[-1] + AROUND + 1]
    named = around[around != ""].value_counts()
    kept = steady = False
    if len(named):
        kept = bool(named.iloc[0] >= MOST_OF * len(around))
        track = points[(points["vehicle_id"] == named.index[0]) & points["area"].notna()]
        inside = track["t_utc"].between(begin, end)
        usual = track["area"][~inside if (~inside).sum() >= AROUND else slice(None)].median()
        steady = bool(inside.any() and ((track["area"][inside] / usual - 1).abs() <= STEADY).mean() >= MOST_OF)
    return {"lasts_s": (end - begin).total_seconds(), "kept": kept, "steady": steady, "both": kept and steady}


def page(rows: pd.DataFrame, command: str) -> str:
    """Return the section."""
    table = []
    for revised, of in rows.groupby("revised"):
        for least in (LEAST_S, 45.0):
            long = of[of["lasts_s"] >= least]
            by_seed = 100 * long.groupby("seed")[["kept", "steady", "both"]].mean()
            cells = [f"{100 * long[c].mean():.1f} ({by_seed[c].min():.0f}–{by_seed[c].max():.0f})" for c in by_seed]
            table.append([f"{least:.0f} s, {'with' if revised else 'without'} revision", str(len(long)), *cells])
    heads = ["stands of at least", "stands", "id kept, %", "area within 15 %, %", "both, %"]
    text = (
        f"{rows['seed'].nunique()} rendered crossings, ten minutes each, seeds from {FIRST_SEED}; in brackets the "
        "worst and the best archive. The must is 90 % for both."
    )
    return f"## Vehicles that stand\n\n{text}\n\n{markdown_table(heads, table)}\n\n{stamp(command)}"


if __name__ == "__main__":
    main()
