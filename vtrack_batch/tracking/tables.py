"""Tables of tracks: points, trajectories and matches, with the columns of the data dictionary."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from vtrack_batch.model.flags import TrajectoryFlag
from vtrack_batch.model.tables import TABLES
from vtrack_batch.tracking.link import Chains
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.tracking.paths import Paths
from vtrack_batch.tracking.sightings import Array, Index, Sightings, inside_m


def track_points(s: Sightings, paths: Paths, params: TrackingParams) -> pd.DataFrame:
    """Return one row for every vehicle and frame between its first and last sighting."""
    track, single = paths.track, np.diff(paths.first)[paths.track] == 1
    speed = np.hypot(*paths.velocity.T)
    standing = speed < params.stop_speed_mps
    table = pd.DataFrame(
        {
            "vehicle_id": vehicle_ids(s, paths).to_numpy()[track],
            "t_utc": times(s, paths.frame),
            "x_m": paths.xy[:, 0],
            "y_m": paths.xy[:, 1],
            "vx_mps": np.where(single, np.nan, paths.velocity[:, 0]),
            "vy_mps": np.where(single, np.nan, paths.velocity[:, 1]),
            "speed_mps": np.where(single, np.nan, speed),
            "speed_sigma_mps": np.where(single, np.nan, paths.speed_sigma),
            "accel_mps2": np.where(single, np.nan, acceleration(s, paths)),
            "heading_deg": _heading(paths, standing | single),
            "detection_id": pd.array(s.ids()).take(paths.sighting, allow_fill=True),
            "state": np.where(paths.parked[track], "parked", np.where(standing, "stopped", "moving")),
        }
    )
    table["state"] = table["state"].astype("str")
    return table.sort_values(["vehicle_id", "t_utc"], ignore_index=True)[list(TABLES["track_points"].column_names)]


def trajectories(s: Sightings, paths: Paths, params: TrackingParams) -> pd.DataFrame:
    """Return one row for every vehicle; origin, destination and movement are for others to fill in."""
    points = np.diff(paths.first)
    duration = s.frame_s[paths.frame[paths.end]] - s.frame_s[paths.frame[paths.start]]
    path_m = _sum_per_track(paths, np.concatenate([_steps(paths), [0.0]])[: len(paths.frame)])
    length, width = (_median_size(s, paths, c) for c in ("length_m", "width_m"))
    ends = np.where(paths.parked, "parked", "unknown")
    table = pd.DataFrame(
        {
            "vehicle_id": vehicle_ids(s, paths),
            "sequence": s.sequence,
            "t_start_utc": times(s, paths.frame[paths.start]),
            "t_end_utc": times(s, paths.frame[paths.end]),
            "points": points.astype(np.int32),
            "path_m": path_m,
            "mean_speed_mps": np.where(points > 1, path_m / np.maximum(duration, 1e-9), np.nan),
            "length_m": length,
            "width_m": width,
            "vehicle_class": vehicle_class(length, width, params),
            "origin": ends,
            "destination": ends,
            "movement": None,
            "start_reason": _reasons(s, paths, params, ends=False),
            "end_reason": _reasons(s, paths, params, ends=True),
            "identity_probability": np.nan,
            "flags": _flags(s, paths, params),
            "geometry": _lines(paths),
        }
    )
    text = ["sequence", "vehicle_class", "origin", "destination", "movement", "start_reason", "end_reason"]
    table[text] = table[text].astype("str")
    return table.sort_values("vehicle_id", ignore_index=True)[list(TABLES["trajectories"].column_names)]


def matches(s: Sightings, chains: Chains, method: str) -> pd.DataFrame:
    """Return all links, and the sightings with no link on one side; the first frame has no past, the last no future."""
    i = np.flatnonzero(chains.after >= 0)
    k = chains.after[i]
    last = len(s.frame_s) - 1
    gone = np.flatnonzero((chains.after < 0) & (s.frame < last))
    new = np.flatnonzero((chains.before < 0) & (s.frame > 0))
    none = np.full(len(new), -1), np.full(len(gone), -1)
    rows_from, rows_to = np.concatenate([i, gone, none[0]]), np.concatenate([k, none[1], new])
    ids = pd.array(s.ids())
    of_from, of_to = ids.take(rows_from, allow_fill=True), ids.take(rows_to, allow_fill=True)
    table = pd.DataFrame(
        {
            "match_id": _text(of_from) + ">" + _text(of_to),
            "sequence": s.sequence,
            "t_from_utc": times(s, np.concatenate([s.frame[i], s.frame[gone], s.frame[new] - 1])),
            "t_to_utc": times(s, np.concatenate([s.frame[k], s.frame[gone] + 1, s.frame[new]])),
            "detection_id_from": of_from,
            "detection_id_to": of_to,
            "probability": np.concatenate([chains.probability[i], chains.probability[gone], chains.none_before[new]]),
            "method": method,
        }
    )
    return table.sort_values("match_id", ignore_index=True)[list(TABLES["matches"].column_names)]


def vehicle_ids(s: Sightings, paths: Paths) -> pd.Series[str]:
    """Return the vehicle id of every track: made from its first sighting."""
    return "v-" + _text(pd.array(s.ids()).take(paths.sighting[paths.start]))


def times(s: Sightings, frame: Index) -> pd.DatetimeIndex:
    """Return the UTC times of frames by number."""
    micro = np.round(s.frame_s[frame] * 1e6).astype("timedelta64[us]")
    start = s.start.tz_localize(None).to_datetime64().astype("datetime64[us]")
    return pd.DatetimeIndex(start + micro).tz_localize("UTC")


def acceleration(s: Sightings, paths: Paths) -> Array:
    """Return the rate of change of speed (p,) between the neighbouring points of each."""
    speed, t, track = np.hypot(*paths.velocity.T), s.frame_s[paths.frame], paths.track
    point = np.arange(len(t))
    a, b = np.maximum(point - 1, paths.first[track]), np.minimum(point + 1, paths.first[track + 1] - 1)
    return np.where(b > a, (speed[b] - speed[a]) / np.maximum(t[b] - t[a], 1e-9), 0.0)


def vehicle_class(length: Array, width: Array, params: TrackingParams) -> NDArray[np.str_]:
    """Return the class by size; unknown where there is no size."""
    limits = [params.car_length_m, params.van_length_m, params.lorry_length_m]
    longest = np.where(width >= params.bus_width_m, "bus", "lorry")
    named = np.select([length <= limit for limit in limits], ["car", "van", "lorry"], longest)
    return np.where(np.isnan(length), "unknown", named)


def _text(ids: Any) -> pd.Series[str]:
    return pd.Series(ids).astype("string").fillna("").astype("str")


def _heading(paths: Paths, unknown: NDArray[np.bool_]) -> Array:
    """Direction of travel, clockwise from north; while standing that of the last motion, else of the next."""
    heading = pd.Series(np.degrees(np.arctan2(paths.velocity[:, 0], paths.velocity[:, 1])) % 360)
    known = heading.mask(unknown).groupby(paths.track)
    return np.asarray(known.ffill().fillna(known.bfill()).to_numpy(float))


def _steps(paths: Paths) -> Array:
    """Length of the way from each point to the next, 0 from one track to another, (p - 1,)."""
    step = np.hypot(*np.diff(paths.xy, axis=0).T)
    return np.where(np.diff(paths.track) == 0, step, 0.0)


def _sum_per_track(paths: Paths, values: Array) -> Array:
    return np.asarray(np.bincount(paths.track, weights=values, minlength=len(paths)), float)


def _median_size(s: Sightings, paths: Paths, column: str) -> Array:
    if column not in s.rows.columns:
        return np.full(len(paths), np.nan)
    seen = paths.sighting >= 0
    size = pd.Series(s.rows[column].to_numpy(float, na_value=np.nan)[paths.sighting[seen]])
    return np.asarray(size.groupby(paths.track[seen]).median().reindex(range(len(paths))).to_numpy(float))


def _flags(s: Sightings, paths: Paths, params: TrackingParams) -> NDArray[np.int32]:
    seen = np.bincount(paths.track, weights=paths.sighting >= 0, minlength=len(paths))
    hard = np.hypot(*paths.velocity.T) > params.motion.max_speed_mps
    hard |= np.abs(acceleration(s, paths)) > params.max_accel_mps2
    flags = np.where(_sum_per_track(paths, hard.astype(float)) > 0, int(TrajectoryFlag.IMPLAUSIBLE_SPEED), 0)
    flags |= np.where(seen < params.few_points, int(TrajectoryFlag.FEW_POINTS), 0)
    flags |= np.where(seen < np.diff(paths.first), int(TrajectoryFlag.BRIDGED_GAP), 0)
    flags |= np.where(_unsteady(s, paths, params), int(TrajectoryFlag.SIZE_UNSTEADY), 0)
    return flags.astype(np.int32)


def _unsteady(s: Sightings, paths: Paths, params: TrackingParams) -> NDArray[np.bool_]:
    """Tell where lengths differ from their median by more than the set share, in the mean."""
    if "length_m" not in s.rows.columns:
        return np.zeros(len(paths), bool)
    seen = paths.sighting >= 0
    track = paths.track[seen]
    size = s.rows["length_m"].to_numpy(float, na_value=np.nan)[paths.sighting[seen]]
    median = _median_size(s, paths, "length_m")
    off = pd.Series(np.abs(size - median[track]) / median[track]).groupby(track).median()
    return np.asarray(off.reindex(range(len(paths))).to_numpy(float) > params.size_unsteady_share)


def _reasons(s: Sightings, paths: Paths, params: TrackingParams, *, ends: bool) -> NDArray[np.str_]:
    """Say why tracks start, or end: parked, the data, the border of the view, or nothing that is known."""
    at = paths.end if ends else paths.start
    frame, towards = paths.frame[at], (1.0 if ends else -1.0)
    # where it would be a frame and a half and some metres on: the sighting nearest the border may have been missed
    velocity = paths.velocity[at] * (np.diff(paths.first) > 1)[:, None]
    speed = np.hypot(*velocity.T)[:, None]
    on = 1.5 * s.interval_s * velocity + params.border_m * velocity / np.maximum(speed, 1.0)
    at_border = inside_m(s.border[frame], paths.xy[at] + towards * on) < 0
    at_data = frame == (len(s.frame_s) - 1 if ends else 0)
    words = ("end_of_data", "left_view", "lost") if ends else ("start_of_data", "entered_view", "appeared")
    return np.select([paths.parked, at_data, at_border], ["parked", words[0], words[1]], words[2])


def _lines(paths: Paths) -> NDArray[np.object_]:
    """Return the paths as WKB line strings; a single point is written twice."""
    twice = np.where(np.diff(paths.first) == 1, 2, 1)[paths.track]
    if not len(paths):
        return np.zeros(0, object)
    lines = shapely.linestrings(np.repeat(paths.xy, twice, axis=0), indices=np.repeat(paths.track, twice))
    return np.asarray(shapely.to_wkb(lines), dtype=object)
