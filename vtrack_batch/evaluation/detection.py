"""Are the vehicles seen, and nothing else? Precision, recall, F1, and how far off the centres are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.evaluation.blocks import Blocks, Score
from vtrack_batch.evaluation.pairing import FALSE_ALARM, HIT, Paired, Scene, on_parked
from vtrack_batch.evaluation.params import EvaluationParams


def detection_scores(paired: Paired, blocks: Blocks) -> dict[str, Any]:
    """Return counts, precision, recall, F1 (each with interval) and the error of the centres found, in px."""
    hits, false = (paired.found[paired.found["verdict"] == verdict] for verdict in (HIT, FALSE_ALARM))
    wanted = paired.true[paired.true["wanted"]]
    right, wrong = blocks.totals(hits["frame"].to_numpy()), blocks.totals(false["frame"].to_numpy())
    true = blocks.totals(wanted["frame"].to_numpy())
    return {
        "true": len(wanted),
        "right": len(hits),
        "false_alarms": len(false),
        "missed": len(wanted) - len(hits),
        "neutral": int(len(paired.found) - len(hits) - len(false)),
        "precision": blocks.ratio(right, right + wrong),
        "recall": blocks.ratio(right, true),
        "f1": blocks.ratio(2 * right, right + wrong + true),
        **_centroid_errors(hits, blocks),
    }


def recall_by_stratum(paired: Paired, blocks: Blocks, params: EvaluationParams) -> dict[str, dict[str, Any]]:
    """Return the recall of moving, standing, dark and grey vehicles, as far as the truth knows them."""
    true = paired.true[paired.true["wanted"]]
    found = (true["row"] >= 0).to_numpy()
    strata = {
        "moving": true["speed_mps"] > params.moving_mps,
        "standing": true["standing_s"] > params.standing_s,
        "dark": true["luminance"] < params.dark_below,
        "grey": true["luminance"].between(params.grey_from, params.grey_to),
    }
    return {name: _recall(true, found, rows.to_numpy(bool), blocks) for name, rows in strata.items() if rows.any()}


def parked_found(paired: Paired, scene: Scene, blocks: Blocks, params: EvaluationParams) -> dict[str, Any]:
    """Return the share of parked cars in view that were found: no fault, and no merit of a moving-vehicle detector."""
    _, covered = on_parked(paired.found, scene, params)
    return _recall(scene.parked, covered, np.ones(len(covered), bool), blocks)


def _recall(
    true: pd.DataFrame, found: NDArray[np.bool_], rows: NDArray[np.bool_], blocks: Blocks
) -> dict[str, int | Score]:
    frame = true["frame"].to_numpy()[rows]
    return {"true": int(rows.sum()), "recall": blocks.ratio(blocks.totals(frame, found[rows]), blocks.totals(frame))}


def _centroid_errors(hits: pd.DataFrame, blocks: Blocks) -> dict[str, Score]:
    frame, distance = hits["frame"].to_numpy(), hits["distance_px"].to_numpy(float)
    mean_square = blocks.totals(frame, distance**2) / np.where(counts := blocks.totals(frame), counts, np.nan)
    return {
        "centroid_error_median_px": blocks.quantile(frame, distance),
        "centroid_error_rms_px": blocks.score(np.sqrt(mean_square)),
    }
