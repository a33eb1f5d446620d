"""Traffic to train the matcher on: many layouts, made by Eclipse SUMO from seeds.

Roads (one-way and two-way, straight and bent, with and without a slow exit), junctions (three to five arms, signals,
priority, roundabouts), grids, spiders and random towns; every seed draws sizes, lanes, speed limits, signals and demand
anew. None is a layout of the pinned traffic that matching is scored on.
"""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.driving import floating_cars, run

STEP_S = 0.25
WARM_UP_S = 150.0
KINDS = ("road", "jam", "two_way", "junction", "junction", "roundabout", "grid", "grid", "spider", "town")
PAINTS = {
    (235, 235, 232): 30, (25, 25, 27): 20, (120, 120, 122): 17, (185, 187, 190): 10, (45, 70, 135): 9,
    (160, 35, 38): 7, (100, 75, 55): 3, (55, 95, 60): 2, (215, 185, 50): 2,
}  # fmt: skip


def world(kind: str, seed: int, *, seconds: float = 600.0) -> pd.DataFrame:
    """Return who is where: t_s, vehicle, x_m, y_m (centres) and paint, every 0.25 s, inside an oblong view."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    with tempfile.TemporaryDirectory() as folder:
        made = {"road": _road, "jam": _road, "two_way": _road, "junction": _junction, "roundabout": _roundabout}
        rate_vph = made.get(kind, _town)(Path(folder), kind, rng)
        _demand(Path(folder), rate_vph, WARM_UP_S + seconds, rng)
        rows = _simulated(Path(folder), WARM_UP_S + seconds, int(rng.integers(1, 2**30)))
    rows = _cropped(rows[rows["t_s"] >= WARM_UP_S], kind, rng)
    return rows.merge(_fleet(rows["vehicle"].unique(), rng), on="vehicle")


def _fleet(vehicles: np.ndarray, rng: np.random.Generator) -> pd.DataFrame:
    share = np.array(list(PAINTS.values()), float) * rng.uniform(0.5, 1.5, len(PAINTS))
    paint = np.array(list(PAINTS), float)[rng.choice(len(PAINTS), len(vehicles), p=share / share.sum())]
    paint += rng.normal(0, 14, (len(vehicles), 1)) + rng.normal(0, 6, (len(vehicles), 3))
    return pd.DataFrame({"vehicle": vehicles} | dict(zip(("red", "green", "blue"), paint.T, strict=True)))


def _cropped(rows: pd.DataFrame, kind: str, rng: np.random.Generator) -> pd.DataFrame:
    """Turn the world by any angle and keep an oblong view of it, so that vehicles enter and leave at a border."""
    xy = rows[["x_m", "y_m"]].to_numpy()
    angle = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    xy = (xy - np.median(xy, axis=0)) @ np.array([[c, s], [-s, c]])
    low, high = np.percentile(xy, [0.5, 99.5], axis=0)
    wide = {"road": 0.8, "jam": 0.8, "two_way": 0.8}.get(kind, rng.uniform(0.6, 0.95))
    middle, half = (low + high) / 2, wide * (high - low) / 2 + 5
    keep = (np.abs(xy - middle) <= half).all(axis=1)
    rows = rows.assign(x_m=xy[:, 0] + 1000, y_m=xy[:, 1] + 2000)[keep]
    return rows.assign(vehicle=pd.factorize(rows["vehicle"])[0])


def _road(folder: Path, kind: str, rng: np.random.Generator) -> float:
    """A bent road of a few pieces; *jam* has a slow last piece, *two_way* traffic both ways."""
    pieces = int(rng.integers(3, 6))
    length_m, limit = rng.uniform(140, 300), rng.uniform(9, 30)
    lanes = int(rng.integers(1, 4)) if kind != "jam" else int(rng.integers(1, 3)) + 1
    heading = np.cumsum(rng.normal(0, 0.15, pieces))
    xy = np.vstack([[0, 0], np.cumsum(length_m * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)])
    nodes = [(f"n{k}", *point, "priority") for k, point in enumerate(xy)]
    exit_mps = rng.uniform(3, 8) if kind == "jam" else limit
    edges = []
    for k in range(pieces):
        speed = exit_mps if k == pieces - 1 else limit * rng.uniform(0.9, 1.1)
        edges.append((f"f{k}", f"n{k}", f"n{k + 1}", lanes, speed))
        if kind == "two_way":
            edges.append((f"b{k}", f"n{k + 1}", f"n{k}", lanes, limit * rng.uniform(0.9, 1.1)))
    _converted(folder, nodes, edges)
    return float(rng.uniform(900, 2300) * lanes * (2 if kind == "two_way" else 1))


def _junction(folder: Path, kind: str, rng: np.random.Generator) -> float:
    """Arms that meet at one junction, at uneven angles; signals or priority."""
    arms = int(rng.choice([3, 4, 4, 5]))
    angle = 2 * np.pi * (np.arange(arms) + rng.uniform(-0.15, 0.15, arms)) / arms
    far = rng.uniform(180, 420, arms)
    control = "traffic_light" if rng.random() < 0.75 else "priority"
    nodes = [("c", 0.0, 0.0, control)]
    nodes += [(f"a{k}", far[k] * np.cos(angle[k]), far[k] * np.sin(angle[k]), "priority") for k in range(arms)]
    edges, lanes_all = [], 0
    for k in range(arms):
        lanes, limit = int(rng.integers(1, 4)), rng.uniform(11, 20)
        lanes_all += lanes
        edges += [(f"i{k}", f"a{k}", "c", lanes, limit), (f"o{k}", "c", f"a{k}", max(1, lanes - 1), limit)]
    _converted(folder, nodes, edges)
    return float(rng.uniform(200, 480) * lanes_all)


def _roundabout(folder: Path, kind: str, rng: np.random.Generator) -> float:
    arms, radius = int(rng.integers(3, 6)), rng.uniform(14, 32)
    angle = 2 * np.pi * (np.arange(arms) + rng.uniform(-0.15, 0.15, arms)) / arms
    far, lanes = rng.uniform(150, 300, arms), int(rng.integers(1, 3))
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    nodes = [(f"r{k}", *(radius * unit[k]), "priority") for k in range(arms)]
    nodes += [(f"a{k}", *(far[k] * unit[k]), "priority") for k in range(arms)]
    edges = [(f"q{k}", f"r{k}", f"r{(k + 1) % arms}", lanes, 8.0) for k in range(arms)]
    for k in range(arms):
        limit = rng.uniform(10, 18)
        edges += [(f"i{k}", f"a{k}", f"r{k}", lanes, limit), (f"o{k}", f"r{k}", f"a{k}", lanes, limit)]
    _converted(folder, nodes, edges, roundabout=True)
    return float(rng.uniform(180, 380) * arms)


def _town(folder: Path, kind: str, rng: np.random.Generator) -> float:
    """A grid, a spider or a random town by netgenerate, with signals at some of the junctions."""
    seed = ["--seed", str(int(rng.integers(1, 10000)))]
    if kind == "grid":
        x, y = rng.integers(2, 5, 2)
        shape = ["--grid", "--grid.x-number", x, "--grid.y-number", y, "--grid.attach-length", rng.uniform(60, 140)]
        shape += ["--grid.x-length", rng.uniform(70, 190), "--grid.y-length", rng.uniform(70, 190)]
    elif kind == "spider":
        shape = ["--spider", "--spider.arm-number", rng.integers(4, 7), "--spider.circle-number", rng.integers(2, 4)]
        shape += ["--spider.space-radius", rng.uniform(70, 130), "--spider.attach-length", rng.uniform(60, 120)]
    else:
        shape = ["--rand", "--rand.iterations", rng.integers(18, 40), "--rand.min-distance", 60]
        shape += ["--rand.max-distance", rng.uniform(120, 200)]
    more = ["--default.lanenumber", rng.integers(1, 4), "--default.speed", rng.uniform(11, 18)]
    more += ["-j", "traffic_light" if rng.random() < 0.7 else "priority", "--tls.cycle.time", rng.integers(50, 100)]
    run("netgenerate", *shape, *more, *seed, "--output-file", folder / "net.xml")
    return float(rng.uniform(2200, 4800))


def _converted(
    folder: Path, nodes: list[tuple[str, float, float, str]], edges: list[tuple[str, str, str, int, float]],
    *, roundabout: bool = False,
) -> None:  # fmt: skip
    lines = [f'<node id="{n}" x="{x:.2f}" y="{y:.2f}" type="{kind}"/>' for n, x, y, kind in nodes]
    (folder / "nod.xml").write_text(f"<nodes>{''.join(lines)}</nodes>")
    lines = [
        f'<edge id="{e}" from="{a}" to="{b}" numLanes="{lanes}" speed="{speed:.2f}"/>'
        for e, a, b, lanes, speed in edges
    ]
    (folder / "edg.xml").write_text(f"<edges>{''.join(lines)}</edges>")
    more = ["--roundabouts.guess", "true"] if roundabout else []
    files = ["--node-files", folder / "nod.xml", "--edge-files", folder / "edg.xml", "--no-turnarounds", "true"]
    run("netconvert", *files, *more, "--output-file", folder / "net.xml")


def _demand(folder: Path, rate_vph: float, until_s: float, rng: np.random.Generator) -> None:
    """Trips from edges that begin at the border to edges that end there, some much busier than others."""
    entries, exits = _border(folder / "net.xml")
    count = int(rng.poisson(rate_vph * until_s / 3600))
    busy = rng.gamma(2.0, size=len(entries))
    start = rng.choice(len(entries), count, p=busy / busy.sum())
    end = rng.integers(0, len(exits), count)
    depart = np.sort(rng.uniform(0, until_s, count))
    trips = [
        f'<trip id="{k}" depart="{depart[k]:.2f}" from="{entries[start[k]][0]}" to="{exits[end[k]][0]}" type="mix" '
        'departLane="best" departSpeed="max"/>'
        for k in range(count)
        if entries[start[k]][1] != exits[end[k]][1]  # not back to where it came from
    ]
    spread, slow = rng.uniform(0.08, 0.25), rng.uniform(0.85, 1.05)
    car = f'speedFactor="normc({slow:.2f},{spread:.2f},0.5,1.4)" sigma="{rng.uniform(0.3, 0.7):.2f}"'
    types = (
        f'<vType id="car" probability="0.8" length="4.5" tau="{rng.uniform(0.7, 1.2):.2f}" minGap="2" {car}/>'
        f'<vType id="van" probability="0.1" length="5.9" accel="2.0" {car}/>'
        '<vType id="lorry" probability="0.07" length="9.5" accel="1.2" maxSpeed="23" speedFactor="normc(.8,.1,.5,1)"/>'
        '<vType id="bus" probability="0.03" length="12" accel="1.1" maxSpeed="21" speedFactor="normc(.8,.1,.5,1)"/>'
    )
    text = f'<routes><vTypeDistribution id="mix">{types}</vTypeDistribution>{"".join(trips)}</routes>'
    (folder / "trips.xml").write_text(text)


def _border(net: Path) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Return (edge, border node) of the edges that come from, and go to, nodes at the border."""
    edges = [
        (e.get("id", ""), e.get("from", ""), e.get("to", ""))
        for e in ElementTree.parse(net).getroot().iter("edge")
        if not e.get("function")
    ]
    links: dict[str, set[str]] = {}
    for _, a, b in edges:
        links.setdefault(a, set()).add(b)
        links.setdefault(b, set()).add(a)
    border = {node for node, others in links.items() if len(others) == 1}
    entries, exits = [(e, a) for e, a, _ in edges if a in border], [(e, b) for e, _, b in edges if b in border]
    every_a, every_b = [(e, a) for e, a, _ in edges], [(e, b) for e, _, b in edges]
    return entries or every_a, exits or every_b


def _simulated(folder: Path, until_s: float, seed: int) -> pd.DataFrame:
    more = ("--time-to-teleport", 90, "--ignore-route-errors", "true", "--collision.action", "none")
    given = {"step_s": STEP_S, "until_s": until_s, "seed": seed, "more": more}
    rows = floating_cars(folder / "net.xml", folder / "trips.xml", folder, **given)
    half = rows["type"].str.split("@").str[0].map({"car": 2.25, "van": 2.95, "lorry": 4.75, "bus": 6.0}).to_numpy()
    angle = np.radians(rows["angle"].to_numpy())
    rows["x_m"] -= half * np.sin(angle)
    rows["y_m"] -= half * np.cos(angle)
    return rows[["t_s", "vehicle", "x_m", "y_m"]]
