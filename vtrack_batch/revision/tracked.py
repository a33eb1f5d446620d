"""A tracked sequence as arrays: points in order of vehicle and time, with what was seen at each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.revision.crossing import Spots, Ways

_SECOND_US = 1e6
_POINT = ["vehicle", "vehicle_id", "t_utc", "t_s", "row", "x_m", "y_m", "speed_mps", "vx_mps", "vy_mps"]
_SEEN = ["length_m", "width_m", "heading_deg", "area_m2", "red", "green", "blue"]


@dataclass(frozen=True, eq=False)
class Tracked:
    """``points``: rows of ``track_points`` by vehicle and time, with ``vehicle`` (number), ``t_s``, ``row`` (of the
    detection, -1 = none) and what that says of size, axis and colour. ``vehicles``: one row each, by number.
    """

    points: pd.DataFrame
    vehicles: pd.DataFrame

    def ways(self, least_mps: float) -> Ways:
        """Return what was driven between successive points, faster than *least_mps*."""
        p = self.points
        vehicle, t_s = p["vehicle"].to_numpy(), p["t_s"].to_numpy()
        xy = p[["x_m", "y_m"]].to_numpy()
        way = np.hypot(*np.diff(xy, axis=0).T)
        drives = np.flatnonzero((np.diff(vehicle) == 0) & (way > least_mps * np.diff(t_s)))
        return Ways(vehicle[drives], xy[drives], xy[drives + 1], t_s[drives], t_s[drives + 1])

    def spots(self, chosen: NDArray[np.bool_], share: float) -> Spots:
        """Return where the *chosen* vehicles (bool, by number) are, their boxes shrunk to a *share*."""
        v = self.vehicles[chosen]
        turn = np.radians(v["heading_deg"].to_numpy())
        return Spots(
            v[["x_m", "y_m"]].to_numpy(),
            share / 2 * v[["length_m", "width_m"]].to_numpy(),
            np.stack([np.sin(turn), np.cos(turn)], axis=1),
            v["begin_s"].to_numpy(),
            v["end_s"].to_numpy(),
        )


def tracked(detections: pd.DataFrame, track_points: pd.DataFrame) -> Tracked:
    """Bring the tables of one sequence together; *detections* is numbered 0 ... n - 1."""
    p = track_points.sort_values(["vehicle_id", "t_utc"], ignore_index=True)
    number, _ = pd.factorize(p["vehicle_id"], sort=True)
    row = pd.Index(detections["detection_id"].astype(object)).get_indexer(p["detection_id"].astype(object))
    row = np.where(p["detection_id"].isna(), -1, row)
    t_us = p["t_utc"].dt.tz_localize(None).to_numpy("datetime64[us]").astype(np.int64)
    points = p.assign(vehicle=number, t_s=t_us / _SECOND_US, row=row)
    seen = detections[_SEEN].reindex(row).set_axis(points.index)
    points = pd.concat([points[_POINT], seen], axis=1)
    return Tracked(points, _vehicles(points))


def _vehicles(points: pd.DataFrame) -> pd.DataFrame:
    grouped = points.groupby("vehicle", sort=True)
    v = grouped[["x_m", "y_m", *_SEEN]].median()
    # an axis has no sign: the mean of doubled angles
    doubled = np.radians(2 * points["heading_deg"])
    parts = pd.DataFrame({"c": np.cos(doubled), "s": np.sin(doubled), "vehicle": points["vehicle"]})
    mean = parts.groupby("vehicle", sort=True).mean()
    v["heading_deg"] = np.degrees(np.arctan2(mean["s"], mean["c"])) / 2 % 180
    v["begin_s"], v["end_s"] = grouped["t_s"].min(), grouped["t_s"].max()
    away = points[["x_m", "y_m"]].to_numpy() - v.loc[points["vehicle"], ["x_m", "y_m"]].to_numpy()
    v["extent_m"] = pd.Series(np.hypot(*away.T)).groupby(points["vehicle"].to_numpy()).max()
    v["sightings"] = (points["row"] >= 0).groupby(points["vehicle"]).sum()
    return v
