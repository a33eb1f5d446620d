"""The learned score of a link: gradient-boosted trees over ``features``, in rounds of neighbour support.

Round one judges every edge by what Bayes' rule made of it, by the flow map, and by neighbours as Bayes' rule has them.
Each further round hears the neighbours again, now with the probabilities of the round before, and knows the rivals'.
The outcome is a probability, calibrated on layouts and noise that the trees have not seen; see ``models/README.md``.

A model is a text file: JSON with the names of the columns and, per round, trees as lists of nodes. This is the
chapter's one file that reads files: those that come with the package.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.matching.candidates import Array, Edges, Index
from vtrack_batch.matching.features import (
    BASE,
    HEARD,
    OWN,
    Evidence,
    Surroundings,
    base_features,
    heard_features,
    own_features,
    shares,
)
from vtrack_batch.matching.local_flow import LocalFlow
from vtrack_batch.matching.relaxation import Labels
from vtrack_batch.matching.trees import Trees

FORMAT = "vtrack-batch trees 1"
DEFAULT = "default.json"
KEEP_LOG_ODDS = -6.0  # edges that Bayes' rule gives less against no match,
KEEP_SHARE = 1e-4  # or less against all their rivals, are not scored; nor scored again
HOPELESS = 1e-6  # their probability
LEAST_NONE = 0.01  # probability of no match is taken as at least this where odds are asked for


@dataclass(frozen=True)
class Model:
    """Trees for every round; later rounds have the columns ``OWN`` too."""

    rounds: tuple[Trees, ...]

    @classmethod
    def parse(cls, text: str, name: str) -> Model:
        """Read a model from its text; raises ``UnusableData`` where it is of another kind or version."""
        try:
            content = json.loads(text)
            known = content["format"], content["columns"]
            rounds = tuple(Trees.of(trees, len(BASE + HEARD + OWN)) for trees in content["rounds"])
        except (json.JSONDecodeError, LookupError, TypeError, ValueError) as reason:
            raise UnusableData(f"{name} is no model of links: {reason}") from reason
        if known != (FORMAT, [*BASE, *HEARD, *OWN]):
            raise UnusableData(f"{name} was made for other columns, or another version: {known[0]!r}, not {FORMAT!r}")
        return cls(rounds)


@cache
def model_of(path: str | None) -> Model:
    """Return the model in a file, or the one that comes with the package if *path* is None."""
    return Model.parse(model_text(path), path or DEFAULT)


def model_text(path: str | None) -> str:
    """Return the text of a model's file; raises ``ConfigError`` where it cannot be read."""
    try:
        source = files("vtrack_batch.matching") / "models" / DEFAULT if path is None else Path(path)
        return source.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as reason:
        why = reason.strerror if isinstance(reason, OSError) else "it is not UTF-8 text"
        raise ConfigError(f"{path}: the model of links cannot be read ({why}); see matching.model") from None


def worth_scoring(evidence: Evidence, share: Array) -> Index:
    """Return the edges (s,) that Bayes' rule does not rule out, against no match or by their *share* among rivals."""
    return np.flatnonzero((evidence.log_odds > KEEP_LOG_ODDS) & (share > KEEP_SHARE))


def link_probabilities(
    edges: Edges,
    evidence: Evidence,
    earlier_xy: Array,
    later_xy: Array,
    *,
    elapsed_s: float,
    flow: LocalFlow | None = None,
    model: Model | None = None,
) -> Array:
    """Return the calibrated probability (e,) of every edge that both ends are one vehicle; points (n, 2), (m, 2)."""
    p = np.full(len(edges), HOPELESS)
    bayes = shares(edges, evidence.log_odds)
    keep = worth_scoring(evidence, bayes)
    if len(keep):
        kept, of_kept, found = edges.select(keep), evidence.select(keep), bayes[keep]
        around, xy = Surroundings.of(earlier_xy, later_xy), (earlier_xy, later_xy)
        heard = heard_features(kept, found, around, *xy, elapsed_s=elapsed_s)
        base = base_features(kept, of_kept, around, heard=heard, elapsed_s=elapsed_s, flow=flow)
        rounds = (model or model_of(None)).rounds
        found = rounds[0].probability(np.column_stack([base, heard]))
        for trees in rounds[1:]:
            again = np.flatnonzero(found > KEEP_SHARE)
            heard = heard_features(kept, found, around, *xy, elapsed_s=elapsed_s, asked=again)
            columns = np.column_stack([base[again], heard, own_features(kept, found)[again]])
            found = found.copy()
            found[again] = trees.probability(columns)
        p[keep] = np.clip(found, HOPELESS, 1 - HOPELESS)
    return p


def labels_of(edges: Edges, p: Array) -> Labels:
    """Return probabilities (e,) of edges as labels of both images; what is left is no match."""
    sum_i = np.bincount(edges.i, weights=p, minlength=edges.n)
    sum_k = np.bincount(edges.k, weights=p, minlength=edges.m)
    return Labels(p, p, np.maximum(1 - sum_i, HOPELESS), np.maximum(1 - sum_k, HOPELESS))


def against_none(edges: Edges, p: Array) -> Array:
    """Return log-odds (e,) of edges against no match alone, rivals left aside, from probabilities that know of them."""
    labels = labels_of(edges, p)
    none = np.sqrt(np.maximum(labels.p_none[edges.i], LEAST_NONE) * np.maximum(labels.q_none[edges.k], LEAST_NONE))
    return np.asarray(np.log(p) - np.log(none))
