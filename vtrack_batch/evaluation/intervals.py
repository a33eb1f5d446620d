"""Are stated intervals true? How many of the 95 % intervals of counts hold the true count."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.evaluation.blocks import Blocks, draw_blocks
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.sides import ENDS_NOT_PLACES, Result, Truth
from vtrack_batch.evaluation.traffic import all_classes, as_arms, renamed

_KEYS = {
    "od_pairs": ["origin", "destination", "bin_start_utc"],
    "turns": ["approach", "movement", "bin_start_utc"],
    "flows": ["place", "bin_start_utc"],
}


def interval_scores(
    result: Result, truth: Truth, names: Mapping[str, str], params: EvaluationParams
) -> dict[str, dict[str, Any] | None]:
    """Return, per table of counts, how often ``count_lo`` to ``count_hi`` holds the true count; None without truth.

    One row a cell and bin, of all classes together, that the result observed; a cell that the truth does not name has a
    true count of 0. Flows of gates are compared with the truth's crossings where it has no flows. Cells with an unknown
    end are left out. Drawn over bins.
    """
    sides = {
        "od_pairs": (renamed(result.od_pairs, ["origin", "destination"], names), truth.od_pairs),
        "turns": (as_arms(renamed(result.turns, ["approach", "movement"], names)), as_arms(truth.turns)),
        "flows": (result.flows, _true_flows(result.flows, truth)),
    }
    return {name: _covered(*sides[name], key, params) for name, key in _KEYS.items()}


def _covered(
    found: pd.DataFrame, true: pd.DataFrame, key: list[str], params: EvaluationParams
) -> dict[str, Any] | None:
    if true.empty or found.empty:
        return None
    observed = all_classes(found).dropna(subset=["count"])
    observed = observed[~observed[key].isin(ENDS_NOT_PLACES).any(axis=1)]
    if "place" in key:  # the truth may know only some of the places, such as gates
        observed = observed[observed["place"].isin(set(true["place"]))]
    # places of the result that go by one true name cannot share an interval
    observed = observed[~observed.duplicated(key, keep=False)]
    counts = all_classes(true).groupby(key, observed=True)["count"].sum().rename("true_count").reset_index()
    rows = observed.astype({name: object for name in key if name != "bin_start_utc"}).merge(counts, on=key, how="left")
    rows["true_count"] = rows["true_count"].fillna(0.0)
    rows = rows.sort_values(key)
    stated = rows.dropna(subset=["count_lo", "count_hi"])
    if rows.empty:
        return None
    if stated.empty:
        return {"counts": len(rows), "with_interval": 0}
    block = pd.factorize(stated["bin_start_utc"], sort=True)[0].astype(np.int64)
    bins = int(block.max(initial=0)) + 1
    blocks = Blocks(np.arange(bins), draw_blocks(bins, params), float("nan"))
    low, high, count = (stated[name].to_numpy(float) for name in ("count_lo", "count_hi", "true_count"))
    total = blocks.totals(block)
    sizes = {"counts": len(rows), "with_interval": len(stated)}
    return sizes | {
        "coverage": blocks.ratio(blocks.totals(block, (low <= count) & (count <= high)), total),
        "too_low": blocks.ratio(blocks.totals(block, high < count), total),
        "too_high": blocks.ratio(blocks.totals(block, low > count), total),
        "mean_width": blocks.ratio(blocks.totals(block, high - low), total),
    }


def _true_flows(found: pd.DataFrame, truth: Truth) -> pd.DataFrame:
    """Return true counts by place and bin: the truth's own flows, else its crossings of the gates that have flows."""
    if len(truth.flows) or truth.crossings.empty or found.empty:
        return truth.flows
    bins = found[["bin_start_utc", "bin_s"]].drop_duplicates().sort_values("bin_start_utc")
    at = np.searchsorted(bins["bin_start_utc"], truth.crossings["t_utc"], side="right") - 1
    begin, length = bins["bin_start_utc"].to_numpy()[at], bins["bin_s"].to_numpy(float)[at]
    after_s = (truth.crossings["t_utc"].to_numpy() - begin) / np.timedelta64(1, "s")
    inside = (at >= 0) & (after_s < length)
    crossed = pd.DataFrame({"place": truth.crossings["gate"], "bin_start_utc": bins["bin_start_utc"].array[at]})[inside]
    crossed = crossed.groupby(["place", "bin_start_utc"]).size().rename("count").reset_index()
    return crossed.assign(vehicle_class="all")
