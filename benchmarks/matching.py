"""Who is who in the next image: our methods and the peers' on the pinned pairs. ``make bench-matching [QUICK=1]``.

Writes the section ``matching`` of docs/accuracy.md and docs/performance.md, and docs/figures/matching.svg.
"""

from __future__ import annotations

import sys
from itertools import product

import numpy as np
import pandas as pd

from benchmarks import targets
from benchmarks.environment import pinned
from benchmarks.figures import rates_by_interval
from benchmarks.jobs import called, parallel, quick
from benchmarks.methods import OURS, PEERS, Setting, flow_map, match_ours, run_on
from benchmarks.noise import Noise
from benchmarks.page import ACCURACY, FIGURES, PERFORMANCE, markdown_table, stamp, write_section
from benchmarks.tuning import joined, link_scores, pair_scores, pooled, training_pairs, tuned, with_settings
from benchmarks.work import INTERVALS_S, SCENES, mean_and_half_width, noisier, pinned_pairs

MISSED = (0.0, 0.1)
# noise on top of the pinned one: variances of 8 and 1 make a spread of 3
MORE = float(np.sqrt(8))
VARIANTS = {
    "nominal": None,
    "colour noise × 3": Noise(0.0, 0.04 * MORE, 3 * MORE, 3 * MORE, 0.0),
    "position noise 3 px": Noise(0.33 * MORE, 0.0, 0.0, 0.0, 0.0),
}
NOISY_SCENES = ("road", "crossing")
TEXT = """\
Pooled label rate in %: vehicles of both images, the right answer of a vehicle without a partner being that it has none;
mean over the pairs of a cell ± half of its 95 % interval over pairs; nothing / 10 % missed. Pinned pairs of
`../shared/data/sumo`; nobody was tuned on them. Flow maps: `vt.learn_flow` from the unlabelled archive thinned to the
interval. Ours: one set of defaults. Peers: the best of a grid for each scene and interval, by truth, on another seed of
the same scene (below); what remembers speed has none to remember in a pair."""
SPEED_TEXT = """\
Mean processor time for a pair, the same pairs, nothing missed, 1.5 s, one thread; in brackets how many times as long
our default takes (above 1 = ours is slower)."""
COMMAND = "make bench-matching"


def main() -> None:
    """Measure everything, print the tables, write the sections."""
    few = quick()
    limit, map_s = (6, 300.0) if few else (10**9, 1e9)
    cells = [(scene, elapsed_s, "nominal") for scene, elapsed_s in product(SCENES, INTERVALS_S)]
    cells += [(scene, 1.5, variant) for scene in NOISY_SCENES for variant in VARIANTS if variant != "nominal"]
    jobs = [(ours_on, (*cell, limit, map_s)) for cell in cells]
    jobs += [(peer_on, (scene, number, limit)) for number in range(len(PEERS)) for scene in SCENES]
    answers = parallel(jobs)
    results = pd.concat([rows for rows, _ in answers], ignore_index=True)
    notes = [note for _, note in answers if note is not None]
    accuracy, performance = report(results, notes, few)
    write_section(ACCURACY, "matching", accuracy)
    write_section(PERFORMANCE, "matching", performance)
    print(accuracy, performance, sep="\n\n", file=sys.stdout)


def ours_on(scene: str, elapsed_s: float, variant: str, limit: int, map_s: float) -> tuple[pd.DataFrame, None]:
    """Return the scores of all our methods at an interval, pair by pair."""
    learned = flow_map(scene, elapsed_s, map_s, VARIANTS[variant])
    rows, cells = work(scene, (elapsed_s,), (variant,), limit)
    found = []
    for ours in OURS:
        links, seconds = match_ours(ours, rows, learned)
        scores = link_scores(rows, links).assign(method=ours.name)
        scores["seconds"] = scores["sequence"].map(seconds)
        found.append(scores.join(_reliability(rows, links), on="sequence"))
    return pd.concat(found).join(cells, on="sequence"), None


def peer_on(scene: str, number: int, limit: int) -> tuple[pd.DataFrame, tuple]:
    """Return the scores of a peer, tuned on other seeds, in a scene, pair by pair; and what it was tuned to."""
    peer = PEERS[number]
    best = tuned(peer, training_pairs(scene, INTERVALS_S), peer.pairs, pooled)
    rows, cells = work(scene, INTERVALS_S, tuple(VARIANTS), limit)
    (track,), seconds = run_on(peer, with_settings(rows, best), peer.pairs)
    scores = pair_scores(rows, track).assign(method=peer.name)
    scores["seconds"] = scores["sequence"].map(seconds.set_index("sequence")["seconds"])
    return scores.join(cells, on="sequence"), (peer.name, scene, best)


def work(
    scene: str, intervals_s: tuple[float, ...], variants: tuple[str, ...], limit: int
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return pinned pairs, and by ``sequence`` the cell of each: ``scene, elapsed_s, missed, variant, pair``."""
    cells = [
        (scene, elapsed_s, missed, variant)
        for elapsed_s, missed, variant in product(intervals_s, MISSED, variants)
        if variant == "nominal" or (scene in NOISY_SCENES and elapsed_s == 1.5 and missed == 0.1)
    ]
    tables = []
    for _, elapsed_s, missed, variant in cells:
        rows, noise = pinned_pairs(scene, elapsed_s, missed, limit), VARIANTS[variant]
        tables.append(rows if noise is None else noisier(rows, noise))
    rows = joined(tables)
    sequence = rows["sequence"].drop_duplicates()
    of = pd.DataFrame([cells[n] for n in sequence // 1_000_000], columns=["scene", "elapsed_s", "missed", "variant"])
    return rows, of.assign(pair=(sequence % 1_000_000).to_numpy(), sequence=sequence.to_numpy()).set_index("sequence")


def _reliability(rows: pd.DataFrame, links: pd.DataFrame) -> pd.DataFrame:
    """Return for each pair, in ten bins of stated probability: links, sum of probability, right links."""
    truth = {name: [p.loc[p["frame"] == f, "truth"].to_numpy() for f in (0, 1)] for name, p in rows.groupby("sequence")}
    table = links.assign(bin=np.minimum((10 * links["probability"]).astype(int), 9), n=1)
    table["hit"] = [truth[s][0][i] == truth[s][1][k] for s, i, k in links[["sequence", "i", "k"]].to_numpy()]
    sums = table.groupby(["sequence", "bin"])[["n", "probability", "hit"]].sum().unstack("bin", fill_value=0)
    sums.columns = [f"{name}_{number}" for name, number in sums.columns]
    return sums


def ece(scores: pd.DataFrame) -> float:
    """Return the expected calibration error of links: Σ |stated - right| / Σ links over ten bins."""
    off = [abs(scores[f"probability_{b}"].sum() - scores[f"hit_{b}"].sum()) for b in range(10) if f"n_{b}" in scores]
    return float(np.sum(off) / scores["links"].sum())


def report(results: pd.DataFrame, notes: list[tuple], few: bool) -> tuple[str, str]:
    """Return the sections of both pages."""
    nominal = results[results["variant"] == "nominal"]
    rates_by_interval(nominal[nominal["missed"] == 0.1], FIGURES / "matching.svg")
    counted = nominal[nominal["elapsed_s"] == 1.5].groupby("scene")["pair"].nunique() / len(MISSED)
    numbers = ", ".join(f"{scene} {counted[scene]:.0f}" for scene in SCENES)
    quickly = "**QUICK: the first few pairs of each cell, maps from the first 5 minutes.** " if few else ""
    lines = ["## Pairs of images", f"{quickly}{TEXT} Pairs a cell: {numbers}."]
    lines += ["![label rate by interval](figures/matching.svg)"]
    for scene in SCENES:
        lines += [f"### {scene}", scene_table(nominal[nominal["scene"] == scene], scene)]
    lines += ["### Errors against the best peer", ratio_table(nominal)]
    lines += ["### No map and no training (1.5 s, 10 % missed)", untrained_table(nominal)]
    lines += ["### More noise than usual (1.5 s, 10 % missed)", variant_table(results)]
    lines += ["### Are the stated probabilities true?", calibration_table(results)]
    lines += ["### What peers were tuned to", tuned_table(notes)]
    line = stamp(called(COMMAND), peers=sorted({pinned(peer.environment) for peer in PEERS}))
    speed = ["## Pairs of images", SPEED_TEXT, speed_table(nominal), line]
    return "\n\n".join([*lines, line]), "\n\n".join(speed)


def scene_table(results: pd.DataFrame, scene: str) -> str:
    """Return rates by method, beside what is asked for."""
    must, aim = targets.PAIRS[scene]
    rows = [["*must*", *(f"{a} / {b}" for a, b in must)], ["*aim (lower end)*", *(f"{a} / {b}" for a, b in aim)]]
    for method, of_method in results.groupby("method", sort=False):
        cells = []
        for elapsed_s in INTERVALS_S:
            of = of_method[of_method["elapsed_s"] == elapsed_s]
            cells.append(" / ".join(percent(of.loc[of["missed"] == missed, "pooled"]) for missed in MISSED))
        rows.append([str(method), *cells])
    return markdown_table(["method", *(f"{s} s" for s in INTERVALS_S)], rows)


def ratio_table(results: pd.DataFrame) -> str:
    """Return the share of wrong labels of ours over that of the best peer, by cell."""
    wrong = 1 - results.groupby(["scene", "elapsed_s", "missed", "method"])["pooled"].mean().unstack("method")
    peers = wrong[[peer.name for peer in PEERS]]
    rows = []
    for (scene, elapsed_s, missed), errors in wrong.iterrows():
        best = peers.loc[(scene, elapsed_s, missed)]
        ours = [f"{100 * errors[n]:.2f} ({errors[n] / best.min():.2f})" for n in ("default, flow map", "default")]
        rows.append([f"{scene} {elapsed_s} s, {100 * missed:.0f} %", f"{100 * best.min():.2f} {best.idxmin()}", *ours])
    heads = ["cell", "best peer: wrong %", "default with map: wrong % (ratio)", "default without map: wrong % (ratio)"]
    return markdown_table(heads, rows)


def untrained_table(results: pd.DataFrame) -> str:
    """Return the rates of what needs neither a map nor labelled traffic, beside what is asked for."""
    at = results[(results["elapsed_s"] == 1.5) & (results["missed"] == 0.1)]
    rows = [[f"*{name}*", *(f"{wanted[scene]:g}" for scene in SCENES)] for name, wanted in targets.UNTRAINED.items()]
    names = [ours.name for ours in OURS if ours.method != "default"]
    for method in names:
        of = at[at["method"] == method]
        rows.append([method, *(percent(of.loc[of["scene"] == scene, "pooled"]) for scene in SCENES)])
    return markdown_table(["method", *SCENES], rows)


def variant_table(results: pd.DataFrame) -> str:
    """Return rates with more noise."""
    at = results[(results["elapsed_s"] == 1.5) & (results["missed"] == 0.1)]
    columns = list(product(NOISY_SCENES, VARIANTS))
    rows = [[f"*{name}*", *(str(t.get(c, "–")) for c in columns)] for name, t in targets.ROBUST.items()]
    for method, of_method in at.groupby("method", sort=False):
        cells = [of_method[(of_method["scene"] == s) & (of_method["variant"] == v)]["pooled"] for s, v in columns]
        rows.append([str(method), *map(percent, cells)])
    return markdown_table(["method", *(f"{scene}, {variant}" for scene, variant in columns)], rows)


def calibration_table(results: pd.DataFrame) -> str:
    """Return the expected calibration error of the links that were made, over all scenes and intervals."""
    rows = []
    for ours in OURS:
        of = results[results["method"] == ours.name]
        rows.append([ours.name, *(f"{ece(of[of['variant'] == variant]):.3f}" for variant in VARIANTS)])
    heads = [
        "expected calibration error of links made",
        *(f"{v}{' (road, crossing)' if i else ''}" for i, v in enumerate(VARIANTS)),
    ]
    return markdown_table(heads, [["*must*", "0.01", "0.03", "0.03"], *rows])


def tuned_table(notes: list[tuple]) -> str:
    """Return the chosen settings."""
    chosen = {(name, scene): best for name, scene, best in notes}
    rows = []
    for peer in PEERS:
        for scene in SCENES:
            best = [peer.pairs[chosen[peer.name, scene][s]] for s in INTERVALS_S]
            rows.append([peer.name, scene, *map(setting_text, best)])
    return markdown_table(["peer", "scene", *(f"{s} s" for s in INTERVALS_S)], rows) + (
        "\n\nreach = m/s times the interval, metres = metres that a level of colour difference counts for; grids: "
        + "; ".join(f"{peer.name} {len(peer.pairs)} settings" for peer in PEERS)
        + " (`benchmarks/methods.py`)."
    )


def setting_text(setting: Setting) -> str:
    """Return a setting in few words."""
    return ", ".join(f"{name.split('_')[0]} {value:g}" for name, value in setting.items() if name != "colour")


def speed_table(results: pd.DataFrame) -> str:
    """Return seconds for a pair, and ratios."""
    at = results[(results["elapsed_s"] == 1.5) & (results["missed"] == 0.0)]
    seconds = at.groupby(["method", "scene"], sort=False)["seconds"].mean().unstack("scene")[list(SCENES)]
    base = seconds.loc["default"]
    rows = [
        [str(method), *(f"{1000 * s:.1f} ms ({base[scene] / s:.1f})" for scene, s in of.items())]
        for method, of in seconds.iterrows()
    ]
    return markdown_table(["method", *SCENES], rows)


def percent(rates: pd.Series) -> str:
    """Return mean and half width in per cent, – where there is nothing."""
    if rates.empty:
        return "–"
    mean, half = mean_and_half_width(100 * rates)
    return f"{mean:.1f}±{half:.1f}"


if __name__ == "__main__":
    main()
