"""Region tracking at film rate: how many of the vehicles of simulated street traffic it counts at 10 Hz.

    python -m benchmarks.regions_street

SUMO drives the pinned scenes with seeds of their own, 60 s at 0.1 s; places are off by 0.33 m, 10 % are missed, a
detector that measures motion is off by 1 m/s. A vehicle is counted when a track holds nine tenths of its sightings.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

import vtrack_batch as vt
from benchmarks.driving import floating_cars
from benchmarks.noise import COLOURS, Noise, recoloured
from benchmarks.page import ACCURACY, markdown_table, stamp, write_section
from benchmarks.traffic import SCENES

COMMAND = "python -m benchmarks.regions_street"
STEP_S, WARM_S, LENGTH_S = 0.1, 200.0, 60.0
HALF_CAR_M = 2.25
HEADS = ["scene", "seed", "measures motion", "vehicles", "tracks of 1 s", "counted, %", "of one vehicle, %"]


def main() -> None:
    """Simulate, track and count; write the section."""
    rows = [counted(name, seed, motion) for name in ("crossing", "road", "grid") for seed in (5, 9)
            for motion in (False, True)]  # fmt: skip
    text = __doc__.split("\n\n", 2)[2].strip() if __doc__ else ""
    table = markdown_table(HEADS, rows)
    write_section(ACCURACY, "regions", f"## Region tracking at 10 Hz\n\n{text}\n\n{table}\n\n{stamp(COMMAND)}")
    print(table)


def counted(scene: str, seed: int, motion: bool) -> list[str]:
    """Track one minute of a scene and count."""
    seen = sightings(scene, seed, motion)
    tracks = vt.track(seen.drop(columns="truth"), method="regions")
    points = tracks.track_points.dropna(subset=["detection_id"]).merge(seen[["detection_id", "truth"]])
    size = seen.groupby("truth").size()
    lives = size[size * STEP_S >= 1.0]
    most = points.groupby(["truth", "vehicle_id"]).size().groupby("truth").max().reindex(lives.index).fillna(0)
    pure = points.groupby("vehicle_id")["truth"].nunique() == 1
    long = int((tracks.trajectories["points"] * STEP_S >= 1.0).sum())
    share = 100 * float((most >= 0.9 * lives).mean())
    return [scene, str(seed), "yes" if motion else "no", str(len(lives)), str(long), f"{share:.1f}",
            f"{100 * pure.mean():.1f}"]  # fmt: skip


def sightings(scene: str, seed: int, motion: bool) -> pd.DataFrame:
    """Return what a detector would see, ``truth`` beside it."""
    rng = np.random.default_rng(seed)
    rows = driven(scene, seed)
    heading = np.radians(rows["angle"])
    ahead = np.column_stack([np.sin(heading), np.cos(heading)])
    rows[["vx_mps", "vy_mps"]] = rows[["speed"]].to_numpy() * ahead + rng.normal(0, 1, ahead.shape)
    rows[["x_m", "y_m"]] += rng.normal(0, 0.33, ahead.shape) - HALF_CAR_M * ahead
    code = rows["truth"].factorize()[0]
    paint = rng.uniform(20, 235, (code.max() + 1, 3))
    rows[COLOURS] = recoloured(paint[code], Noise(), rng)
    rows["t_utc"] = pd.Timestamp("2026-05-17T08:00:00Z") + pd.to_timedelta(rows["t_s"].round(3), unit="s")
    rows["detection_id"] = rng.permutation(len(rows))
    seen = rows[rng.random(len(rows)) >= 0.1]
    return seen.drop(columns=["t_s", "angle", "speed", *([] if motion else ["vx_mps", "vy_mps"])])


def driven(scene: str, seed: int) -> pd.DataFrame:
    """Return ``t_s, truth, x_m, y_m, angle, speed``: front bumper, compass angle and speed at every step."""
    place = SCENES / scene
    more = ("--device.fcd.begin", WARM_S)
    with tempfile.TemporaryDirectory() as folder:
        given = {"step_s": STEP_S, "until_s": WARM_S + LENGTH_S, "seed": seed, "more": more}
        rows = floating_cars(place / "net.xml", place / "routes.rou.xml", Path(folder), **given)
    rows = rows.rename(columns={"vehicle": "truth"}).drop(columns="type")
    return rows[rows["t_s"] >= WARM_S].assign(t_s=lambda r: r["t_s"] - WARM_S).reset_index(drop=True)


if __name__ == "__main__":
    main()
