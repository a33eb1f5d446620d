"""Is the next sighting of a track the same vehicle? Links over consecutive frames, and the pooled label rate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.evaluation.assignment import Index
from vtrack_batch.evaluation.blocks import Blocks, Score
from vtrack_batch.evaluation.pairing import FALSE_ALARM, Paired

NOBODY = -1


def link_scores(paired: Paired, frames: pd.DataFrame, blocks: Blocks) -> dict[str, Any]:
    """Return precision of the links made, recall of the links that could be made, and the pooled label rate.

    A *link* joins two sightings of one track in consecutive frames. Precision is of links made, unless both ends lie on
    parked vehicles or one end is nothing that can be judged (on the border, in an ignored box);
    ``precision_between_vehicles`` is of those with both ends on moving vehicles, so that false alarms are not counted
    again. Recall is of pairs of sightings of one vehicle in consecutive frames, both found.
    """
    found = with_names(paired)
    next_frame = following(frames)
    made = _steps(found.dropna(subset=["vehicle_id"]), "vehicle_id", next_frame)
    true = _steps(found.dropna(subset=["vehicle"]), "vehicle", next_frame)
    judged = (made["name"] != "") & (made["name_next"] != "") & ~(made["parked"] & made["parked_next"])
    scored = made[judged]
    between = scored[(scored["vehicle"].notna() & scored["vehicle_next"].notna()).to_numpy(bool)]
    joined = true["vehicle_id"].notna() & (true["vehicle_id"] == true["vehicle_id_next"])
    partner = np.full(len(found), NOBODY)
    partner[made["at"]] = made["at_next"]
    before = np.full(len(found), NOBODY)
    before[made["at_next"]] = made["at"]
    return {
        "made": len(scored),
        "right": int((between["name"] == between["name_next"]).sum()),
        "could_be_made": len(true),
        "could_be_made_and_were": int(joined.sum()),
        "precision": _share(scored, scored["name"] == scored["name_next"], blocks),
        "precision_between_vehicles": _share(between, between["name"] == between["name_next"], blocks),
        "recall": _share(true, joined, blocks),
        "label_rate": label_rates(found, partner, before, next_frame, blocks)["label_rate"],
    }


def with_names(paired: Paired) -> pd.DataFrame:
    """Return the sightings with ``vehicle`` on movers only, ``parked`` (on any other vehicle), ``name``, and ``at``.

    The name is the vehicle's, one of its own for each false alarm, or nothing where the sighting cannot be judged;
    ``at`` is the number of the row.
    """
    found = paired.found.assign(at=np.arange(len(paired.found)))
    row = found["row"].to_numpy()
    mover = (row >= 0) & (paired.true["motion"].to_numpy(object)[row] == "mover") if len(paired.true) else row >= 0
    found["parked"] = ((row >= 0) & ~mover) | found["on_parked"]
    false_alarm = (found["verdict"] == FALSE_ALARM).to_numpy()
    own = found["at"].astype(str)
    found["name"] = np.select(
        [row >= 0, found["on_parked"], false_alarm],
        ["vehicle " + found["vehicle"].astype(str), "parked car " + own, "false alarm " + own],
        "",
    )
    found["vehicle"] = found["vehicle"].where(mover, None)
    return found


def following(frames: pd.DataFrame) -> Index:
    """Return for each frame the index of the next one of its sequence, -1 at the end."""
    sequence = frames["sequence"].to_numpy()
    last = np.r_[sequence[1:] != sequence[:-1], True] if len(sequence) else np.empty(0, bool)
    return np.where(last, -1, np.arange(len(sequence)) + 1)


def label_rates(
    found: pd.DataFrame, partner: Index, before: Index, next_frame: Index, blocks: Blocks
) -> dict[str, Score]:
    """Return the share of sightings whose partner is named rightly, *no partner* being a name as well (the paper).

    *found* as ``with_names`` gives it; *partner*, *before* (n,): the sighting that each was given in the next frame and
    in the one before, -1 = none. Over all sightings that have such a frame and can be judged: of the earlier image of
    each pair (``label_rate_earlier``), of the later one, and of both pooled.
    """
    scored = found[(found["name"] != "") & ~found["parked"]]
    frame, at = scored["frame"].to_numpy(int), scored["at"].to_numpy(int)
    true = _steps(found.dropna(subset=["vehicle"]), "vehicle", next_frame)
    earlier_frame = np.full(len(next_frame), -1)
    earlier_frame[next_frame[next_frame >= 0]] = np.flatnonzero(next_frame >= 0)
    sums = {}
    for image, given, other, here, there in (
        ("earlier", partner, next_frame, "at", "at_next"),
        ("later", before, earlier_frame, "at_next", "at"),
    ):
        really = np.full(len(found), NOBODY)
        really[true[here]] = true[there]
        counted = other[frame] >= 0
        pair_frame = np.minimum(frame, other[frame])[counted]
        right = (given[at] == really[at])[counted]
        sums[image] = blocks.totals(pair_frame, right), blocks.totals(pair_frame)
    pooled = [sums["earlier"][k] + sums["later"][k] for k in (0, 1)]
    return {
        "label_rate": blocks.ratio(*pooled),
        "label_rate_earlier": blocks.ratio(*sums["earlier"]),
        "label_rate_later": blocks.ratio(*sums["later"]),
    }


def _steps(found: pd.DataFrame, by: str, next_frame: Index) -> pd.DataFrame:
    """Return pairs of sightings with equal *by* in consecutive frames; the later one's columns end in ``_next``."""
    earlier = found.assign(frame_next=next_frame[found["frame"].to_numpy(int)])
    later = found[["frame", by, *(c for c in ("vehicle", "vehicle_id", "name", "at", "parked") if c != by)]]
    later = later.rename(columns={c: f"{c}_next" for c in later.columns if c != by})
    steps = earlier.merge(later, on=[by, "frame_next"], how="inner")
    return steps.assign(**{f"{by}_next": steps[by]})


def _share(steps: pd.DataFrame, right: pd.Series, blocks: Blocks) -> Score:
    frame = steps["frame"].to_numpy()
    return blocks.ratio(blocks.totals(frame, right.to_numpy(float)), blocks.totals(frame))
