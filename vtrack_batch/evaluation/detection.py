"""Are the vehicles seen, and nothing else? Precision, recall, F1, and how far off the centres are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.evaluation.blocks import Blocks, Score, divide
from vtrack_batch.evaluation.pairing import FALSE_ALARM, HIT, Paired, on_parked
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.scene import Scene


def detection_scores(paired: Paired, blocks: Blocks, *, placed: bool = True) -> dict[str, Any]:
    """Return counts, precision, recall, F1 (each with interval) and, if *placed*, the error of the centres found."""
    hits, false = (paired.found[paired.found["verdict"] == verdict] for verdict in (HIT, FALSE_ALARM))
    wanted = paired.true[paired.true["wanted"]]
    right, wrong = blocks.totals(hits["frame"].to_numpy()), blocks.totals(false["frame"].to_numpy())
    true = blocks.totals(wanted["frame"].to_numpy())
    errors = _centroid_errors(hits, paired.unit, blocks) if placed else {}
    if placed and paired.unit == "px":
        errors |= _ground_errors(hits, paired, blocks)
    return {
        "true": len(wanted),
        "right": len(hits),
        "false_alarms": len(false),
        "missed": len(wanted) - len(hits),
        "neutral": int(len(paired.found) - len(hits) - len(false)),
        "precision": blocks.ratio(right, right + wrong),
        "recall": blocks.ratio(right, true),
        "f1": blocks.ratio(2 * right, right + wrong + true),
        **errors,
    }


def recall_by_stratum(
    paired: Paired, blocks: Blocks, params: EvaluationParams, *, m_per_px: float
) -> dict[str, dict[str, Any]]:
    """Return recall and centroid error of kinds of vehicles, as far as the truth knows them.

    Precision has no strata: a false alarm is no vehicle, so it is neither dark nor standing.
    """
    true = paired.true[paired.true["wanted"]]
    gap_m = true["gap_m"].astype(float).fillna(m_per_px * true["gap_px"].astype(float))
    strata = {
        "moving": true["speed_mps"] > params.moving_mps,
        "standing": true["standing_s"] > params.standing_s,
        "creeping": true["motion"] == "creeper",
        "parked": true["motion"] == "parked",
        "touching": gap_m < params.touching_gap_m,
        "dark": true["luminance"] < params.dark_below,
        "grey": true["luminance"].between(params.grey_from, params.grey_to),
        "shadowed": true["shadowed"].fillna(0).astype(float) > 0,
    }
    return {name: _stratum(paired, true[rows], blocks) for name, rows in strata.items() if rows.any()}


def parked_found(paired: Paired, scene: Scene, blocks: Blocks, params: EvaluationParams) -> dict[str, Any]:
    """Return the share of parked cars in view that were found: no fault, and no merit of a moving-vehicle detector."""
    _, covered = on_parked(paired.found, scene, params)
    return {"true": len(covered), "recall": _recall(scene.parked, covered, blocks)}


def _stratum(paired: Paired, true: pd.DataFrame, blocks: Blocks) -> dict[str, Any]:
    found = (true["row"] >= 0).to_numpy()
    hits = paired.found.iloc[true["row"].to_numpy()[found]]
    return {
        "true": len(true),
        "recall": _recall(true, found, blocks),
        **_centroid_errors(hits, paired.unit, blocks),
    }


def _recall(true: pd.DataFrame, found: NDArray[np.bool_], blocks: Blocks) -> Score:
    frame = true["frame"].to_numpy()
    return blocks.ratio(blocks.totals(frame, found), blocks.totals(frame))


def _centroid_errors(hits: pd.DataFrame, unit: str, blocks: Blocks) -> dict[str, Score]:
    frame, distance = hits["frame"].to_numpy(), hits["distance"].to_numpy(float)
    return {
        f"centroid_error_median_{unit}": blocks.quantile(frame, distance),
        f"centroid_error_rms_{unit}": _rms(frame, distance**2, blocks),
    }


def _ground_errors(hits: pd.DataFrame, paired: Paired, blocks: Blocks) -> dict[str, Score]:
    """Return the same on the ground, where the truth knows it: here errors of registration enter."""
    off = hits[["x_m", "y_m"]].to_numpy(float) - paired.true.iloc[hits["row"]][["x_m", "y_m"]].to_numpy(float)
    known = np.isfinite(off).all(axis=1)
    if not known.any():
        return {}
    frame, off = hits["frame"].to_numpy()[known], off[known]
    count = blocks.totals(frame)
    return {
        "ground_error_median_m": blocks.quantile(frame, np.hypot(*off.T)),
        "ground_error_rms_m": _rms(frame, (off**2).sum(axis=1), blocks),
        "ground_bias_x_m": blocks.ratio(blocks.totals(frame, off[:, 0]), count),
        "ground_bias_y_m": blocks.ratio(blocks.totals(frame, off[:, 1]), count),
    }


def _rms(frame: NDArray[np.int64], square: NDArray[np.float64], blocks: Blocks) -> Score:
    return blocks.score(np.sqrt(divide(blocks.totals(frame, square), blocks.totals(frame))))
