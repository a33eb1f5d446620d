"""Drive vehicles through a network with Eclipse SUMO, and read where their front bumpers were at every step."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pandas as pd
import sumo

BIN = Path(sumo.SUMO_HOME) / "bin"


def floating_cars(
    net: Path, routes: Path, folder: Path, *, step_s: float, until_s: float, seed: int, more: tuple[object, ...] = ()
) -> pd.DataFrame:
    """Return ``t_s, vehicle, type, x_m, y_m, angle, speed``: front bumpers, compass angles, m/s, at every step."""
    out = folder / "fcd.csv"
    run(
        "sumo", "--net-file", net, "--route-files", routes, "--seed", seed, "--begin", 0, "--end", until_s,
        "--step-length", step_s, "--lanechange.duration", 3, "--fcd-output", out,
        "--fcd-output.attributes", "x,y,angle,speed,type", *more,
    )  # fmt: skip
    rows = pd.read_csv(out, sep=";").rename(columns=lambda c: c.removeprefix("timestep_").removeprefix("vehicle_"))
    rows = rows.dropna(subset=["id"]).rename(columns={"time": "t_s", "id": "vehicle", "x": "x_m", "y": "y_m"})
    return rows[["t_s", "vehicle", "type", "x_m", "y_m", "angle", "speed"]].reset_index(drop=True)


def run(name: str, *args: object) -> None:
    """Run one of SUMO's programs; raises ``RuntimeError`` with what it said where it failed."""
    command = [str(BIN / name), *(str(a) for a in args), "--no-warnings", "true"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}\n{done.stderr}")
