"""Train the matcher's learned score on simulated traffic, and say how good it is on worlds left out.

``make train-matching`` runs it: traffic of many layouts and noise levels by Eclipse SUMO (extra ``sim``), trees by
LightGBM (extra ``train``), the model as text into ``vtrack_batch/matching/models/default.json``. Same seeds, same
versions: same file. ``--seeds 1``, eight worlds, took ten minutes on a busy core.

Rounds feed rounds out of fold: what round two hears of round one was predicted by trees that had not seen that world.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lightgbm
import numpy as np
import pandas as pd
from scipy.spatial import KDTree

from benchmarks.noise import Noise, seen
from benchmarks.training_traffic import KINDS, world
from vtrack_batch.matching.candidates import Edges, candidates
from vtrack_batch.matching.decision import most_right, one_to_one
from vtrack_batch.matching.features import (
    BASE,
    HEARD,
    OWN,
    Surroundings,
    base_features,
    heard_features,
    own_features,
    shares,
)
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.match import untrained_labels
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.matching.relaxation import Labels
from vtrack_batch.matching.score import FORMAT, KEEP_LOG_ODDS, labels_of
from vtrack_batch.matching.vehicles import Vehicles

MODEL = Path(__file__).resolve().parents[1] / "vtrack_batch" / "matching" / "models" / "default.json"
ARCHIVE_S, LONG_S = 320.0, 520.0
PAIRS, MOST_VEHICLES, FOLDS = 8, 90, 3
WITHOUT_MAP, WITHOUT_COLOUR = (1, 4, 7), (5,)  # these of the eight pairs
TREES = {
    "objective": "binary", "learning_rate": 0.06, "num_leaves": 24, "min_data_in_leaf": 60, "lambda_l2": 5.0,
    "feature_fraction": 0.6, "bagging_fraction": 0.7, "bagging_freq": 1, "max_bin": 127, "seed": 3, "verbose": -1,
    "num_threads": 1, "deterministic": True, "force_row_wise": True,
}  # fmt: skip
ROUNDS = 150


@dataclass
class Pair:
    """One pair of images with its possible links: columns of round one, truth, and what hearing neighbours needs."""

    world: str
    noise: Noise
    elapsed_s: float
    with_map: bool
    edges: Edges
    xy: tuple[np.ndarray, np.ndarray]
    vehicle: tuple[np.ndarray, np.ndarray]
    base: np.ndarray
    heard: np.ndarray

    @property
    def true(self) -> np.ndarray:
        """Which edges are one vehicle, (e,) bool."""
        first = self.vehicle[0][self.edges.i]
        return (first == self.vehicle[1][self.edges.k]) & (first >= 0)

    def heard_again(self, p: np.ndarray) -> np.ndarray:
        """Return the columns of a later round."""
        around = Surroundings.of(*self.xy)
        heard = heard_features(self.edges, p, around, *self.xy, elapsed_s=self.elapsed_s)
        return np.column_stack([self.base, heard, own_features(self.edges, p)])

    def rate(self, picked: np.ndarray) -> tuple[int, int]:
        """Return how many labels of both images are right, no match counted, and how many there are."""
        a, b = self.vehicle
        with_partner = [np.isin(a, b[b >= 0]), np.isin(b, a[a >= 0])]
        without = [np.ones(len(a), bool), np.ones(len(b), bool)]
        without[0][self.edges.i[picked]] = without[1][self.edges.k[picked]] = False
        none_right = sum(int((w & ~has).sum()) for w, has in zip(without, with_partner, strict=True))
        return 2 * int((picked & self.true).sum()) + none_right, len(a) + len(b)


def main() -> None:
    """Simulate, train, report, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6, help="worlds of every kind of layout")
    parser.add_argument("--out", type=Path, default=MODEL)
    args = parser.parse_args()
    pairs = [
        pair
        for seed in range(1, args.seeds + 1)
        for kind in dict.fromkeys(KINDS)
        for pair in pairs_of_world(kind, seed)
    ]
    names = sorted({pair.world for pair in pairs})
    fold = dict(zip(names, np.random.default_rng(1).permutation(len(names)) % FOLDS, strict=True))
    of_edge = np.repeat([fold[pair.world] for pair in pairs], [len(pair.edges) for pair in pairs])
    cuts = np.cumsum([len(pair.edges) for pair in pairs])[:-1]
    true = np.concatenate([pair.true for pair in pairs]).astype(float)
    print(f"{len(names)} worlds, {len(pairs)} pairs, {len(true)} edges, {int(true.sum())} of them true", flush=True)
    x = np.vstack([np.column_stack([pair.base, pair.heard]) for pair in pairs])
    unseen = np.zeros(len(true))
    for k in range(FOLDS):
        unseen[of_edge == k] = trees(x[of_edge != k], true[of_edge != k]).predict(x[of_edge == k])
    again = np.vstack([pair.heard_again(p) for pair, p in zip(pairs, np.split(unseen, cuts), strict=True)])
    left_out = of_edge == 0
    second = trees(again[~left_out], true[~left_out])
    rounds = [np.split(p, cuts) for p in (unseen, second.predict(again))]
    report([(pair, *both) for pair, *both in zip(pairs, *rounds, strict=True) if fold[pair.world] == 0])
    gain = pd.Series(second.feature_importance("gain"), [*BASE, *HEARD, *OWN])
    print((100 * gain / gain.sum()).sort_values(ascending=False).head(12).round(1).to_string())
    args.out.write_text(as_text([trees(x, true), trees(again, true)]), encoding="utf-8")


def pairs_of_world(kind: str, seed: int) -> list[Pair]:
    """Simulate a world and take pairs of images at three intervals, each with noise and a flow map of its own."""
    rng = np.random.default_rng([seed, KINDS.index(kind), 7])
    truth = world(kind, seed, seconds=LONG_S)
    truth = truth.assign(t_s=truth["t_s"] - truth["t_s"].min())
    if truth.groupby("t_s").size().median() < 6:
        return []
    found = []
    for choice in ((0.25, 0.5, 1.0), (1.5, 1.5, 2.0), (2.5, 3.0, 4.0, 4.0)):
        elapsed_s, noise = float(rng.choice(choice)), any_noise(rng)
        flow = flow_from_truth(truth[truth["t_s"] < (160 if elapsed_s < 1 else ARCHIVE_S)], elapsed_s, noise, rng)
        times = np.unique(truth["t_s"])
        times = times[(times > ARCHIVE_S + 5) & (times < times.max() - elapsed_s)]
        for n, t_s in enumerate(rng.choice(times, PAIRS, replace=False)):
            images = [seen(truth[np.isclose(truth["t_s"], t)], noise, rng) for t in (t_s, t_s + elapsed_s)]
            images = [image.assign(detection_id=np.arange(len(image))) for image in images]
            pair = pair_of(images, elapsed_s, None if n in WITHOUT_MAP else flow, n not in WITHOUT_COLOUR)
            if pair is not None:
                found.append(dataclasses.replace(pair, world=f"{kind}-{seed}", noise=noise))
    print(f"{kind}-{seed}: {len(found)} pairs", flush=True)
    return found


def any_noise(rng: np.random.Generator) -> Noise:
    """Draw one of many kinds of seeing, from clear to bad."""
    position_m, colour = float(rng.choice([0.2, 0.33, 0.33, 0.5, 1.0])), float(rng.choice([1, 1, 1.5, 2, 3]))
    return Noise(
        position_m,
        *(colour * spread for spread in (Noise.gain, Noise.common, Noise.channel)),
        shadow_share=float(rng.choice([0.02, 0.02, 0.1])),
        missed=float(rng.choice([0, 0.05, 0.1, 0.1, 0.15, 0.25])),
        false_share=float(rng.choice([0, 0, 0, 0.02])),
    )


def flow_from_truth(truth: pd.DataFrame, elapsed_s: float, noise: Noise, rng: np.random.Generator) -> FlowMap:
    """Return a map as learning without truth would: hard links are missing more often, and a few are wrong."""
    on_time = np.isclose(np.round(truth["t_s"] / elapsed_s) * elapsed_s, truth["t_s"])
    archive = seen(truth[on_time], noise, rng)
    frames = dict(list(archive.groupby(np.round(archive["t_s"] / elapsed_s).astype(int))))
    hard_kept, wrong = rng.uniform(0.4, 0.9), rng.choice([0.002, 0.01, 0.02])
    xy, velocity = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for number, a in frames.items():
        b = frames.get(number + 1)
        if b is None or len(a) < 2 or len(b) < 2:
            continue
        links = a[a["vehicle"] >= 0][["vehicle", "x_m", "y_m"]].merge(b[["vehicle", "x_m", "y_m"]], on="vehicle")
        start, end = links[["x_m_x", "y_m_x"]].to_numpy(), links[["x_m_y", "y_m_y"]].to_numpy()
        if not len(links):
            continue
        spacing = KDTree(a[["x_m", "y_m"]].to_numpy()).query(start, k=2)[0][:, 1]
        kept = rng.random(len(start)) < np.where(np.hypot(*(end - start).T) > spacing, hard_kept, 0.97)
        places = b[["x_m", "y_m"]].to_numpy()
        other = places[KDTree(places).query(end, k=2)[1][:, 1]]
        end = np.where((rng.random(len(start)) < wrong)[:, None], other, end)
        xy.append(start[kept])
        velocity.append((end - start)[kept] / elapsed_s)
    return FlowMap(np.vstack(xy), np.vstack(velocity))


def pair_of(images: list[pd.DataFrame], elapsed_s: float, flow: FlowMap | None, coloured: bool) -> Pair | None:
    """Return a pair with its edges and their columns; of crowded images only a part."""
    params = MatchingParams()
    if len(images[0]) > MOST_VEHICLES:
        middle = images[0][["x_m", "y_m"]].iloc[0].to_numpy()
        away = [np.abs(image[["x_m", "y_m"]].to_numpy() - middle).max(axis=1) for image in images]
        reach = np.sort(away[0])[MOST_VEHICLES - 1]
        images = [image[d <= reach] for image, d in zip(images, away, strict=True)]
    a, b = (Vehicles.of(image if coloured else image.drop(columns="red"), "image") for image in images)
    edges = candidates(a.xy, b.xy, params.reach_m(elapsed_s))
    if flow is not None:
        edges = edges.select(flow.possible(a.xy[edges.i], b.xy[edges.k], elapsed_s))
    evidence = untrained_labels(edges, a, b, elapsed_s, params, flow)[1]
    keep = np.flatnonzero(evidence.log_odds > KEEP_LOG_ODDS)
    if not len(keep):
        return None
    edges, evidence = edges.select(keep), evidence.select(keep)
    around = Surroundings.of(a.xy, b.xy)
    heard = heard_features(edges, shares(edges, evidence.log_odds), around, a.xy, b.xy, elapsed_s=elapsed_s)
    base = base_features(edges, evidence, around, a.xy, b.xy, heard=heard, elapsed_s=elapsed_s, flow_map=flow)
    vehicle = [
        image.set_index("detection_id")["vehicle"].loc[side.ids.astype(int)].to_numpy()
        for image, side in zip(images, (a, b), strict=True)
    ]
    with_map = flow is not None
    return Pair("", Noise(), elapsed_s, with_map, edges, (a.xy, b.xy), (vehicle[0], vehicle[1]), base, heard)


def trees(x: np.ndarray, true: np.ndarray) -> lightgbm.Booster:
    """Fit one round."""
    return lightgbm.train(dict(TREES), lightgbm.Dataset(x, true), ROUNDS)


def report(judged: list[tuple[Pair, np.ndarray, np.ndarray]]) -> None:
    """Print rates and calibration on worlds left out, in all and by interval, noise and what was known.

    *judged* holds the probabilities of round one and of round two.
    """
    groups: dict[str, list[tuple[Pair, np.ndarray, np.ndarray]]] = {}
    for pair, *p in judged:
        kinds = (
            "all",
            f"{pair.elapsed_s} s",
            "map" if pair.with_map else "no map",
            f"colour noise x{pair.noise.channel / Noise.channel:g}",
        )
        for name in (*kinds, f"position noise {pair.noise.position_m} m", f"missed {pair.noise.missed:.0%}"):
            groups.setdefault(name, []).append((pair, p[0], p[1]))
    print(f"{'worlds left out':<24} {'pairs':>5} {'Bayes %':>8} {'round 1 %':>9} {'round 2 %':>9} {'ECE':>6}")
    for name in sorted(groups):
        rows, size = np.zeros((3, 2)), len(groups[name])
        for pair, *p in groups[name]:
            odds = pair.base[:, BASE.index("log_odds")]
            plainly = np.exp(odds) / (1 + np.exp(odds))
            plain = Labels(plainly, plainly, np.full(pair.edges.n, 0.5), np.full(pair.edges.m, 0.5))
            rows[0] += pair.rate(one_to_one(pair.edges, plain))
            for row, of_round in zip(rows[1:], p, strict=True):
                row += pair.rate(most_right(pair.edges, labels_of(pair.edges, of_round)))
        error = calibration_error(
            np.concatenate([p for *_, p in groups[name]]), np.concatenate([pair.true for pair, *_ in groups[name]])
        )
        bayes, one, two = 100 * rows[:, 0] / rows[:, 1]
        print(f"{name:<24} {size:>5} {bayes:>8.2f} {one:>9.2f} {two:>9.2f} {error:>6.4f}")


def calibration_error(p: np.ndarray, true: np.ndarray, *, least: float = 0.02, bins: int = 15) -> float:
    """Return the expected calibration error of the probabilities above *least*."""
    p, true = p[p > least], true[p > least]
    of = np.minimum((p * bins).astype(int), bins - 1)
    return float(sum(abs(p[of == n].sum() - true[of == n].sum()) for n in range(bins)) / max(1, len(p)))


def as_text(boosters: list[lightgbm.Booster]) -> str:
    """Write rounds of trees in the format that ``vtrack_batch.matching.score`` reads."""
    head = json.dumps({"format": FORMAT, "columns": [*BASE, *HEARD, *OWN]})[:-1]
    rounds = []
    for booster in boosters:
        grown = [_nodes(tree["tree_structure"]) for tree in booster.dump_model()["tree_info"]]
        rounds.append("[\n" + ",\n".join(json.dumps(tree, separators=(",", ":")) for tree in grown) + "\n]")
    return head + ',"rounds":[\n' + ",\n".join(rounds) + "\n]}\n"


def _nodes(root: dict[str, Any]) -> dict[str, list[Any]]:
    """Lay a tree out as lists, root first."""
    tree: dict[str, list[Any]] = {"column": [], "threshold": [], "left": [], "right": []}

    def add(node: dict[str, Any]) -> int:
        at = len(tree["column"])
        leaf = "split_feature" not in node
        tree["column"].append(-1 if leaf else node["split_feature"])
        tree["threshold"].append(float(f"{node['leaf_value']:.5g}" if leaf else f"{node['threshold']:.7g}"))
        tree["left"].append(0)
        tree["right"].append(0)
        if not leaf:
            tree["left"][at], tree["right"][at] = add(node["left_child"]), add(node["right_child"])
        return at

    add(root)
    return tree


if __name__ == "__main__":
    main()
