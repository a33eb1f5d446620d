"""Revision between two trackings: the tables of a sequence go round once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.model.views import Views
from vtrack_batch.revision.params import RevisionParams
from vtrack_batch.revision.revise import revise
from vtrack_batch.revision.tracked import tracked
from vtrack_batch.revision.withdraw import contracted, queued, renamed, without_filled
from vtrack_batch.tracking.teach import flow_of_tables
from vtrack_batch.tracking.track import Tracks

Track = Callable[[pd.DataFrame, FlowMap | None], Tracks]


def track_revised(
    detections: pd.DataFrame, views: Views, track: Track, params: RevisionParams
) -> tuple[Tracks, pd.DataFrame]:
    """Return the tracks of *detections* after one revision, and the detections as revised.

    What the first tracking taught of the place is the second one's flow map.
    """
    first = track(detections, None)
    if not params.revise or first.track_points.empty:
        return first, detections
    times_s = views.t_utc.astype("datetime64[us]").astype(np.int64) / 1e6
    revised = revise(detections, first.track_points, times_s, params=params)
    taught = flow_of_tables(detections, first.track_points, first.matches)
    again = track(pd.concat([revised.detections, revised.filled], ignore_index=True), taught)
    return _cleaned(again, revised.detections, views, params), revised.detections


def _cleaned(tracks: Tracks, detections: pd.DataFrame, views: Views, params: RevisionParams) -> Tracks:
    """Return *tracks* without filled sightings, and with queued vehicles told from parked ones."""
    points, trajectories = tracks.track_points, tracks.trajectories
    names = [renamed(table["vehicle_id"], points) for table in (points, trajectories)]
    points, trajectories = (
        table.assign(vehicle_id=name)[name.notna()] for table, name in zip((points, trajectories), names, strict=True)
    )
    points = without_filled(points).sort_values(["vehicle_id", "t_utc"], ignore_index=True)
    trajectories = trajectories.sort_values("vehicle_id", ignore_index=True)
    told = tracked(detections, points)
    # both tables are in the order of the vehicles' numbers
    parked = (points["state"] == "parked").groupby(points["vehicle_id"], sort=True).any().to_numpy(bool)
    waits = pd.Series(queued(told, parked, params), index=trajectories.index)
    standing = points["vehicle_id"].isin(trajectories["vehicle_id"][waits])
    return Tracks(
        points.assign(state=points["state"].mask(standing, "stopped")),
        _waiting(trajectories, waits, views),
        contracted(tracks.matches),
    )


def _waiting(trajectories: pd.DataFrame, waits: pd.Series, views: Views) -> pd.DataFrame:
    """Return *trajectories* of which those that only wait neither begin nor end parked."""
    start, end = pd.Timestamp(views.t_utc[0], tz="UTC"), pd.Timestamp(views.t_utc[-1], tz="UTC")
    at_start, at_end = trajectories["t_start_utc"] <= start, trajectories["t_end_utc"] >= end
    words = {
        "origin": pd.Series("unknown", index=trajectories.index),
        "destination": pd.Series("unknown", index=trajectories.index),
        "start_reason": at_start.map({True: "start_of_data", False: "appeared"}),
        "end_reason": at_end.map({True: "end_of_data", False: "lost"}),
    }
    return trajectories.assign(
        **{name: trajectories[name].astype("str").mask(waits, text) for name, text in words.items()}
    )
