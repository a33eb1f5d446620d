"""Truth and sightings on the frames to be scored, in one plane: pixels of the frame, or metres on the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.sides import SIGHTING_NUMBERS, Plane, Result, Truth

POSITION = {"frame": ["col_px", "row_px"], "ground": ["x_m", "y_m"]}
UNIT = {"frame": "px", "ground": "m"}


@dataclass(frozen=True)
class Scene:
    """The truth on the frames to be scored: ``frame`` is the row number in ``frames`` (see ``joined_frames``).

    ``true``: sightings with ``frame``, place ``u``, ``v`` in the ``plane``, ``gate`` in its unit, ``boxed`` (whether
    the gate is by the vehicle's own length) and ``wanted`` (whether it must be found). ``parked``: parked cars in view
    and off the border. ``ignore`` as in ``Truth``. ``gate`` is the common one.
    """

    frames: pd.DataFrame
    true: pd.DataFrame
    parked: pd.DataFrame
    ignore: pd.DataFrame
    plane: Plane
    gate: float


def plane_of(result: Result, truth: Truth) -> Plane:
    """Return ``frame`` where both sides know pixels of the frame, else ``ground``."""

    def lacks_pixels(table: pd.DataFrame) -> bool:
        return bool(len(table)) and ("col_px" not in table or bool(table["col_px"].isna().all()))

    return "ground" if lacks_pixels(truth.sightings) or lacks_pixels(result.detections) else "frame"


def make_scene(
    truth: Truth, frames: pd.DataFrame, plane: Plane, params: EvaluationParams, *, detected_only: bool = False
) -> Scene:
    """Return the truth on *frames*, with its gates; *detected_only*: those sightings that a detection was made of."""
    number = pd.Series(np.arange(len(frames)), index=frames["true_frame"].to_numpy())

    def on_frames(table: pd.DataFrame, *order: str) -> pd.DataFrame:
        kept = table[table["frame"].isin(number.index)].copy()
        kept["frame"] = kept["frame"].map(number).astype(np.int64)
        return kept.sort_values(["frame", *order]).reset_index(drop=True)

    told = truth.sightings
    true = on_frames(told[told["detection_id"].notna()] if detected_only else told, "vehicle")
    true = true.assign(**{name: np.nan for name in SIGHTING_NUMBERS if name not in true})
    length = true[f"length_{UNIT[plane]}"].astype(float)
    gate = params.gate_px if plane == "frame" else params.gate_m
    true = placed(true, plane).assign(gate=(params.gate_share_of_length * length).fillna(gate), boxed=length.notna())
    true["wanted"] = true["whole"].astype(bool)
    scene = Scene(frames, true, true.iloc[:0], on_frames(truth.ignore, "left", "top"), plane, gate)
    if truth.layout != "rendered":  # that one's truth holds only what must be found
        true["wanted"] &= ~on_border(true, scene, params)
    parked = on_frames(truth.parked, "col_px", "row_px").reindex(
        columns=["frame", *POSITION["frame"], *POSITION["ground"]]
    )
    parked = placed(parked, plane)
    parked = parked[~on_border(parked, scene, params) & parked["u"].notna()].reset_index(drop=True)
    return Scene(frames, true, parked, scene.ignore, plane, gate)


def sightings(result: Result, truth: Truth, frames: pd.DataFrame, plane: Plane) -> pd.DataFrame:
    """Return all detections on *frames*, and what the track that holds them says.

    Columns: ``frame``, ``detection_id``, ``col_px``, ``row_px``, ``x_m``, ``y_m``, place ``u``, ``v`` in the *plane*;
    ``vehicle_id`` (null = on no track), ``net_shift_m`` (from the track's first to its last sighting), ``speed_mps``,
    ``speed_sigma_mps``.
    """
    points = result.track_points.dropna(subset=["detection_id"]).sort_values(["vehicle_id", "t_utc"])
    ends = points.groupby("vehicle_id")[["x_m", "y_m"]].agg(["first", "last"])
    net = np.hypot(*(ends.xs("last", axis=1, level=1) - ends.xs("first", axis=1, level=1)).to_numpy(float).T)
    points = points.assign(net_shift_m=points["vehicle_id"].map(pd.Series(net, index=ends.index)))
    places = ["col_px", "row_px", "x_m", "y_m"]
    if result.borrowed:
        held = pd.concat([table for table in (truth.sightings, truth.alarms) if len(table)] or [truth.sightings])
        held = held[held["detection_id"].notna()].drop_duplicates(["frame", "detection_id"])
        key, number = held["frame"], pd.Series(np.arange(len(frames)), index=frames["true_frame"].to_numpy())
    else:
        held = result.detections
        key, number = held["frame_id"], pd.Series(np.arange(len(frames)), index=frames["frame_id"])
        number = number[number.index.notna()]
    seen = held[key.isin(number.index)].reindex(columns=["detection_id", *places]).astype(dict.fromkeys(places, float))
    seen["frame"] = key[key.isin(number.index)].map(number).astype(np.int64)
    on_track = points[["detection_id", "vehicle_id", "net_shift_m", "speed_mps", "speed_sigma_mps"]]
    seen = seen.merge(on_track.drop_duplicates("detection_id"), on="detection_id", how="left")
    return placed(seen.sort_values(["frame", "row_px", "col_px", "detection_id"]).reset_index(drop=True), plane)


def placed(table: pd.DataFrame, plane: Plane) -> pd.DataFrame:
    """Return *table* with ``u``, ``v``: the place in *plane*."""
    u, v = POSITION[plane]
    return table.assign(u=table[u].astype(float), v=table[v].astype(float))


def on_border(table: pd.DataFrame, scene: Scene, params: EvaluationParams) -> NDArray[np.bool_]:
    """Return which rows lie within the border of their frame, or outside it; unknown sizes have no border."""
    if scene.plane == "ground":
        return np.zeros(len(table), bool)
    size = scene.frames[["width_px", "height_px"]].astype(float)
    size = size.fillna(size.max()).fillna(np.inf).to_numpy()[table["frame"].to_numpy(np.int64)]
    at = table[["col_px", "row_px"]].to_numpy(float)
    # without sizes nothing is known of borders, on no side
    within = ((at > params.border_px) & (at < size - params.border_px)) | np.isinf(size)
    return np.asarray(~within.all(axis=1))


def ground_scale(detections: pd.DataFrame, frame: str = "frame_id") -> float:
    """Return metres per pixel: the median over frames of how far detections spread, in metres over pixels."""
    if not {"col_px", "row_px", "x_m", "y_m", frame} <= set(detections.columns):
        return float("nan")
    spread: Any = detections.groupby(frame, observed=True)[["col_px", "row_px", "x_m", "y_m"]].var()
    ratio = (spread["x_m"] + spread["y_m"]) / (spread["col_px"] + spread["row_px"])
    return float(np.sqrt(ratio[ratio > 0].median())) if len(ratio) else float("nan")
