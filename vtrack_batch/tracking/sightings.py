"""All sightings of one sequence, sorted by frame and place, with the frames themselves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.vehicles import COLOUR, VELOCITY, check, refuse_heaps
from vtrack_batch.model.views import Views

Array = NDArray[np.float64]
Index = NDArray[np.int64]
KEPT = ("detection_id", "length_m", "width_m", *VELOCITY)
HULL_MARGIN_M = 2.0
DENSITY_RADIUS_M = 40.0


@dataclass(frozen=True)
class Sightings:
    """Sightings of one sequence in order of (frame, x, y, id).

    ``frame`` (n,) int64 counts all frames of the sequence, with detections or not; ``frame_s`` (f,) are their times in
    seconds since ``start``, ``interval_s`` the usual time between them; ``first`` (f + 1,) the first sighting of each;
    ``xy`` (n, 2) metres; ``sigma_m`` (n,) the spread of positions; ``rgb`` (n, 3) or None; ``rows`` ids, sizes and
    velocities; ``border`` (f, c, 2) footprints.
    """

    sequence: str
    start: pd.Timestamp
    rows: pd.DataFrame
    frame: Index
    frame_s: Array
    interval_s: float
    first: Index
    xy: Array
    sigma_m: Array
    rgb: Array | None
    border: Array

    def __len__(self) -> int:
        return len(self.xy)

    @property
    def t(self) -> Array:
        """Time of every sighting in seconds since ``start``, (n,)."""
        return self.frame_s[self.frame]

    def ids(self) -> pd.Series[Any]:
        """Detection ids, (n,)."""
        return self.rows["detection_id"]


def read_detections(detections: pd.DataFrame) -> pd.DataFrame:
    """Check a table of detections for tracking; add ``sequence`` where there is none.

    Raises ``UnusableData`` on missing columns, values that are missing or infinite, and repeated ids.
    """
    checked = check(detections, "detections", extra=("t_utc",))
    times = checked["t_utc"]
    if not isinstance(times.dtype, pd.DatetimeTZDtype):
        raise UnusableData("detections: t_utc must be times with a time zone (UTC)")
    if times.isna().any():
        raise UnusableData(f"detections: t_utc is missing in {int(times.isna().sum())} rows")
    sequence = checked["sequence"].astype(str) if "sequence" in checked.columns else "all"
    return checked.assign(t_utc=times.dt.tz_convert("UTC").astype("datetime64[us, UTC]"), sequence=sequence)


def sightings_of(
    rows: pd.DataFrame,
    sequence: str,
    views: Views | None,
    position_sigma_m: float,
    *,
    interval_s: float | None = None,
) -> Sightings:
    """Sort the checked rows of one sequence and place them among its frames.

    *interval_s* is the usual time between frames, where these are only a part of the sequence.
    """
    rows = rows.sort_values(["t_utc", "x_m", "y_m", "detection_id"], kind="stable", ignore_index=True)
    times = rows["t_utc"].dt.tz_localize(None).to_numpy("datetime64[us]")
    xy = rows[["x_m", "y_m"]].to_numpy(float)
    seen = np.unique(times)
    frame_t = seen if views is None else np.asarray(views.t_utc, "datetime64[us]")
    if not np.isin(seen, frame_t).all():
        raise UnusableData(f"sequence {sequence}: detections at times at which no frame was taken")
    if len(frame_t) > 1 and not (np.diff(frame_t) > np.timedelta64(0)).all():
        raise UnusableData(f"sequence {sequence}: the times of its frames do not increase")
    frame = np.searchsorted(frame_t, times).astype(np.int64)
    refuse_heaps(xy, frame, f"sequence {sequence}")
    registered = np.zeros(len(frame_t)) if views is None else np.nan_to_num(views.position_sigma_m)
    border = np.broadcast_to(hull(xy), (len(frame_t), *hull(xy).shape)) if views is None else views.corners_m
    rgb = rows[COLOUR].to_numpy(float) if set(COLOUR) <= set(rows.columns) else None
    return Sightings(
        sequence=sequence,
        start=pd.Timestamp(frame_t[0], tz="UTC") if len(frame_t) else pd.Timestamp(0, tz="UTC"),
        rows=rows[[name for name in KEPT if name in rows.columns]],
        frame=frame,
        frame_s=(frame_t - frame_t[:1]) / np.timedelta64(1, "s"),
        interval_s=usual_interval_s(frame_t) if interval_s is None else interval_s,
        first=np.searchsorted(frame, np.arange(len(frame_t) + 1)).astype(np.int64),
        xy=xy,
        sigma_m=np.hypot(position_sigma_m, registered[frame]),
        rgb=rgb,
        border=np.asarray(border, float),
    )


def picked(s: Sightings, rows: NDArray[np.bool_] | slice) -> Sightings:
    """Return some of the sightings, in their order; frames and their numbers stay."""
    frame = s.frame[rows]
    return replace(
        s,
        rows=s.rows.iloc[rows].reset_index(drop=True),
        frame=frame,
        first=np.searchsorted(frame, np.arange(len(s.frame_s) + 1)).astype(np.int64),
        xy=s.xy[rows],
        sigma_m=s.sigma_m[rows],
        rgb=None if s.rgb is None else s.rgb[rows],
    )


def of_frames(s: Sightings, low: int, high: int) -> Sightings:
    """Return the sightings of the frames *low* to *high*, counted from *low*; seconds stay."""
    if (low, high) == (0, len(s.frame_s)):
        return s
    rows = slice(int(s.first[low]), int(s.first[high]))
    part = picked(s, rows)
    return replace(
        part,
        frame=part.frame - low,
        frame_s=s.frame_s[low:high],
        first=s.first[low : high + 1] - rows.start,
        border=s.border[low:high],
    )


def in_succession(s: Sightings, later: Sightings) -> Sightings:
    """Return the sightings of *s* and of frames that come behind its own; footprints have as many corners in both."""
    frame = np.concatenate([s.frame, later.frame + len(s.frame_s)])
    elapsed_s = later.frame_s + (later.start - s.start).total_seconds()
    # to the microsecond, as if all times had been counted from the first
    frame_s = np.concatenate([s.frame_s, np.rint(elapsed_s * 1e6) / 1e6])
    coloured = s.rgb is not None and later.rgb is not None
    return replace(
        s,
        rows=pd.concat([s.rows, later.rows], ignore_index=True),
        frame=frame,
        frame_s=frame_s,
        first=np.searchsorted(frame, np.arange(len(frame_s) + 1)).astype(np.int64),
        xy=np.concatenate([s.xy, later.xy]),
        sigma_m=np.concatenate([s.sigma_m, later.sigma_m]),
        rgb=np.concatenate([s.rgb, later.rgb]) if coloured else None,
        border=np.concatenate([s.border, later.border]),
    )


def inside_m(border: Array, xy: Array) -> Array:
    """Return how far points (n, 2) lie inside the convex outlines (n, c, 2); negative = outside. Either orientation."""
    side = np.roll(border, -1, axis=1) - border
    length = np.maximum(np.hypot(side[..., 0], side[..., 1]), 1e-9)
    to_point = xy[:, None, :] - border
    left = (side[..., 0] * to_point[..., 1] - side[..., 1] * to_point[..., 0]) / length
    centre = border.mean(axis=1, keepdims=True) - border
    turn = np.sign((side[..., 0] * centre[..., 1] - side[..., 1] * centre[..., 0]).sum(axis=1, keepdims=True))
    return np.asarray((left * turn).min(axis=1))


def usual_interval_s(frame_t: NDArray[np.datetime64]) -> float:
    """Return the median time between frames, 1 s where there is but one."""
    return float(np.median(np.diff(frame_t) / np.timedelta64(1, "s"))) if len(frame_t) > 1 else 1.0


def hull(xy: Array) -> Array:
    """Return the convex hull of points as (c, 2), slightly grown, its least corner first; a box where there is none."""
    corners = _corners(xy)
    if corners is None:
        low, high = (xy.min(axis=0), xy.max(axis=0)) if len(xy) else (np.zeros(2), np.zeros(2))
        low, high = low - HULL_MARGIN_M, high + HULL_MARGIN_M
        return np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    corners = np.roll(corners, -int(np.lexsort(corners.T)[0]), axis=0)
    outward = corners - corners.mean(axis=0)
    return np.asarray(corners + HULL_MARGIN_M * outward / np.maximum(np.hypot(*outward.T), 1e-9)[:, None])


def outermost(xy: Array) -> Array:
    """Return those of the points (n, 2) that make the hull, of these and of any further ones."""
    corners = _corners(xy)
    if corners is None and len(xy):  # few, or on one line: its ends are outermost on one axis at least
        return xy[np.r_[xy.argmin(axis=0), xy.argmax(axis=0)]]
    return xy[:0] if corners is None else corners


def _corners(xy: Array) -> Array | None:
    try:
        return np.asarray(xy[ConvexHull(xy).vertices]) if len(xy) >= 3 else None
    except QhullError:
        return None
