"""Measure a result against a truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.evaluation.blocks import Blocks, time_blocks
from vtrack_batch.evaluation.classes import class_scores
from vtrack_batch.evaluation.detection import detection_scores, parked_found, recall_by_stratum
from vtrack_batch.evaluation.frames import joined_frames
from vtrack_batch.evaluation.intervals import interval_scores
from vtrack_batch.evaluation.links import link_scores
from vtrack_batch.evaluation.matches import match_scores
from vtrack_batch.evaluation.page import markdown, page
from vtrack_batch.evaluation.pairing import Paired, pair, pair_by_id
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.places import place_names
from vtrack_batch.evaluation.scene import Scene, ground_scale, make_scene, plane_of, sightings
from vtrack_batch.evaluation.sides import Result, Truth
from vtrack_batch.evaluation.speeds import speed_scores
from vtrack_batch.evaluation.tracks import identity_calibration, track_scores
from vtrack_batch.evaluation.traffic import od_scores, turn_scores


@dataclass(frozen=True)
class Evaluation:
    """How a result compares with a truth: ``numbers`` nests plain dicts and numbers, ready for JSON.

    A score is ``{"value", "lo", "hi"}`` with its 95 % interval; None where it is not defined.
    """

    numbers: dict[str, Any]

    def text(self) -> str:
        """Return the numbers as a page for terminals, what matters most at its end."""
        return page(self.numbers)

    def markdown(self) -> str:
        """Return the numbers as a page for reading."""
        return markdown(self.numbers)


@dataclass(frozen=True)
class _Sides:
    """Both sides brought together: what the scores are made from.

    ``seen``: all sightings. ``tracked``: those on tracks; of a truth with parked vehicles, on tracks that move, and
    against movers. ``linked``: whose links are scored. ``all_tracked``: on any track, against all vehicles.
    """

    scene: Scene
    seen: Paired
    tracked: Paired
    linked: Paired
    all_tracked: Paired


def evaluate(result: Result, truth: Truth, *, params: EvaluationParams = EvaluationParams()) -> Evaluation:  # noqa: B008
    """Measure *result* against *truth*: detection, links, tracks, traffic, speeds, and what it says of its own doubts.

    Order of rows changes nothing. Raises ``UnusableData`` when they have no frame in common.
    """
    if truth.layout == "pair":
        result = replace(result, matches=_of_images(result.matches))
    frames, remarks = joined_frames(result, truth)
    blocks = time_blocks(frames["t_s"].to_numpy(float), params)
    sides = _sides(result, truth, frames, params)
    names = place_names(result, truth, sides.tracked)
    if renamed := {found: true for found, true in names.items() if found != true}:
        remarks.append("places named by majority of true ends: " + ", ".join(f"{a} = {b}" for a, b in renamed.items()))
    if blocks.length_s < params.block_s:
        remarks.append(
            f"blocks of {blocks.length_s:.1f} s instead of {params.block_s:g} s: intervals may be too narrow"
        )
    numbers = {
        "layout": truth.layout,
        "frames": _frame_counts(result, frames, blocks),
        "detection": _detection(result, truth, sides, blocks, params),
        "links": link_scores(sides.linked, frames, blocks) if result.tracked else None,
        "matches": match_scores(result, sides.seen, frames, blocks, params),
        "tracks": None,
        "od": od_scores(result, truth, names, params) if result.counted else None,
        "turns": turn_scores(result, truth, names, params) if result.counted else None,
        "count_intervals": interval_scores(result, truth, names, params) if result.counted else None,
        "speeds": speed_scores(sides.tracked, blocks, params) if result.tracked else None,
        "place_names": renamed,
        "remarks": remarks,
    }
    if result.tracked:
        numbers["tracks"] = {
            **track_scores(sides.tracked, blocks, params),
            "classes": class_scores(result, truth, sides.tracked, blocks),
            "identity_calibration": identity_calibration(result, sides.all_tracked, blocks, params),
        }
    return Evaluation(numbers)


def _sides(result: Result, truth: Truth, frames: pd.DataFrame, params: EvaluationParams) -> _Sides:
    """Match sightings with vehicles, in one plane or by the ids that both share."""
    plane = plane_of(result, truth)
    scene = make_scene(truth, frames, plane, params, detected_only=result.borrowed)
    found = sightings(result, truth, frames, plane)
    on_tracks = found[found["vehicle_id"].notna()]
    if result.borrowed:
        seen, tracked = pair_by_id(found, scene), pair_by_id(on_tracks, scene)
        return _Sides(scene, seen, tracked, seen, tracked)
    seen, all_tracked = pair(found, scene, params), pair(on_tracks, scene, params)
    if not truth.scores_movers:
        return _Sides(scene, seen, all_tracked, seen, all_tracked)
    moving = on_tracks[on_tracks["net_shift_m"] > params.moving_net_shift_m]
    tracked = pair(moving, scene, params, movers_only=True)
    return _Sides(scene, seen, tracked, tracked, all_tracked)


def _detection(
    result: Result, truth: Truth, sides: _Sides, blocks: Blocks, params: EvaluationParams
) -> dict[str, Any] | None:
    """Return scores of all detections and of those on tracks; of a truth with parked vehicles, of movers and of all."""
    if truth.scores_movers:
        numbers = {"movers": detection_scores(sides.tracked, blocks)}
        numbers["all_tracked"] = detection_scores(sides.all_tracked, blocks)
        numbers["all_tracked"]["strata"] = recall_by_stratum(sides.all_tracked, blocks, params, m_per_px=np.nan)
        return numbers
    numbers = {}
    if not result.borrowed:
        numbers["detections"] = detection_scores(sides.seen, blocks)
        scale = ground_scale(result.detections)
        numbers["detections"]["strata"] = recall_by_stratum(sides.seen, blocks, params, m_per_px=scale)
        if len(sides.scene.parked):
            numbers["detections"]["parked"] = parked_found(sides.seen, sides.scene, blocks, params)
    if result.tracked:
        numbers["tracked"] = detection_scores(sides.tracked, blocks, placed=not result.borrowed)
    return numbers or None


def _of_images(matches: pd.DataFrame) -> pd.DataFrame:
    """Return the matches of a pair with ids told apart by their image, as the truth of a pair has them."""
    ends = {"detection_id_from": "1/", "detection_id_to": "2/"}
    return matches.assign(
        **{name: (image + matches[name]).where(matches[name].notna(), None) for name, image in ends.items()}
    )


def _frame_counts(result: Result, frames: pd.DataFrame, blocks: Blocks) -> dict[str, Any]:
    used = set(result.frames.loc[result.frames["status"] == "used", "frame_id"])
    return {
        "scored": len(frames),
        "not_used_by_the_run": 0 if result.borrowed else int((~frames["frame_id"].isin(used)).sum()),
        "blocks": int(blocks.draws.shape[1]),
        "block_s": float(np.round(blocks.length_s, 3)),
    }
