"""Revise the detections of a sequence by its tracks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.revision.absences import Clock, absences
from vtrack_batch.revision.crossing import DRIVES_MPS, drivers_through
from vtrack_batch.revision.params import RevisionParams
from vtrack_batch.revision.parts import joined_parts
from vtrack_batch.revision.stands import held
from vtrack_batch.revision.tracked import Tracked, tracked


@dataclass(frozen=True, eq=False)
class Revised:
    """``detections``: those that stay, ghosts taken out and standing ones held. ``filled``: rows to track beside them,
    with the ids that no table keeps.
    """

    detections: pd.DataFrame
    filled: pd.DataFrame


def revise(
    detections: pd.DataFrame, track_points: pd.DataFrame, frame_times_s: NDArray[np.float64], *, params: RevisionParams
) -> Revised:
    """Return the detections of one sequence as its tracks tell that they are.

    *detections* and *track_points* as declared; *frame_times_s* (n,) seconds since the epoch of all frames, ascending.
    """
    detections = detections.sort_values("detection_id", kind="stable", ignore_index=True)
    detections, too_many = joined_parts(detections, tracked(detections, track_points), params)
    detections = detections[~detections.index.isin(too_many)].reset_index(drop=True)
    told = tracked(detections, track_points)
    ghost = ghosts(told, params)
    gone = told.points["row"].to_numpy()[ghost[told.points["vehicle"].to_numpy(int)]] if len(ghost) else []
    rows = np.setdiff1d(np.arange(len(detections)), gone)
    stood = held(detections, told, ~ghost, params)
    filled = absences(detections, told, ~ghost, Clock(frame_times_s), params)
    return Revised(stood.iloc[rows].reset_index(drop=True), filled)


def ghosts(told: Tracked, params: RevisionParams) -> NDArray[np.bool_]:
    """Return for every vehicle whether it is something still that others drive through while it is there."""
    still = told.vehicles["extent_m"].to_numpy() < params.still_m
    still &= (told.vehicles["end_s"] > told.vehicles["begin_s"]).to_numpy()
    spots = told.spots(still, params.pierced_share)
    ghost = np.zeros(len(still), np.bool_)
    ghost[still] = drivers_through(spots, told.ways(DRIVES_MPS), during=True) >= params.pierced_by
    return ghost
