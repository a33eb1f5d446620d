"""Training the learned score of ``score`` on pairs of images whose vehicles are known.

Rounds feed rounds out of fold: what round two hears of round one was predicted by trees that had not seen that group
of pairs, for trees flatter what they have learned from (stacking: Wolpert 1992). Given a model to begin with, its trees
stay and a few are added that correct it: that is what the little traffic of one site can teach.

Trees are grown by LightGBM (extra ``train``) on one thread; the same lessons and versions give the same text.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.matching.calibration import LabelledPair
from vtrack_batch.matching.candidates import Array, Edges, candidates
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
from vtrack_batch.matching.score import FORMAT, Model, worth_scoring

FOLDS = 3
TREES, MORE_TREES = 150, 40  # a round; of a model of its own, and added to one
LEAST_TRUE = 100  # fewer true links than this teach nothing
GROWN = {
    "objective": "binary", "learning_rate": 0.06, "num_leaves": 24, "min_data_in_leaf": 60, "lambda_l2": 5.0,
    "feature_fraction": 0.6, "bagging_fraction": 0.7, "bagging_freq": 1, "max_bin": 127, "seed": 3, "verbose": -1,
    "num_threads": 1, "deterministic": True, "force_row_wise": True,
}  # fmt: skip


@dataclass(frozen=True)
class Lesson:
    """The links of one pair that are worth scoring: their columns of round one (e, f), and which are true (e,).

    Lessons of one *group* share vehicles or streets: folds never part them.
    """

    group: str
    elapsed_s: float
    edges: Edges
    xy: tuple[Array, Array]
    true: NDArray[np.bool_]
    base: Array
    heard: Array

    @classmethod
    def of(cls, pair: LabelledPair, group: str, flow_map: FlowMap | None, params: MatchingParams) -> Lesson:
        """Look at a labelled pair as ``match`` does."""
        a, b, partner, _ = pair.read()
        dt, xy = pair.elapsed_s, (a.xy, b.xy)
        edges = candidates(*xy, params.reach_m(dt), limit=params.max_candidate_pairs)
        flow = None if flow_map is None else flow_map.at(*xy, dt)
        if flow is not None:
            edges = edges.select(flow.possible(edges))
        evidence = untrained_labels(edges, a, b, dt, params, flow)[1]
        share = shares(edges, evidence.log_odds)
        keep = worth_scoring(evidence, share)
        edges, evidence, around = edges.select(keep), evidence.select(keep), Surroundings.of(*xy)
        heard = heard_features(edges, share[keep], around, *xy, elapsed_s=dt)
        base = base_features(edges, evidence, around, heard=heard, elapsed_s=dt, flow=flow)
        return cls(group, dt, edges, xy, partner[edges.i] == edges.k, base, heard)

    def first_round(self) -> Array:
        """Return the columns of round one (e, f)."""
        return np.column_stack([self.base, self.heard])

    def later_round(self, p: Array) -> Array:
        """Return the columns of a later round (e, f), the probabilities of the round before being *p* (e,)."""
        heard = heard_features(self.edges, p, Surroundings.of(*self.xy), *self.xy, elapsed_s=self.elapsed_s)
        return np.column_stack([self.base, heard, own_features(self.edges, p)])


@dataclass(frozen=True)
class Trained:
    """A model as text, and what models made without a lesson's group say of it: p (e,) of each round, by lesson."""

    text: str
    unseen: tuple[tuple[Array, Array], ...]


def train(lessons: Sequence[Lesson], *, begun: str | None = None) -> Trained:
    """Train both rounds of a model on *lessons* of at least two groups; *begun* is the text of one to build on.

    Raises ``ConfigError`` where LightGBM is missing, and ``UnusableData`` where the lessons are too few.
    """
    groups = sorted({lesson.group for lesson in lessons})
    true = np.concatenate([lesson.true for lesson in lessons]) if lessons else np.zeros(0, bool)
    if len(groups) < 2 or true.sum() < LEAST_TRUE or true.all():
        raise UnusableData(
            f"{int(true.sum())} true links among {len(true)} possible ones in {len(groups)} drives are too few to "
            f"train on; at least {LEAST_TRUE} and two drives are needed: ask for more pairs"
        )
    fold = dict(zip(groups, np.random.default_rng(1).permutation(len(groups)) % FOLDS, strict=True))
    of_edge = np.repeat([fold[lesson.group] for lesson in lessons], [len(lesson.edges) for lesson in lessons])
    cuts = np.cumsum([len(lesson.edges) for lesson in lessons])[:-1]
    grower = _Grower(None if begun is None else Model.parse(begun, "the model to begin with"))
    x = np.vstack([lesson.first_round() for lesson in lessons])
    one = grower.unseen(0, x, true, of_edge)
    again = np.vstack([lesson.later_round(p) for lesson, p in zip(lessons, np.split(one, cuts), strict=True)])
    two = grower.unseen(1, again, true, of_edge)
    grown = [grower.grow(0, x, true), grower.grow(1, again, true)]
    by_lesson = zip(np.split(one, cuts), np.split(two, cuts), strict=True)
    return Trained(_text([_trees(booster) for booster in grown], begun), tuple(by_lesson))


@dataclass(frozen=True)
class _Grower:
    """Grows trees for a round, on top of those of the model to begin with."""

    begun: Model | None

    def grow(self, round_: int, x: Array, true: NDArray[np.bool_]) -> Any:
        lightgbm = _lightgbm()
        data = lightgbm.Dataset(x, true.astype(float), init_score=self._start(round_, x))
        return lightgbm.train(dict(GROWN), data, TREES if self.begun is None else MORE_TREES)

    def unseen(self, round_: int, x: Array, true: NDArray[np.bool_], fold: NDArray[np.int64]) -> Array:
        """Return the probability (e,) of every edge by trees that have not seen its fold."""
        log_odds = self._start(round_, x)
        log_odds = np.zeros(len(x)) if log_odds is None else log_odds
        for k in np.unique(fold):
            booster = self.grow(round_, x[fold != k], true[fold != k])
            log_odds[fold == k] += booster.predict(x[fold == k], raw_score=True)
        return np.asarray(1 / (1 + np.exp(-log_odds)))

    def _start(self, round_: int, x: Array) -> Array | None:
        """Return the log-odds (e,) of the model to begin with, None where there is none."""
        if self.begun is None:
            return None
        p = self.begun.rounds[round_].probability(x)
        return np.asarray(np.log(p) - np.log1p(-p))


def _lightgbm() -> Any:
    try:
        return import_module("lightgbm")
    except ImportError:
        raise ConfigError(
            'trees are grown by LightGBM, which is not installed: pip install "vtrack-batch[train]"'
        ) from None


def _text(grown: list[list[dict[str, Any]]], begun: str | None) -> str:
    """Write rounds of trees in the format that ``score`` reads, those of *begun* first."""
    before = [[], []] if begun is None else json.loads(begun)["rounds"]
    head = json.dumps({"format": FORMAT, "columns": [*BASE, *HEARD, *OWN]})[:-1]
    rounds = [
        "[\n" + ",\n".join(json.dumps(tree, separators=(",", ":")) for tree in [*old, *new]) + "\n]"
        for old, new in zip(before, grown, strict=True)
    ]
    return head + ',"rounds":[\n' + ",\n".join(rounds) + "\n]}\n"


def _trees(booster: Any) -> list[dict[str, Any]]:
    return [_nodes(tree["tree_structure"]) for tree in booster.dump_model()["tree_info"]]


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
