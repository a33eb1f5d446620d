"""Where and how long vehicles stood, and why, as far as simple rules can tell.

A stop is a run of points at which a vehicle is stopped, parked or slower than ``stop_speed_mps``, lasting at least
``stop_min_s``. Its kind is the first of these that holds:

* ``parked``: the tracker says so at any point of it;
* ``queue``: another vehicle, not parked, stands ahead (within 45 degrees of its heading) within ``queue_gap_m`` at some
  moment of it;
* ``signal``: it is on an approach or arm of a junction, or faces the centre of one from no farther than its arms lie:
  nobody is ahead, so it stands first at the line;
* ``unknown``: none of these.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import shapely
from scipy.spatial import cKDTree
from shapely.geometry import Point

from vtrack_batch.traffic.bins import SECOND_US, to_utc
from vtrack_batch.traffic.junctions import Junction
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.paths import Floats, Ints, Mask, Paths
from vtrack_batch.traffic.places import Place

_AHEAD_COS = np.sqrt(0.5)
_LEADER_WINDOW_S = 600.0


def stops_table(
    vehicles: pd.DataFrame,
    paths: Paths,
    places: Sequence[Place],
    junctions: Sequence[Junction],
    *,
    params: TrafficParams,
) -> pd.DataFrame:
    """Return the table ``stops``; *paths* are as seen, neither prolonged nor split."""
    first, last = _runs(paths, params)
    t_start, t_end = paths.t_us[first], paths.t_us[last]
    x_m, y_m = _mean(paths.x_m, first, last), _mean(paths.y_m, first, last)
    place, on_arm = _place_of(x_m, y_m, places)
    parked = _mean(paths.parked.astype(float), first, last) > 0
    spot = pd.DataFrame({"x": x_m, "y": y_m, "start": t_start, "end": t_end, "vehicle": paths.vehicle[first]})
    facing = _direction(paths, first, last)
    queued = _has_leader(spot, facing, parked, params)
    waiting = on_arm | _faces_junction(x_m, y_m, facing, places, junctions)
    kind = np.select([parked, queued, waiting], ["parked", "queue", "signal"], "unknown")
    return pd.DataFrame(
        {
            "vehicle_id": vehicles["vehicle_id"].to_numpy()[paths.vehicle[first]],
            "t_start_utc": to_utc(t_start),
            "t_end_utc": to_utc(t_end),
            "duration_s": (t_end - t_start) / SECOND_US,
            "place": place,
            "x_m": x_m,
            "y_m": y_m,
            "kind": kind,
        }
    )


def _runs(paths: Paths, params: TrafficParams) -> tuple[Ints, Ints]:
    """Return the first and last point of each stop."""
    joined = paths.slow[1:] & paths.slow[:-1] & (paths.vehicle[1:] == paths.vehicle[:-1])
    edge = np.diff(np.r_[0, joined.astype(np.int8), 0])
    first, last = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)
    long = paths.t_us[last] - paths.t_us[first] >= params.stop_min_s * SECOND_US
    return first[long], last[long]


def _mean(values: Floats, first: Ints, last: Ints) -> Floats:
    """Return the mean of *values* over each run of points, both ends included."""
    if len(first) == 0:
        return np.empty(0)
    total = np.add.reduceat(np.r_[values, 0.0], np.stack([first, last + 1], axis=1).reshape(-1))[::2]
    return np.asarray(total / (last - first + 1))


def _place_of(x_m: Floats, y_m: Floats, places: Sequence[Place]) -> tuple[np.ndarray, Mask]:
    """Return the smallest area around each point (id or None), and whether any around it is an arm of a junction."""
    place = np.full(len(x_m), None, object)
    on_arm = np.zeros(len(x_m), bool)
    areas = [candidate for candidate in places if not candidate.is_line]
    for area in sorted(areas, key=lambda candidate: (-candidate.shape.area, candidate.id)):
        shapely.prepare(area.shape)
        inside = shapely.contains_xy(area.shape, x_m, y_m)
        place[inside] = area.id
        on_arm |= inside & (area.role == "approach" or area.junction is not None)
    return place, on_arm


def _direction(paths: Paths, first: Ints, last: Ints) -> Floats:
    """Return the unit direction (k, 2) in which each stopped vehicle faces; NaN where nothing tells.

    The reported heading at the first point of the run; else the way by which it came; else by which it went on.
    """
    heading = np.radians(paths.heading_deg[first])
    facing = np.stack([np.sin(heading), np.cos(heading)], axis=1)
    position = np.stack([paths.x_m, paths.y_m], axis=1)
    for points, neighbour, sign in ((first, first - 1, 1), (last, last + 1, -1)):
        neighbour = neighbour.clip(0, max(len(paths) - 1, 0))
        same = (paths.vehicle[points] == paths.vehicle[neighbour])[:, None]
        step = np.where(same, sign * (position[points] - position[neighbour]), 0.0)
        length = np.hypot(*step.T)[:, None]
        chord = np.divide(step, length, out=np.full(step.shape, np.nan), where=length > 0)
        facing = np.where(np.isnan(facing), chord, facing)
    return facing


def _faces_junction(
    x_m: Floats, y_m: Floats, facing: Floats, places: Sequence[Place], junctions: Sequence[Junction]
) -> Mask:
    """Return whether each stopped vehicle (k,) faces the centre of a junction from within the circle of its arms."""
    faces = np.zeros(len(x_m), bool)
    for junction in junctions:
        reach = max(places[arm].shape.centroid.distance(Point(junction.centre)) for arm in junction.arms)
        offset = np.array(junction.centre) - np.stack([x_m, y_m], axis=1)
        distance = np.hypot(*offset.T)
        faces |= (distance <= reach) & ((offset * facing).sum(axis=1) >= _AHEAD_COS * distance)
    return faces


def _has_leader(spot: pd.DataFrame, facing: Floats, parked: Mask, params: TrafficParams) -> Mask:
    """Return whether another standing vehicle is close ahead of each at some moment of its stop.

    Looked for among those that came to a stand within ten minutes, so that a day of red lights stays a local search.
    """
    queued = np.zeros(len(spot), bool)
    if len(spot) < 2:
        return queued
    start, end = spot["start"].to_numpy(), spot["end"].to_numpy()
    gap = params.queue_gap_m
    xy = spot[["x", "y"]].to_numpy()
    scaled = (start - start.min()) / SECOND_US * (gap / _LEADER_WINDOW_S)
    near = cKDTree(np.c_[xy, scaled]).query_pairs(gap * np.sqrt(2.0), output_type="ndarray")
    follower, leader = np.r_[near[:, 0], near[:, 1]], np.r_[near[:, 1], near[:, 0]]
    vehicle = spot["vehicle"].to_numpy()
    together = (start[follower] <= end[leader]) & (start[leader] <= end[follower]) & ~parked[leader]
    together &= vehicle[follower] != vehicle[leader]
    follower, leader = follower[together], leader[together]
    offset = xy[leader] - xy[follower]
    distance = np.hypot(*offset.T)
    ahead = (offset * facing[follower]).sum(axis=1) >= _AHEAD_COS * distance
    queued[follower[ahead & (distance > 0) & (distance <= gap)]] = True
    return queued
