"""Labelled traffic of other seeds: the scenes beside the project driven anew, seen with noise and misses.

Peers are tuned on it and the paper's tables are drawn from it; what is scored in the other benches is the pinned data.
"""

from __future__ import annotations

import hashlib
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.noise import COLOURS, Noise, seen
from benchmarks.page import PROJECT, SHARED
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.write import simulate

SCENES = SHARED / "sumo" / "scenes"
BUILT = PROJECT / "build" / "traffic"
BUILT_IN = {  # the paper's road, not the one beside the project: a fleet as found, and cars alone that wish one speed
    "varied road": {},
    "uniform road": {"van_share": 0, "lorry_share": 0, "bus_share": 0, "speed_spread": 0.03},
}
WARM_UP_S = {"road": 150, "congested": 300, "crossing": 300, "grid": 300}
MIDDLE_M = {"road": (316.8, 107.25), "congested": (316.8, 107.25), "crossing": (0.0, 0.0), "grid": (450.0, 450.0)}
VIEW_PX = {"road": (1920, 650), "congested": (1920, 650), "crossing": (1697, 1697), "grid": (2273, 2273)}  # of 0.33 m
STEP_S, PIXEL_M = 0.5, 0.33
PAIRS_EVERY_S = 20
PAPER_PX = (1920, 650)


@cache
def driven(scene: str, seed: int, seconds: int) -> pd.DataFrame:
    """Return ``t_s, vehicle, x_m, y_m, red, green, blue`` of all in view, every half second; kept in build/traffic.

    Scenes are those beside the project, driven by ``vtrack_batch.simulation``; without them, the built-in ones.
    """
    scenario = scenario_of(scene, seed, seconds)
    kept = BUILT / f"{scene}-{seed}-{hashlib.sha256(scenario.model_dump_json().encode()).hexdigest()[:12]}.parquet"
    if not kept.exists():
        BUILT.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=BUILT) as folder:
            simulate(scenario, Path(folder) / "out")
            _truth(Path(folder) / "out", scene).to_parquet(Path(folder) / "truth.parquet")
            (Path(folder) / "truth.parquet").replace(kept)
    return pd.read_parquet(kept)


def scenario_of(scene: str, seed: int, seconds: int) -> Scenario:
    """Return the scenario of a scene: bare ground, a camera that stands still, no frames."""
    place = SCENES / scene
    own = {"network": str(place / "net.xml"), "routes": str(place / "routes.rou.xml"), "centre_m": MIDDLE_M.get(scene)}
    width_px, height_px = VIEW_PX.get(scene, PAPER_PX)
    still = {"azimuth_deg": 0, "drift_px": 0, "jitter_px": 0, "rotation_deg": 0, "perspective_per_px": 0, "travel_m": 0}
    bare = {"parked": 0, "buildings_per_ha": 0, "trees_per_ha": 0, "street_trees_per_km": 0, "pedestrians_per_km": 0}
    return Scenario.model_validate(
        {
            **({"scene": "road", "traffic": BUILT_IN[scene]} if scene in BUILT_IN else {"scene": scene}),
            **(own if place.is_dir() else {}),
            "seed": seed,
            "duration_s": seconds,
            "warm_up_s": WARM_UP_S.get(scene, 150),
            "interval_s": STEP_S,
            "frames": False,
            "camera": {"width_px": width_px, "height_px": height_px, "gsd_m": PIXEL_M, **still},
            "ground": bare,
        }
    )


def labelled_pairs(
    scene: str, seeds: range, elapsed_s: float, missed: float, *, each: int, noise: Noise | None = None
) -> pd.DataFrame:
    """Return *each* pairs of images from every seed, 20 s apart, in the columns of the pinned pairs."""
    noise = replace(noise or Noise(), missed=missed)
    found = []
    for seed in seeds:
        truth = driven(scene, seed, PAIRS_EVERY_S * each + 10)
        for number in range(each):
            for image, t_s in enumerate((PAIRS_EVERY_S * number, PAIRS_EVERY_S * number + elapsed_s), 1):
                rows = seen(truth[np.isclose(truth["t_s"], t_s)], noise, np.random.default_rng((seed, number, image)))
                found.append(rows.assign(pair=seed * 1000 + number, image=image, detection_id=np.arange(len(rows))))
    pairs = pd.concat(found, ignore_index=True).rename(columns={"vehicle": "truth_vehicle"})
    return pairs.assign(scene=scene, elapsed_s=elapsed_s, missed=missed).drop(columns="t_s")


def labelled_sequence(
    scene: str, seed: int, interval_s: float, missed: float, *, driven_s: int, seconds: float
) -> pd.DataFrame:
    """Return the first *seconds* of a drive of *driven_s* as a sequence in the columns of the pinned ones."""
    truth = driven(scene, seed, driven_s)
    steps = truth["t_s"] / interval_s
    rows = seen(
        truth[np.isclose(steps, steps.round()) & (truth["t_s"] < seconds)],
        Noise(missed=missed),
        np.random.default_rng(seed),
    )
    rows = rows.rename(columns={"vehicle": "truth_vehicle"})
    return rows.assign(seed=seed, interval_s=interval_s, missed=missed, detection_id=np.arange(len(rows)))


def _truth(out: Path, scene: str) -> pd.DataFrame:
    rows = pd.read_parquet(out / "truth" / "detections.parquet")
    first = rows["t_utc"].min().floor("1s")
    # the simulation's own origin is the first pixel of the view; here it is the network's, as in the pinned data
    (x_m, y_m), (width_px, height_px) = MIDDLE_M.get(scene, (0.0, 0.0)), VIEW_PX.get(scene, PAPER_PX)
    return (
        rows.assign(
            t_s=(rows["t_utc"] - first).dt.total_seconds().round(1),
            vehicle=pd.factorize(rows["vehicle_id"], sort=True)[0],
            x_m=rows["x_m"] + x_m - PIXEL_M * (width_px - 1) / 2,
            y_m=rows["y_m"] + y_m + PIXEL_M * (height_px - 1) / 2,
        )
        .sort_values(["t_s", "vehicle"], ignore_index=True)
        .loc[:, ["t_s", "vehicle", "x_m", "y_m", *COLOURS]]
    )
