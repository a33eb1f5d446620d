"""Who is who in each frame: sightings of the result against true vehicles, one to one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.errors import UnusableData
from vtrack_batch.evaluation.assignment import Array, Index, best_pairs, near_pairs
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.scene import UNIT, Scene, on_border

HIT, FALSE_ALARM, NEUTRAL = "hit", "false", "neutral"
_REACH_GATES = 10.0
_MOST_PAIRS = 1e4
"""Worth of a pair against which distances count little: as many pairs as possible come first."""


@dataclass(frozen=True)
class Paired:
    """Sightings and true vehicles with their partners.

    ``found``: sightings with ``verdict``, ``row`` (of ``true``, -1 = none), ``vehicle``, ``distance``, ``on_parked``.
    ``true``: sightings with ``wanted`` and ``row`` (of ``found``, -1 = missed). ``near``: all pairs (row of found, row
    of true, distance in gates) within two gates, for scores that choose their own pairs. ``unit`` of distances.
    """

    found: pd.DataFrame
    true: pd.DataFrame
    near: tuple[Index, Index, Array]
    unit: str


def pair(found: pd.DataFrame, scene: Scene, params: EvaluationParams, *, movers_only: bool = False) -> Paired:
    """Match *found* to the truth frame by frame, one to one (Hungarian), as the independent scorers do.

    True boxes: as many pairs within the gate as possible, of these the least distance. No boxes: the least sum of
    distances, each cut off at ten gates; then pairs beyond the gate are dropped.

    A sighting without a partner is a false alarm, unless it lies on a parked car, in an ignored box or within the
    border: then it is neither right nor wrong. With *movers_only* just the movers of the truth are wanted, and what
    lies on any other vehicle is neither right nor wrong.
    """
    found, true = found.reset_index(drop=True), scene.true.copy()
    if movers_only:
        true["wanted"] &= true["motion"] == "mover"
    gate, boxed = true["gate"].to_numpy(), true["boxed"].to_numpy()
    reach = float((gate * np.where(boxed, 2.0, _REACH_GATES)).max(initial=1e-9))
    near = near_pairs(_places(found), _places(true), reach)
    gates = near[2] / gate[near[1]]
    found, true = _joined(found, true, *_partners(*near, gate, boxed))
    found["on_parked"] = on_parked(found, scene, params)[0]
    neutral = found["on_parked"].to_numpy(bool) | on_border(found, scene, params) | _ignored(found, scene)
    if movers_only:
        neutral[near[0][gates <= 1]] = True
    found["verdict"] = _verdicts(found, true, neutral)
    within = gates <= 2
    return Paired(found, true, (near[0][within], near[1][within], gates[within]), UNIT[scene.plane])


def pair_by_id(found: pd.DataFrame, scene: Scene) -> Paired:
    """Match *found* to the truth by ``detection_id``, for results made from the truth's own detections.

    A detection of several vehicles that a detector took for one is the first of them by name; the others are missed.
    Raises ``UnusableData`` where ids repeat from frame to frame.
    """
    found, true = found.reset_index(drop=True), scene.true.copy()
    first, seen = true.drop_duplicates("detection_id"), true.drop_duplicates(["frame", "detection_id"])
    if len(first) < len(seen):
        twice = seen.loc[seen["detection_id"].duplicated(), "detection_id"].iloc[0]
        raise UnusableData(
            f"the truth's detection ids repeat from frame to frame, such as {twice!r}: give the detections of one "
            "sequence only"
        )
    at = pd.Index(first["detection_id"]).get_indexer(found["detection_id"])
    j = np.where(at >= 0, first.index.to_numpy()[at], -1) if len(first) else at
    i = np.flatnonzero(j >= 0)
    j = j[i]
    distance = np.hypot(*(found.loc[i, ["u", "v"]].to_numpy() - true.loc[j, ["u", "v"]].to_numpy()).T)
    found, true = _joined(found, true, i, j, distance)
    found["on_parked"] = False
    found["verdict"] = _verdicts(found, true, np.zeros(len(found), bool))
    return Paired(found, true, (i, j, np.zeros(len(i))), UNIT[scene.plane])


def _joined(
    found: pd.DataFrame, true: pd.DataFrame, i: Index, j: Index, distance: Array
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Write the pairs (*i*, *j*) into both tables."""
    row = np.full(len(found), -1)
    row[i] = j
    found["row"], found["distance"] = row, np.nan
    found.loc[i, "distance"] = distance
    found["vehicle"] = pd.Series(true["vehicle"].to_numpy(object)[row] if len(true) else None, index=found.index)
    found.loc[row < 0, "vehicle"] = None
    true["row"] = -1
    true.loc[j, "row"] = i
    return found, true


def _verdicts(found: pd.DataFrame, true: pd.DataFrame, neutral: NDArray[np.bool_]) -> NDArray[np.str_]:
    row = found["row"].to_numpy()
    wanted = true["wanted"].to_numpy()[row] & (row >= 0) if len(true) else np.zeros(len(found), bool)
    return np.select([wanted, (row >= 0) | neutral], [HIT, NEUTRAL], FALSE_ALARM)


def _partners(i: Index, j: Index, distance: Array, gate: Array, boxed: NDArray[np.bool_]) -> tuple[Index, Index, Array]:
    """Return the one-to-one pairs within the gate, by the rule of the scorer for truths with boxes, or without."""
    limit = np.where(boxed[j], _MOST_PAIRS, _REACH_GATES * gate[j])
    worth = (limit > distance) & (~boxed[j] | (distance <= gate[j]))
    i, j, distance, limit = i[worth], j[worth], distance[worth], limit[worth]
    best = best_pairs(i, j, limit - distance)
    best = best[distance[best] <= gate[j[best]]]
    return i[best], j[best], distance[best]


def on_parked(
    found: pd.DataFrame, scene: Scene, params: EvaluationParams
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which of *found*, not matched to a vehicle, lie on a parked car, and which parked cars they cover."""
    free = np.flatnonzero(found["row"] < 0)
    gate = params.parked_gate_factor * scene.gate
    i, j, distance = near_pairs(_places(found.iloc[free]), _places(scene.parked), _REACH_GATES * gate)
    count = len(scene.parked)
    i, j, _ = _partners(i, j, distance, np.full(count, gate), np.zeros(count, bool))
    on, covered = np.zeros(len(found), bool), np.zeros(count, bool)
    on[free[i]], covered[j] = True, True
    return on, covered


def _ignored(found: pd.DataFrame, scene: Scene) -> NDArray[np.bool_]:
    """Return which of *found* lie in a box to be ignored."""
    boxed = found[["frame", "col_px", "row_px"]].reset_index(names="at").merge(scene.ignore, on="frame")
    col, row = boxed["col_px"] - boxed["left"], boxed["row_px"] - boxed["top"]
    inside = (col >= 0) & (col <= boxed["width"]) & (row >= 0) & (row <= boxed["height"])
    ignored = np.zeros(len(found), bool)
    ignored[boxed.loc[inside, "at"].to_numpy(int)] = True
    return ignored


def _places(table: pd.DataFrame) -> tuple[Index, Array]:
    return table["frame"].to_numpy(np.int64), table[["u", "v"]].to_numpy(float)
