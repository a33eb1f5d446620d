"""The rim to Eclipse SUMO: find it, build networks with it, drive on them; files go below one folder."""

from __future__ import annotations

import gzip
import os
import re
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from xml.etree.ElementTree import ParseError, iterparse

import pandas as pd

from vtrack_batch.errors import ConfigError
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.scenes import Plan, plain_xml

STEP_S = 0.1
LONGEST_SAMPLE_S = 0.5
"""Vehicles are written down at least this often."""
_FCD = ("x", "y", "angle", "type", "speed", "acceleration", "lane", "pos", "odometer", "waiting")
_HEADER = re.compile(rb"<!-- generated on .*?-->\s*", re.DOTALL)


@dataclass(frozen=True)
class Drive:
    """What SUMO said.

    ``samples``: one row per vehicle and sampled moment, by vehicle and time: ``name``, ``step`` (number of the sample,
    0 = first frame), ``x``, ``y`` of the front bumper, ``angle`` (degrees clockwise from y), ``speed``,
    ``acceleration``, ``odometer``, ``waiting``, ``type``. ``period_s`` lies between samples.
    """

    samples: pd.DataFrame
    period_s: float


def home() -> Path:
    """Return SUMO's folder; raises ``ConfigError`` that says how to install it where it is missing."""
    # found, not imported: on import the package bends PROJ_DATA for the whole process, and rasterio then knows no CRS
    found = find_spec("sumo")
    if found is None or found.origin is None:
        raise ConfigError(
            'simulated traffic comes from Eclipse SUMO, which is not installed: pip install "vtrack-batch[sim]"'
        )
    return Path(found.origin).parent


def build_net(made: Plan, folder: Path) -> Path:
    """Write the plan as plain XML below *folder* and build ``net.net.xml`` from it."""
    kinds = {"nod": "node-files", "edg": "edge-files", "con": "connection-files", "tll": "tllogic-files"}
    options = []
    for kind, text in plain_xml(made).items():
        (folder / f"plain.{kind}.xml").write_text(text, encoding="utf-8")
        options += [f"--{kinds[kind]}", f"plain.{kind}.xml"]
    options += ["--offset.disable-normalization", "--no-turnarounds", "--output-file", "net.net.xml"]
    _call("netconvert", options, folder)
    _without_header(folder / "net.net.xml")
    return folder / "net.net.xml"


def drive(scenario: Scenario, folder: Path, *, net: Path, routes: Path, loops: str) -> Drive:
    """Drive the *routes* on the *net* from the warm-up's begin to just after the last frame.

    *loops* is an additional file's text, the loop detectors whose output goes to ``loops.xml`` in *folder*. SUMO's own
    account of every trip, those under way included, stays there as ``trips.csv``.
    """
    period_s = sample_period_s(scenario.interval_s)
    begin_s = round(scenario.warm_up_s / STEP_S) * STEP_S
    end_s = begin_s + (scenario.frame_count - 1) * scenario.interval_s + period_s + 2 * STEP_S
    (folder / "loops.add.xml").write_text(loops, encoding="utf-8")
    options = [
        *(
            "--net-file",
            str(net.resolve()),
            "--route-files",
            str(routes.resolve()),
            "--additional-files",
            "loops.add.xml",
        ),
        *("--begin", "0", "--end", f"{end_s:.3f}", "--step-length", f"{STEP_S}", "--step-method.ballistic"),
        *("--seed", str(scenario.seed), "--lanechange.duration", f"{scenario.traffic.lane_change_s}"),
        *("--time-to-teleport", "-1", "--weights.random-factor", "1.5", "--collision.action", "none"),
        *("--fcd-output", "fcd.csv", "--fcd-output.attributes", ",".join(_FCD), "--fcd-output.skip-empty"),
        *("--device.fcd.begin", f"{begin_s:.3f}", "--device.fcd.period", f"{period_s:.3f}"),
        *("--tripinfo-output", "trips.csv", "--tripinfo-output.write-unfinished", "--precision", "4"),
        *("--no-step-log", "--no-warnings", "--duration-log.disable", "--xml-validation", "never"),
    ]
    _call("sumo", options, folder)
    _without_header(folder / "loops.xml")
    samples = _samples(folder / "fcd.csv", begin_s, period_s)
    (folder / "fcd.csv").unlink(missing_ok=True)
    return Drive(samples, period_s)


def vehicle_types(routes: Path) -> dict[str, dict[str, str]]:
    """Return the attributes of all vehicle types that a routes file declares, by id."""
    try:
        with gzip.open(routes) if routes.suffix == ".gz" else routes.open("rb") as stream:
            return {row.get("id", ""): dict(row.attrib) for _, row in iterparse(stream) if row.tag == "vType"}  # noqa: S314
    except (OSError, ParseError) as problem:
        raise ConfigError(f"routes {routes}: cannot be read ({problem})") from None


def sample_period_s(interval_s: float) -> float:
    """Return the longest time of at most half a second that divides the interval and is a multiple of SUMO's step."""
    steps = interval_s / STEP_S
    if abs(steps - round(steps)) > 1e-9 or steps < 1:
        return STEP_S
    most = round(LONGEST_SAMPLE_S / STEP_S)
    return STEP_S * max(k for k in range(1, most + 1) if round(steps) % k == 0)


def _call(program: str, options: Sequence[str], folder: Path) -> None:
    root = home()
    environment = {**os.environ, "SUMO_HOME": str(root)}
    done = subprocess.run(  # noqa: S603 (a program of a package, options without a shell)
        [str(root / "bin" / program), *options],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if line.startswith("Error")] or done.stderr.splitlines()
        raise ConfigError(f"{program}: " + " ".join(line.removeprefix("Error: ") for line in said[:3]))


def _without_header(path: Path) -> None:
    """Take out the comment that dates a file, so that the same scenario gives the same bytes."""
    if path.is_file():
        path.write_bytes(_HEADER.sub(b"", path.read_bytes(), count=1))


def _samples(path: Path, begin_s: float, period_s: float) -> pd.DataFrame:
    names = {f"vehicle_{name}": name for name in _FCD}
    rows = _table(path, ["timestep_time", "vehicle_id", *names])
    rows = rows.rename(columns=names | {"vehicle_id": "name", "timestep_time": "time"}).dropna(subset=["name"])
    step = ((rows["time"].astype(float) - begin_s) / period_s).round().astype("int64")
    return rows.assign(step=step).sort_values(["name", "step"], ignore_index=True)


def _table(path: Path, columns: list[str]) -> pd.DataFrame:
    """Return *columns* of a table that SUMO wrote; it has not even names where there are no rows."""
    texts = [name for name in columns if name.endswith(("_id", "_type", "_lane"))]
    try:
        return pd.read_csv(path, sep=";", usecols=columns, dtype=dict.fromkeys(texts, str))
    except (FileNotFoundError, pd.errors.EmptyDataError):
        return pd.DataFrame(columns=columns)
