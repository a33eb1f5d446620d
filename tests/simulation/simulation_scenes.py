"""Scenes for the tests: truth without pictures, on bare ground, and SUMO's own account of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import parse

import pandas as pd

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
