"""The paper's Tables 1, 2, 3 and its sweep of A, B, C, beside the paper's own figures: ``make bench-paper [QUICK=1]``.

Writes the sections ``table-1``, ``table-2``, ``table-3`` and ``sweep`` of docs/paper.md, and docs/figures/paper.svg.
Source of the figures quoted: T. Fuse and E. Shimizu, "A New Technique for Vehicle Tracking on the Assumption of
Stratospheric Platforms".
"""

from __future__ import annotations

import sys
from itertools import product

import cv2
import numpy as np
import pandas as pd

import vtrack_batch as vt
from benchmarks.figures import paper_intervals
from benchmarks.jobs import parallel, quick
from benchmarks.page import FIGURES, PAPER, markdown_table, stamp, write_section
from benchmarks.traffic import BUILT_IN, COLOURS, SHARED, labelled_pairs
from benchmarks.work import (
    INTERVALS_S,
    available,
    label_rates,
    mean_and_half_width,
    pairs_as_sightings,
    pinned_pairs,
)
from vtrack_batch.matching.candidates import candidates
from vtrack_batch.matching.colour import colour_labels
from vtrack_batch.matching.decision import mutual
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.matching.relaxation import relax

METHODS = {"original": "(a) original", "colour": "(b) colour", "opposite": "(c) opposite", "proposed": "(d) proposed"}
ONE_WAY = ("original", "colour")
# one-way methods leave the labels of image 2 as they began, so that mutual choice would mean nothing
WAYS = [(method, "argmax") for method in METHODS] + [(method, "mutual") for method in METHODS if method not in ONE_WAY]
MISSED = (0.0, 0.1)
PINNED = "pinned road"
KINDS = (*BUILT_IN, *((PINNED,) if available() else ()))
TABLE_1 = {"original": (82.7, 80.1), "colour": (88.5, 91.5), "opposite": (98.1, 97.8), "proposed": (100.0, 100.0)}
TABLE_2 = {"original": (78.7, 75.6), "colour": (80.9, 75.6), "opposite": (83.2, 78.9), "proposed": (95.8, 96.7)}
TABLE_3 = {0.5: 100.0, 1.5: 97.9, 2.5: 78.9, 4.0: 70.5}
KIT_GSD_M = 0.12
EACH, SEEDS = 10, range(301, 312)
PIXEL_M, D_PX, T_PX, PAPER_S = 0.33, 150, 20, 1.5
# logarithmic where the optimum is flat, and with the paper's own values
SWEEP_A, SWEEP_BC = (0.0, 0.1, 0.3, 0.5, 1.0), (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 10.0)
COMMAND = "make bench-paper"


def main() -> None:
    """Measure everything, print the tables, write the sections."""
    few = quick()
    seeds = SEEDS[:1] if few else SEEDS
    kinds = list(product(KINDS, INTERVALS_S, MISSED))
    jobs = [(simulated_on, (*kind, seeds)) for kind in kinds]
    jobs += [(sweep_on, ("varied road", missed, seeds[:2])) for missed in MISSED]
    jobs += [(real_on, (place, missed)) for place in ("KIT", "Songdo") for missed in MISSED]
    answers = parallel(jobs)
    simulated = pd.concat(answers[: len(kinds)], ignore_index=True)
    real = pd.concat(answers[len(kinds) + len(MISSED) :], ignore_index=True)
    line = stamp(COMMAND + (" QUICK=1" if few else ""))
    paper_intervals(simulated[simulated["scaled"]], TABLE_3, FIGURES / "paper.svg")
    sections = {
        "table-1": table_1(simulated),
        "table-2": table_2(real),
        "table-3": table_3(simulated),
        "sweep": sweep_table(*answers[len(kinds) : len(kinds) + len(MISSED)]),
    }
    for name, text in sections.items():
        write_section(PAPER, name, f"{text}\n\n{line}")
        print(text, file=sys.stdout)


def simulated_on(kind: str, elapsed_s: float, missed: float, seeds: range) -> pd.DataFrame:
    """Return rates of (a)-(d) on pairs of simulated traffic, by argmax and by mutual choice; D, T scaled and fixed."""
    if kind == PINNED:
        rows = pinned_pairs("road", elapsed_s, missed, EACH * len(seeds))
    else:
        rows = pairs_as_sightings(labelled_pairs(kind, seeds, elapsed_s, missed, each=EACH))
    found = [rates(rows, method, rule) for method, rule in WAYS]
    found = [table.assign(scaled=True) for table in found]
    if elapsed_s != PAPER_S:
        found.append(rates(rows, "proposed", "mutual", fixed=True).assign(scaled=False))
    return pd.concat(found).assign(kind=kind, elapsed_s=elapsed_s, missed=missed)


def rates(rows: pd.DataFrame, method: str, rule: str, *, fixed: bool = False) -> pd.DataFrame:
    """Return label rates of one method, pair by pair; *fixed* = D and T in pixels whatever the interval."""
    found = []
    columns = ["detection_id", "x_m", "y_m", *(COLOURS if "red" in rows else [])]
    for name, pair in rows.groupby("sequence"):
        images = [of.assign(detection_id=np.arange(len(of))) for _, of in pair.groupby("frame")]
        elapsed_s = float(pair["interval_s"].iloc[0])
        params = MatchingParams.model_validate({"decision": rule, **(_fixed(elapsed_s) if fixed else {})})
        links = vt.match(*(i[columns] for i in images), elapsed_s=elapsed_s, method=method, params=params)
        links = links.dropna(subset=["detection_id_from", "detection_id_to"])
        i, k = (links[f"detection_id_{end}"].astype(int).to_numpy() for end in ("from", "to"))
        one, two, both = label_rates(*(image["truth"].to_numpy() for image in images), i, k)
        found.append({"pair": name, "n": len(pair), "image_1": one, "image_2": two, "pooled": both})
    return pd.DataFrame(found).assign(method=method, rule=rule)


def _fixed(elapsed_s: float) -> dict[str, object]:
    speed = PIXEL_M / elapsed_s
    return {"paper": {"max_speed_mps": D_PX * speed, "consistency_mps": T_PX * speed}}


def sweep_on(kind: str, missed: float, seeds: range) -> pd.DataFrame:
    """Return the pooled rate of (d), mutual, at 1.5 s for every setting of A, B, C and every pair."""
    rows = pairs_as_sightings(labelled_pairs(kind, seeds, PAPER_S, missed, each=EACH))
    params = MatchingParams()
    found = []
    for name, pair in rows.groupby("sequence"):
        one, two = (of for _, of in pair.groupby("frame"))
        xy = [of[["x_m", "y_m"]].to_numpy() for of in (one, two)]
        edges = candidates(*xy, params.reach_m(PAPER_S, printed=True))
        start = colour_labels(edges, *(of[COLOURS].to_numpy(float) for of in (one, two)))
        for a, b, c in product(SWEEP_A, SWEEP_BC, SWEEP_BC):
            setting = params.paper.model_copy(update={"a_delay": a, "b_neighbours": b, "c_opposite": c})
            if a + b + c == 0:
                continue
            labels = relax(edges, start, *xy, tolerance=setting.consistency_m(PAPER_S), params=setting)
            picked = mutual(edges, labels)
            rate = label_rates(one["truth"].to_numpy(), two["truth"].to_numpy(), edges.i[picked], edges.k[picked])[2]
            found.append((name, a, b, c, rate))
    return pd.DataFrame(found, columns=["pair", "A", "B", "C", "rate"]).assign(missed=missed)


def real_on(place: str, missed: float) -> pd.DataFrame:
    """Return rates of (a)-(d) on real frames at 1.5 s, by the paper's rule; nothing where the data are not there."""
    if not available():
        return pd.DataFrame(columns=["place", "missed", "method", "rule", "n", "image_1", "pooled"])
    rows = kit_pairs() if place == "KIT" else songdo_pairs()
    kept = np.random.default_rng(8).random(len(rows)) >= missed
    rows = rows[kept].sample(frac=1, random_state=1).sort_values(["sequence", "frame"], kind="stable")
    found = [rates(rows, method, _rule(method)) for method in METHODS]
    return pd.concat(found).assign(place=place, missed=missed)


def kit_pairs() -> pd.DataFrame:
    """Return the vehicles of MunichStreet02, 1.5 s apart: centres of boxes, mean colour of 2 m at the centre."""
    folder = SHARED / "kit-ais" / "MunichStreet02"
    boxes = pd.read_csv(folder / "tracks.csv")
    col_px, row_px = (boxes["left"] + boxes["width"] / 2).to_numpy(), (boxes["top"] + boxes["height"] / 2).to_numpy()
    frames = {n: cv2.imread(str(folder / "frames" / f"{n:03d}.png"))[:, :, ::-1] for n in boxes["frame"].unique()}
    colour = np.empty((len(boxes), 3))
    for row, (n, x, y) in enumerate(zip(boxes["frame"], col_px.astype(int), row_px.astype(int), strict=True)):
        # 8 px = 1 m around the centre lie on the roof, whichever way the vehicle points
        image = frames[n]
        colour[row] = image[max(y - 8, 0) : y + 9, max(x - 8, 0) : x + 9].reshape(-1, 3).mean(axis=0)
    rows = boxes.assign(truth=boxes["id"], time=boxes["frame"], x_m=KIT_GSD_M * col_px, y_m=-KIT_GSD_M * row_px)
    rows[COLOURS] = colour
    return _paired(rows[["truth", "time", "x_m", "y_m", *COLOURS]], step=3, every=1)


def songdo_pairs() -> pd.DataFrame:
    """Return the vehicles of Songdo, 1.5 s apart, a pair every third of a second; no colour."""
    rows = pd.read_csv(SHARED / "songdo" / "tracks.csv", usecols=["Frame_Number", "Local_X", "Local_Y", "Vehicle_ID"])
    rows.columns = ["truth", "time", "x_m", "y_m"]
    return _paired(rows, step=45, every=10)


def _paired(rows: pd.DataFrame, *, step: int, every: int) -> pd.DataFrame:
    """Return pairs of frames *step* apart, one pair every *every* frames."""
    found = []
    for first in range(int(rows["time"].min()), int(rows["time"].max()) - step + 1, every):
        for frame, time in enumerate((first, first + step)):
            found.append(rows[rows["time"] == time].assign(sequence=first, frame=frame))
    return pd.concat(found, ignore_index=True).assign(interval_s=PAPER_S)


def _rule(method: str) -> str:
    return "argmax" if method in ONE_WAY else "mutual"


def _as_paper(rows: pd.DataFrame, method: str) -> pd.Series:
    """Return rates in % as the paper counts them: one-way methods over image 1, two-way methods over both."""
    of = rows[(rows["method"] == method) & (rows["rule"] == _rule(method))]
    return 100 * of["image_1" if method in ONE_WAY else "pooled"]


def table_1(simulated: pd.DataFrame) -> str:
    """Return Table 1: simulated road, 1.5 s."""
    at = simulated[(simulated["elapsed_s"] == PAPER_S) & simulated["scaled"]]
    pairs = at[at["missed"] == 0].groupby("kind")["pair"].nunique()
    rows = []
    for kind, method in product(KINDS, METHODS):
        cells = []
        for number, missed in enumerate(MISSED):
            of = at[(at["kind"] == kind) & (at["missed"] == missed)]
            found, paper = _as_paper(of, method), TABLE_1[method][number]
            reached = 100 * (found >= paper - 0.05).mean()
            cells += [f"{paper}", text(found), f"{found.std():.1f}", f"{reached:.0f} %"]
        rows.append([f"{kind}: {METHODS[method]}", *cells])
    heads = [f"{what}, {m}" for m in ("without", "with") for what in ("paper", "here", "SD of pairs", "pairs ≥ paper")]
    vehicles = at.groupby("kind")["n"].mean() / 2
    counted = ", ".join(f"{kind}: {pairs[kind]} pairs, {vehicles[kind]:.0f} vehicles an image" for kind in KINDS)
    return f"{markdown_table(['traffic: method', *heads], rows)}\n\n{counted}.\n\n{_all_rates(at)}"


def _all_rates(at: pd.DataFrame) -> str:
    """Return the same rates by every rule and every way to count."""
    rows = []
    for kind, (method, rule) in product(KINDS, WAYS):
        of = at[(at["kind"] == kind) & (at["method"] == method) & (at["rule"] == rule)]
        cells = [text(100 * of[of["missed"] == m][c]) for m in MISSED for c in ("image_1", "image_2", "pooled")]
        rows.append([f"{kind}: {METHODS[method]}, {rule}", *cells])
    heads = [f"{c}, {m}" for m in ("without", "with") for c in ("image 1", "image 2", "both")]
    return markdown_table(["every way to decide and to count", *heads], rows)


def table_2(real: pd.DataFrame) -> str:
    """Return Table 2: real frames, 1.5 s."""
    rows = []
    for method in METHODS:
        cells = [f"{a} / {b}" for a, b in (TABLE_2[method],)]
        for place in ("KIT", "Songdo"):
            of = [real[(real["place"] == place) & (real["missed"] == m)] for m in MISSED]
            cells.append(" / ".join(text(_as_paper(rows, method)) for rows in of))
        rows.append([METHODS[method], *cells])
    heads = ["method, without / with", "paper: HDTV image, one pair", "KIT MunichStreet02", "Songdo, no colour"]
    counts = real[real["missed"] == 0].groupby("place")[["n", "pair"]].agg({"n": "mean", "pair": "nunique"})
    counted = ", ".join(f"{p}: {int(c.pair)} overlapping pairs, {c.n / 2:.0f} vehicles" for p, c in counts.iterrows())
    return f"{markdown_table(heads, rows)}\n\n{counted}."


def table_3(simulated: pd.DataFrame) -> str:
    """Return Table 3: all methods at all intervals, beside the paper's (d)."""
    rows = [["paper: (d) on one real pair", *(f"{TABLE_3[s]}" for s in INTERVALS_S)]]
    for kind, method in product(KINDS, METHODS):
        rows.append([f"{kind}: {METHODS[method]}", *_by_interval(simulated[simulated["scaled"]], kind, method)])
    fixed = simulated[~simulated["scaled"] | (simulated["elapsed_s"] == PAPER_S)]
    for kind in KINDS:
        rows.append([f"{kind}: (d), D and T fixed in pixels", *_by_interval(fixed, kind, "proposed")])
    table = markdown_table(["without / with 10 % missed", *(f"{s} s" for s in INTERVALS_S)], rows)
    return f"{table}\n\n![(d) by interval](figures/paper.svg)"


def _by_interval(simulated: pd.DataFrame, kind: str, method: str) -> list[str]:
    of = simulated[simulated["kind"] == kind]
    return [
        " / ".join(text(_as_paper(of[(of["elapsed_s"] == s) & (of["missed"] == m)], method)) for m in MISSED)
        for s in INTERVALS_S
    ]


def sweep_table(without: pd.DataFrame, missed: pd.DataFrame) -> str:
    """Return what A, B, C do to (d): printed values, best of one half on the other, best of each pair."""
    rows = []
    for name, swept in (("nothing missed", without), ("10 % missed", missed)):
        table = 100 * swept.pivot_table(index="pair", columns=["A", "B", "C"], values="rate")
        half = np.arange(len(table)) % 2 == 0
        best = table[half].mean().idxmax()
        oracle = table.max(axis=1)
        rows.append(
            [
                name,
                text(table[(0.5, 1.0, 1.0)]),
                f"A {best[0]:g}, B {best[1]:g}, C {best[2]:g}",
                text(table[~half][best]),
                text(oracle),
                f"{100 * (oracle >= 98).mean():.0f} %",
            ]
        )
    heads = ["(d), mutual, 1.5 s", "printed A .5, B 1, C 1", "best on every other pair", "it, on the rest",
             "best for each pair by its truth", "of which ≥ 98 %"]  # fmt: skip
    settings = without.groupby(["A", "B", "C"]).ngroups
    return f"{markdown_table(heads, rows)}\n\n{settings} settings, {without['pair'].nunique()} pairs, varied road."


def text(rates_percent: pd.Series) -> str:
    """Return mean and half width of its 95 % interval over pairs."""
    if rates_percent.empty:
        return "–"
    mean, half = mean_and_half_width(rates_percent)
    return f"{mean:.1f}±{half:.1f}"


if __name__ == "__main__":
    main()
