"""Are the counts right? OD pairs and turns against the truth's own tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.evaluation.bins import Counted, counted
from vtrack_batch.evaluation.blocks import Array, Score, divide
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.sides import ENDS_NOT_PLACES, Result, Truth

_GEH_GOOD = (2.0, 5.0)


def od_scores(
    result: Result, truth: Truth, names: Mapping[str, str], params: EvaluationParams
) -> dict[str, Any] | None:
    """Return the error of the OD table, GEH of its cells and the shares of unknown ends; None without a true table.

    Error = sum |found - true| / sum true over cells whose ends are both known, all bins together: the truth holds only
    what was in view. Intervals are drawn over bins, or parts of them (see ``bins``).
    """
    if truth.od_pairs.empty:
        return None
    cell = ["origin", "destination"]
    sides = (
        _by_bin(all_classes(renamed(result.od_pairs, cell, names)), cell),
        _by_bin(all_classes(truth.od_pairs), cell),
    )
    trips = _trips(renamed(result.trajectories, cell, names), cell), _trips(truth.trajectories, cell)
    both = counted(sides, trips, bin_hours(truth.od_pairs), params)
    known = ~both.cells.to_frame()[cell].isin(ENDS_NOT_PLACES).any(axis=1).to_numpy(bool)
    found, true = both.found[:, known], both.true[:, known]
    blocks, whole = both.blocks, true.sum(axis=1)
    return {
        "cells": int(known.sum()),
        "true_count": float(whole[0]),
        "found_count": float(found[0].sum()),
        "error": blocks.ratio(np.abs(found - true).sum(axis=1), whole),
        "count_ratio": blocks.ratio(found.sum(axis=1), whole),
        "unknown_share_found": blocks.ratio(both.found[:, ~known].sum(axis=1), both.found.sum(axis=1)),
        "unknown_share_true": blocks.ratio(both.true[:, ~known].sum(axis=1), both.true.sum(axis=1)),
        **_geh_scores(found, true, both),
        "table": _beside(both, known),
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
    sides = (
        _by_bin(all_classes(table), cell)
        for table in (as_arms(renamed(result.turns, cell, names)), as_arms(truth.turns))
    )
    found, true = (side[~side["movement"].isin(ENDS_NOT_PLACES)] for side in sides)
    trips = (
        _trips(renamed(result.trajectories, ["movement"], names), ["movement"]),
        _trips(truth.trajectories, ["movement"]),
    )
    both = counted((found, true), trips, bin_hours(truth.turns), params)
    f, t, blocks = both.found, both.true, both.blocks
    approach = both.cells.get_level_values("approach")
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
        **_geh_scores(f, t, both),
        "table": _beside(both, np.ones(len(both.cells), bool)),
    }


def all_classes(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of all classes together: those called ``all``, or every row where there are none such."""
    together = table[table["vehicle_class"] == "all"]
    return together if len(together) else table


def renamed(table: pd.DataFrame, columns: list[str], names: Mapping[str, str]) -> pd.DataFrame:
    """Return *table* with the places of *columns* in the truth's words."""
    return table.assign(**{name: table[name].map(lambda place: names.get(place, place)) for name in columns})


def as_arms(turns: pd.DataFrame) -> pd.DataFrame:
    """Return *turns* with approaches called by their arm."""
    return turns.assign(approach=turns["approach"].astype(object).str.removeprefix("approach_"))


def bin_hours(table: pd.DataFrame) -> pd.Series:
    """Return the observed hours by bin: the longest that any cell was observed, else the bin's length."""
    seconds = table["observed_s"].fillna(0.0).where(lambda s: s > 0, table["bin_s"].astype(float))
    return seconds.groupby(table["bin_start_utc"]).max() / 3600


def geh(found: Array, true: Array, hours: Array | float) -> Array:
    """Return Geoffrey E. Havers' GEH of hourly volumes: sqrt(2 (m - c)² / (m + c)), NaN where both are 0 (DMRB)."""
    m, c = divide(found, hours + 0 * found), divide(true, hours + 0 * true)
    return np.sqrt(divide(2 * (m - c) ** 2, m + c))


def _geh_scores(found: Array, true: Array, both: Counted) -> dict[str, Score]:
    """Return the median GEH over the cells that have vehicles, and the shares of cells below 2 and below 5."""
    values = geh(found, true, both.hours[:, None])
    used = np.isfinite(values)
    count = used.sum(axis=1).astype(float)
    middle = np.full(len(values), np.nan)
    middle[count > 0] = np.nanmedian(values[count > 0], axis=1)
    below = {
        f"geh_below_{limit:.0f}": both.blocks.ratio(((values < limit) & used).sum(axis=1).astype(float), count)
        for limit in _GEH_GOOD
    }
    return {"geh_median": both.blocks.score(middle), **below}


def _trips(trajectories: pd.DataFrame, cell: list[str]) -> pd.DataFrame:
    """Return when trips begin, with what they know of their cell."""
    trips = trajectories[[*cell, "t_start_utc"]].dropna().rename(columns={"t_start_utc": "t_utc"})
    return trips.astype({"t_utc": "datetime64[us, UTC]"})


def _by_bin(table: pd.DataFrame, cell: list[str]) -> pd.DataFrame:
    rows = table.dropna(subset=["count"])
    return rows.groupby([*cell, "bin_start_utc"], observed=True, sort=True)["count"].sum().reset_index()


def _beside(both: Counted, chosen: np.ndarray[Any, np.dtype[np.bool_]]) -> list[dict[str, Any]]:
    """Return truth beside result, one row a cell that either has."""
    values = geh(both.found[0], both.true[0], both.hours[0])
    rows = both.cells.to_frame(index=False).assign(true=both.true[0], found=both.found[0], geh=values)[chosen]
    return rows[(rows["true"] > 0) | (rows["found"] > 0)].to_dict("records")  # type: ignore[return-value]
