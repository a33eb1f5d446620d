"""Train the matcher's learned score on simulated traffic, and say how good it is on worlds left out.

``make train-matching`` runs it: traffic of many layouts and noise levels by Eclipse SUMO (extra ``sim``), trees by
``vtrack_batch.matching.training`` (extra ``train``), the model as text into ``vtrack_batch/matching/models``. Same
seeds, same versions: same file. ``--seeds 1``, eight worlds, took ten minutes on a busy core.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial import KDTree

from benchmarks.noise import Noise, seen
from benchmarks.training_traffic import KINDS, world
from vtrack_batch.matching.calibration import LabelledPair
from vtrack_batch.matching.decision import most_right, one_to_one
from vtrack_batch.matching.features import BASE
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.matching.relaxation import Labels
from vtrack_batch.matching.score import labels_of
from vtrack_batch.matching.training import Lesson, train

MODEL = Path(__file__).resolve().parents[1] / "vtrack_batch" / "matching" / "models" / "default.json"
ARCHIVE_S, LONG_S = 320.0, 520.0
PAIRS, MOST_VEHICLES = 8, 90
WITHOUT_MAP, WITHOUT_COLOUR = (1, 4, 7), (5,)  # these of the eight pairs


@dataclass(frozen=True)
class Example:
    """One lesson and where it comes from."""

    pair: LabelledPair
    lesson: Lesson
    noise: Noise
    with_map: bool

    def rate(self, picked: np.ndarray) -> tuple[int, int]:
        """Return how many labels of both images are right, no match counted, and how many there are."""
        *_, true_k, true_i = self.pair.read()
        found_k, found_i = np.full(len(true_k), -1), np.full(len(true_i), -1)
        i, k = self.lesson.edges.i[picked], self.lesson.edges.k[picked]
        found_k[i], found_i[k] = k, i
        return int((found_k == true_k).sum() + (found_i == true_i).sum()), len(true_k) + len(true_i)


def main() -> None:
    """Simulate, train, report, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6, help="worlds of every kind of layout")
    parser.add_argument("--out", type=Path, default=MODEL)
    args = parser.parse_args()
    seeds = range(1, args.seeds + 1)
    examples = [found for seed in seeds for kind in dict.fromkeys(KINDS) for found in examples_of_world(kind, seed)]
    lessons = [found.lesson for found in examples]
    true = np.concatenate([lesson.true for lesson in lessons])
    worlds = len({lesson.group for lesson in lessons})
    print(f"{worlds} worlds, {len(lessons)} pairs, {len(true)} edges, {true.sum()} of them true", flush=True)
    trained = train(lessons)
    report([(found, *p) for found, p in zip(examples, trained.unseen, strict=True)])
    args.out.write_text(trained.text, encoding="utf-8")


def examples_of_world(kind: str, seed: int) -> list[Example]:
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
            pair = pair_of(images, elapsed_s, n not in WITHOUT_COLOUR)
            learned = None if n in WITHOUT_MAP else flow
            lesson = Lesson.of(pair, f"{kind}-{seed}", learned, MatchingParams())
            found.append(Example(pair, lesson, noise, learned is not None))
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


def pair_of(images: list[pd.DataFrame], elapsed_s: float, coloured: bool) -> LabelledPair:
    """Return two images as a labelled pair; of crowded ones only a part."""
    if len(images[0]) > MOST_VEHICLES:
        middle = images[0][["x_m", "y_m"]].iloc[0].to_numpy()
        away = [np.abs(image[["x_m", "y_m"]].to_numpy() - middle).max(axis=1) for image in images]
        reach = np.sort(away[0])[MOST_VEHICLES - 1]
        images = [image[d <= reach] for image, d in zip(images, away, strict=True)]
    known = [image.assign(vehicle=image["vehicle"].where(image["vehicle"] >= 0).astype("Int64")) for image in images]
    earlier, later = (image if coloured else image.drop(columns="red") for image in known)
    return LabelledPair(earlier, later, elapsed_s)


def report(judged: list[tuple[Example, np.ndarray, np.ndarray]]) -> None:
    """Print rates and calibration on worlds left out, in all and by interval, noise and what was known.

    *judged* holds the probabilities of round one and of round two.
    """
    groups: dict[str, list[tuple[Example, np.ndarray, np.ndarray]]] = {}
    for example, *p in judged:
        kinds = (
            "all",
            f"{example.pair.elapsed_s} s",
            "map" if example.with_map else "no map",
            f"colour noise x{example.noise.channel / Noise.channel:g}",
        )
        for name in (*kinds, f"position noise {example.noise.position_m} m", f"missed {example.noise.missed:.0%}"):
            groups.setdefault(name, []).append((example, p[0], p[1]))
    print(f"{'worlds left out':<24} {'pairs':>5} {'Bayes %':>8} {'round 1 %':>9} {'round 2 %':>9} {'ECE':>6}")
    for name in sorted(groups):
        rows, size = np.zeros((3, 2)), len(groups[name])
        for example, *p in groups[name]:
            edges = example.lesson.edges
            rows[0] += example.rate(one_to_one(edges, plain_labels(example.lesson)))
            for row, of_round in zip(rows[1:], p, strict=True):
                row += example.rate(most_right(edges, labels_of(edges, of_round)))
        error = calibration_error(
            np.concatenate([p for *_, p in groups[name]]),
            np.concatenate([example.lesson.true for example, *_ in groups[name]]),
        )
        bayes, one, two = 100 * rows[:, 0] / rows[:, 1]
        print(f"{name:<24} {size:>5} {bayes:>8.2f} {one:>9.2f} {two:>9.2f} {error:>6.4f}")


def plain_labels(lesson: Lesson) -> Labels:
    """Return what Bayes' rule alone says, each edge by itself."""
    odds = np.exp(lesson.base[:, BASE.index("log_odds")])
    p, edges = odds / (1 + odds), lesson.edges
    return Labels(p, p, np.full(edges.n, 0.5), np.full(edges.m, 0.5))


def calibration_error(p: np.ndarray, true: np.ndarray, *, least: float = 0.02, bins: int = 15) -> float:
    """Return the expected calibration error of the probabilities above *least*."""
    p, true = p[p > least], true[p > least]
    of = np.minimum((p * bins).astype(int), bins - 1)
    return float(sum(abs(p[of == n].sum() - true[of == n].sum()) for n in range(bins)) / max(1, len(p)))


if __name__ == "__main__":
    main()
