"""Measure a result against a truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vtrack_batch.evaluation.blocks import Blocks, time_blocks
from vtrack_batch.evaluation.detection import detection_scores, parked_found, recall_by_stratum
from vtrack_batch.evaluation.frames import joined_frames
from vtrack_batch.evaluation.links import link_scores
from vtrack_batch.evaluation.page import page
from vtrack_batch.evaluation.pairing import Paired, Scene, make_scene, pair, sightings
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.places import place_names
from vtrack_batch.evaluation.sides import Result, Truth
from vtrack_batch.evaluation.speeds import speed_scores
from vtrack_batch.evaluation.tracks import track_scores
from vtrack_batch.evaluation.traffic import od_scores, turn_scores


@dataclass(frozen=True)
class Evaluation:
    """How a result compares with a truth: ``numbers`` nests plain dicts and numbers, ready for JSON.

    A score is ``{"value", "lo", "hi"}`` with its 95 % interval; None where it is not defined.
    """

    numbers: dict[str, Any]

    def text(self) -> str:
        """Return the numbers as a page for people."""
        return page(self.numbers)


def evaluate(result: Result, truth: Truth, *, params: EvaluationParams = EvaluationParams()) -> Evaluation:  # noqa: B008
    """Measure *result* against *truth*: detection, links, tracks, OD pairs, turns and speeds.

    Order of rows changes nothing. Raises ``UnusableData`` when they have no frame in common.
    """
    frames, remarks = joined_frames(result, truth)
    blocks = time_blocks(frames["t_s"].to_numpy(float), params)
    scene = make_scene(truth, frames, params)
    seen = sightings(result, frames)
    on_tracks = seen[seen["vehicle_id"].notna()]
    if truth.scores_movers:
        moving = on_tracks[on_tracks["net_shift_m"] > params.moving_net_shift_m]
        tracked = pair(moving, scene, params, movers_only=True)
        detection, linkable = _of_movers(tracked, pair(on_tracks, scene, params), blocks), tracked
    else:
        linkable = pair(seen, scene, params)
        tracked = pair(on_tracks, scene, params)
        detection = _of_all(linkable, tracked, scene, blocks, params)
    names = place_names(result, truth, tracked)
    if renamed := {found: true for found, true in names.items() if found != true}:
        remarks.append("places named by majority of true ends: " + ", ".join(f"{a} = {b}" for a, b in renamed.items()))
    if blocks.length_s < params.block_s:
        remarks.append(
            f"blocks of {blocks.length_s:.1f} s instead of {params.block_s:g} s: intervals may be too narrow"
        )
    return Evaluation(
        {
            "layout": truth.layout,
            "frames": _frame_counts(result, frames, blocks),
            "detection": detection,
            "links": link_scores(linkable, frames, blocks),
            "tracks": track_scores(tracked, blocks, params),
            "od": od_scores(result, truth, names, params),
            "turns": turn_scores(result, truth, names, params),
            "speeds": speed_scores(tracked, blocks, params),
            "place_names": renamed,
            "remarks": remarks,
        }
    )


def _of_movers(movers: Paired, everything: Paired, blocks: Blocks) -> dict[str, Any]:
    """Scores after tracking: moving tracks against movers, and all tracks against all vehicles."""
    return {"movers": detection_scores(movers, blocks), "all_tracked": detection_scores(everything, blocks)}


def _of_all(seen: Paired, tracked: Paired, scene: Scene, blocks: Blocks, params: EvaluationParams) -> dict[str, Any]:
    """Scores of all detections, and of those on tracks."""
    numbers: dict[str, Any] = {"detections": detection_scores(seen, blocks)}
    numbers["detections"]["strata"] = recall_by_stratum(seen, blocks, params)
    if len(scene.parked):
        numbers["detections"]["parked"] = parked_found(seen, scene, blocks, params)
    return numbers | {"tracked": detection_scores(tracked, blocks)}


def _frame_counts(result: Result, frames: Any, blocks: Blocks) -> dict[str, Any]:
    used = set(result.frames.loc[result.frames["status"] == "used", "frame_id"])
    return {
        "scored": len(frames),
        "not_used_by_the_run": int((~frames["frame_id"].isin(used)).sum()),
        "blocks": int(blocks.draws.shape[1]),
        "block_s": float(np.round(blocks.length_s, 3)),
    }
