"""Are the counts right? OD pairs and turns against the truth's own tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.evaluation.blocks import Array, Blocks, divide, draw_blocks
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.sides import ENDS_NOT_PLACES, Result, Truth

_GEH_GOOD = 5.0


def od_scores(
    result: Result, truth: Truth, names: Mapping[str, str], params: EvaluationParams
) -> dict[str, Any] | None:
    """Return the error of the OD table, GEH of its cells and the shares of unknown ends; None without a true table.

    Error = sum |found - true| / sum true over cells whose ends are both known, all bins together: the truth holds only
    what was in view. Bins are the blocks of the interval; a single bin has none.
    """
    if truth.od_pairs.empty:
        return None
    cell = ["origin", "destination"]
    found, true = (_by_bin(_all_classes(table), cell) for table in (result.od_pairs, truth.od_pairs))
    found = found.assign(**{end: found[end].map(lambda place: names.get(place, place)) for end in cell})
    known = [table[~table[cell].isin(ENDS_NOT_PLACES).any(axis=1)] for table in (found, true)]
    blocks, counts = _counts(known[0], known[1], cell, params)
    error, whole = np.abs(blocks.draws @ (counts[0] - counts[1])).sum(axis=1), (blocks.draws @ counts[1]).sum(axis=1)
    total = [float(table["count"].sum()) for table in (found, true)]
    in_known = [float(table["count"].sum()) for table in known]
    geh = _geh(counts[0].sum(axis=0), counts[1].sum(axis=0), _hours(truth.od_pairs))
    return {
        "cells": int(counts[0].shape[1]),
        "true_count": in_known[1],
        "found_count": in_known[0],
        "error": blocks.ratio(error, whole),
        "count_ratio": blocks.ratio((blocks.draws @ counts[0]).sum(axis=1), whole),
        "unknown_share_found": 1 - in_known[0] / total[0] if total[0] else None,
        "unknown_share_true": 1 - in_known[1] / total[1] if total[1] else None,
        "geh_median": float(np.median(geh)) if len(geh) else None,
        "geh_below_5_share": float(np.mean(geh < _GEH_GOOD)) if len(geh) else None,
        "table": _beside(_cells(known[0], known[1], cell), counts[0].sum(axis=0), counts[1].sum(axis=0)),
    }


def turn_scores(
    result: Result, truth: Truth, names: Mapping[str, str], params: EvaluationParams
) -> dict[str, Any] | None:
    """Return the error of turning counts and of turning shares; None without a true table.

    Share error: |found share - true share| of each movement of an approach, weighted by the approach's true vehicles.
    Unknown movements are left out on both sides. Junctions are not compared by name, since proposed ones have none:
    approach and movement say enough, and an approach may be called by its arm: ``approach_N`` or ``N``.
    """
    if truth.turns.empty:
        return None
    cell = ["approach", "movement"]
    found, true = (_by_bin(_all_classes(table), cell) for table in (result.turns, truth.turns))
    found = found.assign(**{part: found[part].map(lambda place: names.get(place, place)) for part in cell})
    found, true = (
        table[~table["movement"].isin(ENDS_NOT_PLACES)].assign(approach=table["approach"].str.removeprefix("approach_"))
        for table in (found, true)
    )
    blocks, (f, t) = _counts(found, true, cell, params)
    f, t = blocks.draws @ f, blocks.draws @ t
    approach = _cells(found, true, cell).get_level_values("approach")
    same = (approach.to_numpy()[:, None] == approach.to_numpy()).astype(float)
    weight = t @ same
    shares = divide(f, f @ same), divide(t, weight)
    off = np.abs(np.nan_to_num(shares[0]) - np.nan_to_num(shares[1])) * t.astype(bool).astype(float)
    size = np.where(t > 0, weight, 0.0)
    return {
        "true_count": float(t[0].sum()),
        "found_count": float(f[0].sum()),
        "count_error": blocks.ratio(np.abs(f - t).sum(axis=1), t.sum(axis=1)),
        "share_error": blocks.ratio((off * size).sum(axis=1), size.sum(axis=1)),
        "table": _beside(_cells(found, true, cell), f[0], t[0]),
    }


def _all_classes(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of all classes together: those called ``all``, or every row where there are none such."""
    together = table[table["vehicle_class"] == "all"]
    return together if len(together) else table


def _by_bin(table: pd.DataFrame, cell: list[str]) -> pd.DataFrame:
    rows = table.dropna(subset=["count"])
    return rows.groupby([*cell, "bin_start_utc"], observed=True, sort=True)["count"].sum().reset_index()


def _cells(found: pd.DataFrame, true: pd.DataFrame, cell: list[str]) -> pd.MultiIndex:
    return pd.MultiIndex.from_frame(pd.concat([found[cell], true[cell]]).drop_duplicates().sort_values(cell))


def _beside(cells: pd.MultiIndex, found: Array, true: Array) -> list[dict[str, Any]]:
    """Return truth beside result, one row a cell that either has."""
    rows = cells.to_frame(index=False).assign(true=true, found=found)
    return rows[(rows["true"] > 0) | (rows["found"] > 0)].to_dict("records")  # type: ignore[return-value]


def _counts(
    found: pd.DataFrame, true: pd.DataFrame, cell: list[str], params: EvaluationParams
) -> tuple[Blocks, tuple[Array, Array]]:
    """Return blocks that are the bins, and the counts (bins, cells) of both sides."""
    cells = _cells(found, true, cell)
    bins = pd.Index(pd.concat([found["bin_start_utc"], true["bin_start_utc"]]).drop_duplicates().sort_values())
    counts = []
    for table in (found, true):
        grid = np.zeros((max(1, len(bins)), len(cells)))
        where = bins.get_indexer(table["bin_start_utc"]), cells.get_indexer(pd.MultiIndex.from_frame(table[cell]))
        np.add.at(grid, where, table["count"].to_numpy(float))
        counts.append(grid)
    draws = draw_blocks(max(1, len(bins)), params)
    return Blocks(np.arange(max(1, len(bins))), draws, float("nan")), (counts[0], counts[1])


def _hours(table: pd.DataFrame) -> float:
    """Return the observed time in hours: over the bins, the longest that any cell was observed."""
    seconds = table["observed_s"].fillna(0.0).where(lambda s: s > 0, table["bin_s"].astype(float))
    return float(seconds.groupby(table["bin_start_utc"]).max().sum()) / 3600


def _geh(found: Array, true: Array, hours: float) -> Array:
    """Return Geoffrey E. Havers' statistic of hourly volumes per cell: sqrt(2 (m - c)² / (m + c)) (DMRB)."""
    m, c = found / hours, true / hours
    used = (m + c) > 0
    return np.asarray(np.sqrt(2 * (m - c)[used] ** 2 / (m + c)[used]))
