"""Is the next sighting of a track the same vehicle? Links over consecutive frames, and the pooled label rate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.evaluation.blocks import Blocks
from vtrack_batch.evaluation.pairing import FALSE_ALARM, Paired


def link_scores(paired: Paired, frames: pd.DataFrame, blocks: Blocks) -> dict[str, Any]:
    """Return precision of the links made, recall of the links that could be made, and the pooled label rate.

    A *link* joins two sightings of one track in consecutive frames. Precision is of links made, unless both ends lie on
    parked vehicles or one end is nothing that can be judged (on the border, in an ignored box);
    ``precision_between_vehicles`` is of those with both ends on moving vehicles, so that false alarms are not counted
    again. Recall is of pairs of sightings of one vehicle in consecutive frames, both found. Label rate: over all right
    and false sightings of both images of each pair of frames, the share whose partner is named rightly, *no partner*
    being a name as well (paper; matching.md).
    """
    found = _with_names(paired)
    following = _following(frames)
    made = _steps(found.dropna(subset=["vehicle_id"]), "vehicle_id", following)
    true = _steps(found.dropna(subset=["vehicle"]), "vehicle", following)
    judged = (made["name"] != "") & (made["name_next"] != "") & ~(made["parked"] & made["parked_next"])
    scored = made[judged]
    between = scored[(scored["vehicle"].notna() & scored["vehicle_next"].notna()).to_numpy(bool)]
    joined = true["vehicle_id"].notna() & (true["vehicle_id"] == true["vehicle_id_next"])
    return {
        "made": len(scored),
        "right": int((between["name"] == between["name_next"]).sum()),
        "could_be_made": len(true),
        "could_be_made_and_were": int(joined.sum()),
        "precision": _share(scored, scored["name"] == scored["name_next"], blocks),
        "precision_between_vehicles": _share(between, between["name"] == between["name_next"], blocks),
        "recall": _share(true, joined, blocks),
        "label_rate": _label_rate(found[(found["name"] != "") & ~found["parked"]], made, true, following, blocks),
    }


def _with_names(paired: Paired) -> pd.DataFrame:
    """Return the sightings with ``vehicle`` on movers only, ``parked`` (on any other vehicle), and ``name``.

    The name is the vehicle's, one of its own for each false alarm, or nothing where the sighting cannot be judged.
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


def _following(frames: pd.DataFrame) -> np.ndarray[Any, Any]:
    """Return for each frame the index of the next one of its sequence, -1 at the end."""
    sequence = frames["sequence"].to_numpy()
    last = np.r_[sequence[1:] != sequence[:-1], True] if len(sequence) else np.empty(0, bool)
    return np.where(last, -1, np.arange(len(sequence)) + 1)


def _steps(found: pd.DataFrame, by: str, following: np.ndarray[Any, Any]) -> pd.DataFrame:
    """Return pairs of sightings with equal *by* in consecutive frames; the later one's columns end in ``_next``."""
    earlier = found.assign(frame_next=following[found["frame"].to_numpy(int)])
    later = found[["frame", by, *(c for c in ("vehicle", "vehicle_id", "name", "at", "parked") if c != by)]]
    later = later.rename(columns={c: f"{c}_next" for c in later.columns if c != by})
    steps = earlier.merge(later, on=[by, "frame_next"], how="inner")
    return steps.assign(**{f"{by}_next": steps[by]})


def _share(steps: pd.DataFrame, right: pd.Series, blocks: Blocks) -> dict[str, float | None]:
    frame = steps["frame"].to_numpy()
    return blocks.ratio(blocks.totals(frame, right.to_numpy(float)), blocks.totals(frame))


def _label_rate(
    scored: pd.DataFrame, made: pd.DataFrame, true: pd.DataFrame, following: np.ndarray[Any, Any], blocks: Blocks
) -> dict[str, float | None]:
    """Compare, for each sighting with a frame before or after it, the partner it was given with its true one."""
    frame = scored["frame"].to_numpy(int)
    before = np.full(len(following), -1)
    before[following[following >= 0]] = np.flatnonzero(following >= 0)
    shares = []
    for there, here, other in ((following, "at", "at_next"), (before, "at_next", "at")):
        given = scored["at"].map(made.set_index(here)[other]).fillna(-1).to_numpy()
        right = scored["at"].map(true.set_index(here)[other]).fillna(-1).to_numpy()
        counted = there[frame] >= 0
        pair_frame = np.minimum(frame, there[frame])[counted]
        shares.append((blocks.totals(pair_frame, (given == right)[counted]), blocks.totals(pair_frame)))
    return blocks.ratio(shares[0][0] + shares[1][0], shares[0][1] + shares[1][1])
