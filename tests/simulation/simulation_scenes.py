"""Scenes for the tests: truth without pictures, on bare ground, and SUMO's own account of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import parse

import numpy as np
import pandas as pd
from scipy.interpolate import CubicHermiteSpline

from vtrack_batch.simulation.params import Scenario

BARE = {"parked": 0, "buildings_per_ha": 0, "trees_per_ha": 0, "street_trees_per_km": 0, "pedestrians_per_km": 0}


def scenario(**changes: Any) -> Scenario:
    """A scenario of truth alone; sections are given as dicts of what differs."""
    return Scenario.model_validate({"frames": False, "ground": BARE, "seed": 6} | changes)


def table(out: Path, name: str) -> pd.DataFrame:
    return pd.read_parquet(out / "truth" / f"{name}.parquet")


def sumo_trips(out: Path) -> pd.DataFrame:
    """SUMO's trips with the gates over which their first and last lane lead, and our id of the vehicle."""
    rows = pd.read_csv(out / "sumo" / "trips.csv", sep=";")
    rows.columns = [name.removeprefix("tripinfo_") for name in rows.columns]
    loops = parse(out / "sumo" / "loops.add.xml").getroot()
    # of two gates over one lane, vehicles depart before the first and arrive beyond the last
    along = sorted(loops, key=lambda loop: float(loop.get("pos", "0")))
    last = {loop.get("lane"): str(loop.get("id")).split("@")[0] for loop in along}
    first = {loop.get("lane"): str(loop.get("id")).split("@")[0] for loop in reversed(along)}
    known = table(out, "vehicles").set_index("sumo_id")["vehicle_id"]
    return rows.assign(
        origin=rows["departLane"].map(first),
        destination=rows["arrivalLane"].map(last),
        vehicle_id=rows["id"].map(known),
    )


def sumo_loops(out: Path) -> pd.DataFrame:
    """SUMO's induction loops: gate, direction (by edge), begin and end of the bin, vehicles, their mean speed."""
    rows = [dict(interval.attrib) for interval in parse(out / "sumo" / "loops.xml").getroot()]
    found = pd.DataFrame(rows)
    place = found["id"].str.split("@", expand=True)
    numbers = found[["begin", "end", "nVehContrib", "nVehEntered", "speed"]].astype(float)
    return numbers.assign(gate=place[0], lane=place[1])


def mean_speeds_over_gates(out: Path) -> pd.DataFrame:
    """The truth's crossings with ``t_s`` since the first frame and ``over_line_mps``, as a loop below would have it.

    That is the length over the time between front and rear on the line; NaN where the vehicle is not in view so long.
    """
    start = table(out, "frames")["t_utc"].min()
    crossings, points = (
        rows.assign(t_s=(rows["t_utc"] - start).dt.total_seconds())
        for rows in (table(out, "crossings"), table(out, "track_points"))
    )
    length_m = table(out, "trajectories").set_index("vehicle_id")["length_m"]
    of_vehicle = points.groupby("vehicle_id").indices
    found = []
    for vehicle, t_s in zip(crossings["vehicle_id"], crossings["t_s"], strict=True):
        seen = points.iloc[of_vehicle[vehicle]]
        known_s, step_m = seen["t_s"].to_numpy(), np.hypot(*np.diff(seen[["x_m", "y_m"]].to_numpy(), axis=0).T)
        fine_s, half_m = np.arange(known_s[0], known_s[-1], 0.005), length_m[vehicle] / 2
        if len(known_s) < 2:
            found.append(np.nan)
            continue
        way = CubicHermiteSpline(known_s, np.r_[0, np.cumsum(step_m)], seen["speed_mps"].to_numpy())
        way_m = np.maximum.accumulate(way(fine_s))
        front_m, rear_m = way(t_s) - half_m, way(t_s) + half_m
        in_view = way_m[0] <= front_m and rear_m <= way_m[-1]
        took_s = np.diff(np.interp([front_m, rear_m], way_m, fine_s))[0]
        found.append(2 * half_m / took_s if in_view else np.nan)
    return crossings.assign(over_line_mps=found)
