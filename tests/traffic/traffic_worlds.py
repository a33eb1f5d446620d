"""Small worlds whose traffic can be counted by hand: straight roads, constant speeds, a rectangular view."""

from __future__ import annotations

import numpy as np
import pandas as pd
from shapely.geometry import LineString, box

from vtrack_batch.model.views import Views
from vtrack_batch.model.zones import Zone

START = np.datetime64("2026-05-17T08:00:00", "us")


def times(seconds) -> pd.DatetimeIndex:
    us = np.rint(np.asarray(seconds, float) * 1e6).astype("timedelta64[us]")
    return pd.DatetimeIndex(START + us).tz_localize("UTC")


def path(name: str, xy, t_s, state: str = "moving") -> pd.DataFrame:
    """Track points of one vehicle through the given points (n, 2) at the given seconds."""
    xy, t_s = np.asarray(xy, float), np.asarray(t_s, float)
    return pd.DataFrame({"vehicle_id": name, "t_utc": times(t_s), "x_m": xy[:, 0], "y_m": xy[:, 1], "state": state})


def straight(name: str, start, velocity, t_s) -> pd.DataFrame:
    """Track points of a vehicle that starts at the first second and keeps its velocity (vx, vy)."""
    t_s = np.asarray(t_s, float)
    way = np.asarray(start, float) + np.outer(t_s - t_s[0], velocity)
    return path(name, way, t_s).assign(speed_mps=float(np.hypot(*velocity)))


def trajectories_of(track_points: pd.DataFrame, **columns) -> pd.DataFrame:
    """One row per vehicle; columns given as scalars or as dicts by vehicle."""
    t = track_points.groupby("vehicle_id")["t_utc"]
    out = pd.DataFrame({"t_start_utc": t.min(), "t_end_utc": t.max()}).reset_index()
    usual = {
        "sequence": "s",
        "vehicle_class": "car",
        "start_reason": "entered_view",
        "end_reason": "left_view",
        "identity_probability": np.nan,
    }
    for name, value in {**usual, **columns}.items():
        out[name] = out["vehicle_id"].map(value) if isinstance(value, dict) else value
    return out


def view(t_s, west=-120.0, south=-60.0, east=120.0, north=60.0, sequence="s") -> dict[str, Views]:
    """A platform that shows the same rectangle at all the given seconds."""
    corners = np.array([[west, north], [east, north], [east, south], [west, south]])
    t_utc = times(t_s).tz_localize(None).to_numpy().astype("datetime64[us]")
    n = len(t_utc)
    return {sequence: Views(sequence, t_utc, np.tile(corners, (n, 1, 1)), np.zeros(n))}


def gate(name: str, *points, **properties) -> Zone:
    junction = properties.pop("junction", None)
    return Zone(name, name, "gate", LineString(points), junction, properties)


def area(name: str, west, south, east, north, role="zone", junction=None, **properties) -> Zone:
    return Zone(name, name, role, box(west, south, east, north), junction, properties)


def lopsided_crossing(role="zone") -> list[Zone]:
    """Four arms around (20, -10) of quite different lengths: W far, E near, N, S."""
    return [
        area("W", -120, -20, -80, 0, role, "J"),
        area("E", 60, -20, 120, 0, role, "J"),
        area("N", 10, 30, 30, 60, role, "J"),
        area("S", 10, -60, 30, -40, role, "J"),
    ]
