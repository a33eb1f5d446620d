"""Who is who in each frame: sightings of the result against true vehicles, one to one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.evaluation.assignment import best_pairs, near_pairs
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.sides import Result, Truth

HIT, FALSE_ALARM, NEUTRAL = "hit", "false", "neutral"
_REACH_GATES = 10.0
_MOST_PAIRS_PX = 1e4
"""Worth of a pair against which distances count little: as many pairs as possible come first."""


@dataclass(frozen=True)
class Scene:
    """The truth on the frames to be scored: ``frame`` is the row number in ``frames`` (see ``joined_frames``).

    ``true``: sightings with ``frame``, ``gate_px`` and ``wanted`` (whether it must be found). ``parked``: parked
    cars in view and off the border. ``ignore`` as in ``Truth``.
    """

    frames: pd.DataFrame
    true: pd.DataFrame
    parked: pd.DataFrame
    ignore: pd.DataFrame


@dataclass(frozen=True)
class Paired:
    """Sightings and true vehicles with their partners.

    ``found``: sightings with ``verdict``, ``row`` (of ``true``, -1 = none), ``vehicle``, ``distance_px``,
    ``on_parked``.
    ``true``: sightings with ``wanted`` and ``row`` (of ``found``, -1 = missed). ``near``: all pairs (row of found, row
    of true, distance in gates) within two gates, for scores that choose their own pairs.
    """

    found: pd.DataFrame
    true: pd.DataFrame
    near: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]


def make_scene(truth: Truth, frames: pd.DataFrame, params: EvaluationParams) -> Scene:
    """Return the truth on *frames*, with its gates."""
    number = pd.Series(np.arange(len(frames)), index=frames["true_frame"].to_numpy())

    def on_frames(table: pd.DataFrame, *order: str) -> pd.DataFrame:
        kept = table[table["frame"].isin(number.index)].copy()
        kept["frame"] = kept["frame"].map(number).astype(np.int64)
        return kept.sort_values(["frame", *order]).reset_index(drop=True)

    true = on_frames(truth.sightings, "vehicle")
    true["gate_px"] = (params.gate_share_of_length * true["length_px"]).fillna(params.gate_px)
    true["wanted"] = true["whole"]
    if truth.layout != "rendered":  # that one's truth holds only what must be found
        true["wanted"] &= ~_on_border(true, frames, params)
    parked = on_frames(truth.parked, "col_px", "row_px")
    parked = parked[~_on_border(parked, frames, params)].reset_index(drop=True)
    return Scene(frames, true, parked, on_frames(truth.ignore, "left", "top"))


def sightings(result: Result, frames: pd.DataFrame) -> pd.DataFrame:
    """Return all detections on *frames*, and what the track that holds them says.

    Columns: ``frame``, ``detection_id``, ``col_px``, ``row_px``; ``vehicle_id`` (null = on no track), ``net_shift_m``
    (from the track's first to its last sighting), ``speed_mps``, ``speed_sigma_mps``.
    """
    number = pd.Series(np.arange(len(frames)), index=frames["frame_id"]).dropna()
    number = number[number.index.notna()]
    points = result.track_points.dropna(subset=["detection_id"]).sort_values(["vehicle_id", "t_utc"])
    ends = points.groupby("vehicle_id")[["x_m", "y_m"]].agg(["first", "last"])
    net = np.hypot(*(ends.xs("last", axis=1, level=1) - ends.xs("first", axis=1, level=1)).to_numpy(float).T)
    points = points.assign(net_shift_m=points["vehicle_id"].map(pd.Series(net, index=ends.index)))
    seen = result.detections.loc[
        result.detections["frame_id"].isin(number.index), ["frame_id", "detection_id", "col_px", "row_px"]
    ]
    seen = seen.assign(frame=seen["frame_id"].map(number).astype(np.int64)).drop(columns="frame_id")
    on_track = points[["detection_id", "vehicle_id", "net_shift_m", "speed_mps", "speed_sigma_mps"]]
    seen = seen.merge(on_track.drop_duplicates("detection_id"), on="detection_id", how="left")
    return seen.sort_values(["frame", "row_px", "col_px", "detection_id"]).reset_index(drop=True)


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
    gate, boxed = true["gate_px"].to_numpy(), true["length_px"].notna().to_numpy()
    near = near_pairs(
        _places(found), _places(true), float((gate * np.where(boxed, 2.0, _REACH_GATES)).max(initial=1e-9))
    )
    gates = near[2] / gate[near[1]]
    i, j, distance = _partners(*near, gate, boxed)
    row = np.full(len(found), -1)
    row[i] = j
    found["row"], found["distance_px"] = row, np.nan
    found.loc[i, "distance_px"] = distance
    found["vehicle"] = pd.Series(true["vehicle"].to_numpy(object)[row] if len(true) else None, index=found.index)
    found.loc[row < 0, "vehicle"] = None
    true["row"] = -1
    true.loc[j, "row"] = i
    wanted = true["wanted"].to_numpy()[row] & (row >= 0) if len(true) else np.zeros(len(found), bool)
    found["on_parked"] = on_parked(found, scene, params)[0]
    neutral = found["on_parked"].to_numpy(bool) | _on_border(found, scene.frames, params) | _ignored(found, scene)
    if movers_only:
        neutral[near[0][gates <= 1]] = True
    found["verdict"] = np.select([wanted, (row >= 0) | neutral], [HIT, NEUTRAL], FALSE_ALARM)
    return Paired(found, true, (near[0][gates <= 2], near[1][gates <= 2], gates[gates <= 2]))


def _partners(
    i: NDArray[np.int64],
    j: NDArray[np.int64],
    distance: NDArray[np.float64],
    gate: NDArray[np.float64],
    boxed: NDArray[np.bool_],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return the one-to-one pairs within the gate, by the rule of the scorer for truths with boxes, or without."""
    limit = np.where(boxed[j], _MOST_PAIRS_PX, _REACH_GATES * gate[j])
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
    i, j, distance = near_pairs(
        _places(found.iloc[free]), _places(scene.parked), _REACH_GATES * params.parked_gate_factor * params.gate_px
    )
    gate = np.full(len(scene.parked), params.parked_gate_factor * params.gate_px)
    i, j, _ = _partners(i, j, distance, gate, np.zeros(len(gate), bool))
    on, covered = np.zeros(len(found), bool), np.zeros(len(scene.parked), bool)
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


def _on_border(table: pd.DataFrame, frames: pd.DataFrame, params: EvaluationParams) -> NDArray[np.bool_]:
    """Return which rows lie within the border of their frame, or outside it; unknown sizes have no border."""
    size = frames[["width_px", "height_px"]].astype(float)
    size = size.fillna(size.max()).fillna(np.inf).to_numpy()[table["frame"].to_numpy(np.int64)]
    at = table[["col_px", "row_px"]].to_numpy(float)
    return np.asarray(~((at > params.border_px) & (at < size - params.border_px)).all(axis=1))


def _places(table: pd.DataFrame) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    return table["frame"].to_numpy(np.int64), table[["col_px", "row_px"]].to_numpy(float)
