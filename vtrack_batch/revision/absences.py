"""Sightings that were missed, where the tracks before and after leave no doubt of the vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from vtrack_batch.revision.crossing import DRIVES_MPS, Spots, drivers_through
from vtrack_batch.revision.params import RevisionParams
from vtrack_batch.revision.tracked import Tracked

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_ENDS_MPS, _STARTS_MPS = 8.0, 5.0
_GENTLE_MPS2, _LANE_M = 1.5, 1.5
FILLED = "~"
"""How the ids of filled sightings begin: sorted after all others."""


@dataclass(frozen=True)
class Clock:
    """The frames of the sequence: ``times_s`` (n,) ascending."""

    times_s: Array

    def between(self, begin_s: float, end_s: float) -> Array:
        """Return the times of the frames between two, without these."""
        low = np.searchsorted(self.times_s, begin_s + 1e-4, "left")
        return self.times_s[low : np.searchsorted(self.times_s, end_s - 1e-4, "right")]


def absences(
    detections: pd.DataFrame, told: Tracked, real: NDArray[np.bool_], clock: Clock, params: RevisionParams
) -> pd.DataFrame:
    """Return rows like *detections* for sightings that were missed: single frames within a track, and stands between
    the end of a track and the beginning of another at the same spot.
    """
    within, stood = _single_gaps(told, real), _stood_between(told, real, params)
    rows, times, places = [within["row"].to_numpy(int)], [within["t_s"].to_numpy()], [within[["x_m", "y_m"]].to_numpy()]
    for row, begin_s, end_s, place in zip(stood.row, stood.begin_s, stood.end_s, stood.xy, strict=True):
        t_s = clock.between(begin_s, end_s)
        rows.append(np.full(len(t_s), row))
        times.append(t_s)
        places.append(np.tile(place, (len(t_s), 1)))
    return _as_detections(detections, np.concatenate(rows), np.concatenate(times), np.concatenate(places))


@dataclass(frozen=True, eq=False)
class Stood:
    """Vehicles that stood unseen: ``row`` (k,) of the detection before, ``begin_s``, ``end_s`` (k,), ``xy`` (k, 2)."""

    row: Index
    begin_s: Array
    end_s: Array
    xy: Array


def _single_gaps(told: Tracked, real: NDArray[np.bool_]) -> pd.DataFrame:
    """Return the points without a sighting between two that have one, with the row of the sighting before."""
    p = told.points
    row = p["row"].to_numpy()
    gap = np.zeros(len(p), np.bool_)
    gap[1:-1] = (row[1:-1] < 0) & (row[:-2] >= 0) & (row[2:] >= 0)
    gap &= real[p["vehicle"].to_numpy(int)] if len(p) else gap
    return p[gap].assign(row=row[np.flatnonzero(gap) - 1])


def _stood_between(told: Tracked, real: NDArray[np.bool_], params: RevisionParams) -> Stood:
    """Return who stood where between the end of one track and the beginning of another.

    Where a track begins, its vehicle drove on from as far behind as a start from rest takes; there, or on the way to
    there, the former track ends, no farther off than it takes to brake.
    """
    p = told.points
    vehicle, t_s = p["vehicle"].to_numpy(int), p["t_s"].to_numpy()
    xy, velocity = p[["x_m", "y_m"]].to_numpy(), p[["vx_mps", "vy_mps"]].fillna(0.0).to_numpy()
    speed = np.hypot(*velocity.T)
    first = np.flatnonzero(np.diff(vehicle, prepend=-1))
    last = np.append(first[1:], len(p)) - 1 if len(first) else first
    several = real & (last > first)
    ends, begins = last[several & (speed[last] < _ENDS_MPS)], first[several & (speed[first] < _STARTS_MPS)]
    place = xy - velocity * (speed / (2 * _GENTLE_MPS2))[:, None]
    one, other = _pairs(xy[ends], place[begins], params.absent_m + _ENDS_MPS**2 / (2 * _GENTLE_MPS2))
    one, other = ends[one], begins[other]
    absent = t_s[other] - t_s[one]
    colour = p[["red", "green", "blue"]].groupby(vehicle).transform("median").to_numpy()
    fits = np.abs(colour[one] - colour[other]).max(axis=1, initial=0) <= params.colour_levels
    fits &= (absent > 0) & (absent <= params.absent_s) & _ahead(place[other] - xy[one], velocity[one], params.absent_m)
    one, other = one[fits], other[fits]
    best = _nearest_in_time(one, other, t_s)
    one, other = best[:, 0], best[:, 1]
    braking, starting = (2 * np.hypot(*(place[other] - xy[at]).T) / np.maximum(speed[at], 1.0) for at in (one, other))
    begin_s, end_s = t_s[one] + braking, t_s[other] - starting
    free = _nobody_passed(told, vehicle[one], place[other], begin_s, end_s) & (end_s > begin_s)
    return Stood(p["row"].to_numpy()[one][free], begin_s[free], end_s[free], place[other][free])


def _pairs(ends: Array, begins: Array, reach_m: float) -> tuple[Index, Index]:
    if not len(ends) or not len(begins):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    found = cKDTree(begins).query_ball_point(ends, reach_m)
    many = [len(each) for each in found]
    return np.repeat(np.arange(len(ends)), many), np.concatenate([*found, []]).astype(np.int64)


def _ahead(way: Array, velocity: Array, reach_m: float) -> NDArray[np.bool_]:
    """Return whether a place (n, 2) from here is within reach, or ahead as far as braking gently takes."""
    speed = np.hypot(*velocity.T)
    forward = velocity / np.maximum(speed, 1e-9)[:, None]
    along = (way * forward).sum(axis=1)
    aside = np.abs(way[:, 0] * forward[:, 1] - way[:, 1] * forward[:, 0])
    braking = (along > 0) & (along < speed**2 / (2 * _GENTLE_MPS2) + reach_m) & (aside < _LANE_M)
    return np.asarray(np.where(speed < 1.0, np.hypot(*way.T) < reach_m, braking | (np.hypot(*way.T) < reach_m / 2)))


def _nobody_passed(told: Tracked, vehicle: Index, place: Array, begin_s: Array, end_s: Array) -> NDArray[np.bool_]:
    """Return whether nobody drove through each place (k, 2) between the times."""
    spots = told.spots(np.ones(len(told.vehicles), np.bool_), 0.6)
    waiting = Spots(place, spots.half[vehicle], spots.axis[vehicle], begin_s, end_s)
    return drivers_through(waiting, told.ways(DRIVES_MPS), during=True) == 0


def _nearest_in_time(one: Index, other: Index, t_s: Array) -> Index:
    """Return the pairs of which either is the other's nearest in time."""
    order = np.lexsort((other, one, t_s[other] - t_s[one]))
    one, other = one[order], other[order]
    best = np.zeros(len(one), np.bool_)
    best[np.unique(one, return_index=True)[1]] = True
    mutual = np.zeros(len(one), np.bool_)
    mutual[np.unique(other, return_index=True)[1]] = True
    return np.stack([one, other], axis=1)[best & mutual]


def _as_detections(detections: pd.DataFrame, row: Index, t_s: Array, xy: Array) -> pd.DataFrame:
    """Return copies of detections at other times and places, with ids of their own."""
    out = detections.iloc[row].reset_index(drop=True)
    times = pd.DatetimeIndex((np.round(t_s * 1e6)).astype(np.int64).view("datetime64[us]")).tz_localize("UTC")
    ids = [f"{FILLED}{name}@{stamp}" for name, stamp in zip(out["detection_id"], times.asi8, strict=True)]
    return out.assign(detection_id=ids, t_utc=times, x_m=xy[:, 0], y_m=xy[:, 1])
