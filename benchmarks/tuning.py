"""Tune peers: for every scene and interval the best of a grid, by truth, on labelled traffic of other seeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.methods import Peer, Setting, run_on
from benchmarks.traffic import PAIRS_EVERY_S, labelled_pairs, labelled_sequence
from benchmarks.work import identity, label_rates, links_of, pairs_as_sightings, sequences_as_sightings

SEEDS = range(101, 102)
PAIRS = {"road": 8, "congested": 6, "crossing": 8, "grid": 2}  # of each interval, and of either share missed
Index = NDArray[np.int64]


@cache
def training_pairs(scene: str, intervals_s: tuple[float, ...]) -> pd.DataFrame:
    """Return pairs of other seeds at all *intervals_s*, half of them with 10 % missed."""
    cells = [
        labelled_pairs(scene, SEEDS, elapsed_s, missed, each=PAIRS[scene])
        for elapsed_s in intervals_s
        for missed in (0.0, 0.1)
    ]
    return joined([pairs_as_sightings(cell) for cell in cells])


@cache
def training_sequences(scene: str, cells: tuple[tuple[float, float], ...], share: float = 1.0) -> pd.DataFrame:
    """Return the first 90 s (grid 45 s) of another seed, or a *share* of that, for each (interval, share missed)."""
    driven_s, seconds = PAIRS_EVERY_S * PAIRS[scene] + 10, share * (45 if scene == "grid" else 90)
    return joined(
        [
            sequences_as_sightings(labelled_sequence(scene, SEEDS[0], *cell, driven_s=driven_s, seconds=seconds))
            for cell in cells
        ]
    )


def joined(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return tables of sightings as one; sequences are numbered anew, 1,000,000 further in each table."""
    moved = [table.assign(sequence=table["sequence"] + 1_000_000 * n) for n, table in enumerate(tables)]
    return pd.concat(moved, ignore_index=True)


def pair_scores(rows: pd.DataFrame, track: Index) -> pd.DataFrame:
    """Return the label rates of pairs linked by tracks: ``sequence, image_1, image_2, pooled, links, right``."""
    linked = []
    for name, pair in rows.groupby("sequence"):
        i, k = links_of(track[pair.index], pair["frame"].to_numpy())
        linked.append(pd.DataFrame({"sequence": name, "i": i, "k": k}))
    return link_scores(rows, pd.concat(linked, ignore_index=True))


def link_scores(rows: pd.DataFrame, links: pd.DataFrame) -> pd.DataFrame:
    """Return the label rates of pairs by their links ``sequence, i, k``."""
    found = dict(list(links.groupby("sequence")))
    scores = []
    for name, pair in rows.groupby("sequence"):
        truth = [pair.loc[pair["frame"] == f, "truth"].to_numpy() for f in (0, 1)]
        of = found.get(name, links[:0])
        i, k = of["i"].to_numpy(), of["k"].to_numpy()
        right = int((truth[0][i] == truth[1][k]).sum())
        both = len(np.intersect1d(*truth))
        scores.append((name, *label_rates(*truth, i, k), len(i), right, both))
    return pd.DataFrame(scores, columns=["sequence", "image_1", "image_2", "pooled", "links", "right", "true_links"])


def tuned(
    peer: Peer,
    rows: pd.DataFrame,
    grid: Sequence[Setting],
    score: Callable[[pd.DataFrame, Index], pd.Series],
    *,
    limit_s: float = 10.0,
) -> dict[float, int]:
    """Return for each interval the number of the setting with the greatest mean *score* on training rows.

    *score* (rows, track) is a value for each sequence; settings too slow for *limit_s* a sequence are passed over.
    """
    tracks, _ = run_on(peer, rows, grid, limit_s)
    interval_s = rows.groupby("sequence")["interval_s"].first()
    means = pd.DataFrame([score(rows, track).groupby(interval_s).mean() for track in tracks])
    return {float(s): int(column.to_numpy().argmax()) for s, column in means.items()}


def with_settings(rows: pd.DataFrame, best: Mapping[float, int]) -> pd.DataFrame:
    """Return rows with the number of the setting that is best for their interval."""
    return rows.assign(setting=rows["interval_s"].map(best))


def pooled(rows: pd.DataFrame, track: Index) -> pd.Series:
    """Return the pooled label rate of each pair."""
    return pair_scores(rows, track).set_index("sequence")["pooled"]


def idf1(rows: pd.DataFrame, track: Index) -> pd.Series:
    """Return IDF1 of each sequence."""
    return pd.Series(
        {name: identity(of["truth"].to_numpy(), track[of.index])["idf1"] for name, of in rows.groupby("sequence")}
    )
