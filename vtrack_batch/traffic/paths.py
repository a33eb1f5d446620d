"""The vehicles' paths as flat arrays: straight segments between track points, split at the borders of the time bins."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.traffic.bins import SECOND_US, Bins, to_us
from vtrack_batch.traffic.params import TrafficParams

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Paths:
    """Points of all vehicles in order of vehicle, then time; all arrays are (n,).

    ``vehicle`` is the row of the vehicle in the trajectories sorted by id. ``guessed`` marks points beyond the first or
    last sighting, prolonged to find where the vehicle came from or went; they enter no speed, flow or crossing.
    """

    vehicle: Ints
    t_us: Ints
    x_m: Floats
    y_m: Floats
    speed_mps: Floats
    sigma_mps: Floats
    heading_deg: Floats
    parked: Mask
    slow: Mask
    guessed: Mask

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.vehicle)

    @cached_property
    def begin(self) -> Ints:
        """Index (s,) of the point at which each segment begins; it ends at the next point."""
        return np.flatnonzero(self.vehicle[:-1] == self.vehicle[1:])

    @cached_property
    def length_m(self) -> Floats:
        """Length (s,) of each segment."""
        i = self.begin
        return np.hypot(self.x_m[i + 1] - self.x_m[i], self.y_m[i + 1] - self.y_m[i])

    @cached_property
    def duration_s(self) -> Floats:
        """Duration (s,) of each segment."""
        return (self.t_us[self.begin + 1] - self.t_us[self.begin]) / SECOND_US

    @cached_property
    def along_m(self) -> Floats:
        """Way gone (n,) at each point; only differences within one vehicle mean something."""
        step = np.zeros(len(self))
        step[self.begin + 1] = self.length_m
        return np.cumsum(step)

    @cached_property
    def segment_guessed(self) -> Mask:
        """Whether each segment (s,) is prolonged rather than seen."""
        return np.asarray(self.guessed[self.begin] | self.guessed[self.begin + 1])

    @cached_property
    def ends(self) -> tuple[Ints, Ints]:
        """Indices of the first and last point seen of each vehicle that has points, in order of vehicle."""
        seen = np.flatnonzero(~self.guessed)
        change = np.flatnonzero(np.diff(self.vehicle[seen]))
        if len(seen) == 0:
            return seen, seen
        return seen[np.r_[0, change + 1]], seen[np.r_[change, len(seen) - 1]]

    def at(self, segment: Ints, share: Floats) -> tuple[Floats, Floats]:
        """Return the place (x_m, y_m) a *share* (0-1) of the way along each segment."""
        i = self.begin[segment]
        x = self.x_m[i] + share * (self.x_m[i + 1] - self.x_m[i])
        return x, self.y_m[i] + share * (self.y_m[i + 1] - self.y_m[i])

    def when(self, segment: Ints, share: Floats) -> Ints:
        """Return the time in microseconds a *share* of the way along each segment."""
        i = self.begin[segment]
        return self.t_us[i] + np.rint(share * (self.t_us[i + 1] - self.t_us[i])).astype(np.int64)

    def way(self, segment: Ints, share: Floats) -> Floats:
        """Return the way gone a *share* of the way along each segment."""
        return self.along_m[self.begin[segment]] + share * self.length_m[segment]


def read_paths(vehicle_ids: pd.Series, track_points: pd.DataFrame, *, params: TrafficParams) -> Paths:
    """Return the paths of the vehicles whose sorted unique ids are given; points of others are left out."""
    code = pd.Index(vehicle_ids).get_indexer(pd.Index(track_points["vehicle_id"]))
    t_us = to_us(track_points["t_utc"])
    order = np.lexsort((t_us, code))
    order = order[code[order] >= 0]
    state = _column(track_points, "state", order, text=True)
    floats = {name: _column(track_points, name, order) for name in ("speed_mps", "speed_sigma_mps", "heading_deg")}
    paths = Paths(
        vehicle=code[order].astype(np.int64),
        t_us=t_us[order],
        x_m=track_points["x_m"].to_numpy(float)[order],
        y_m=track_points["y_m"].to_numpy(float)[order],
        speed_mps=floats["speed_mps"],
        sigma_mps=floats["speed_sigma_mps"],
        heading_deg=floats["heading_deg"],
        parked=np.asarray(state == "parked", bool),
        slow=np.zeros(len(order), bool),
        guessed=np.zeros(len(order), bool),
    )
    paths = replace(paths, speed_mps=_filled_speed(paths))
    slow = (paths.speed_mps < params.stop_speed_mps) | np.isin(state, ["stopped", "parked"])
    return replace(paths, slow=slow)


def prolonged(paths: Paths, entered: Mask, left: Mask, *, params: TrafficParams) -> Paths:
    """Prolong, at constant velocity, by ``extend_steps`` frame intervals the paths that entered or left the view.

    *entered*, *left* (v,) by vehicle. A vehicle is last seen up to one interval before it leaves the view, so the gate
    or zone at the edge that it heads for is often just ahead.
    """
    first, last = paths.ends
    many = last > first
    pieces = []
    for points, inner, reason in ((first[many], 1, entered), (last[many], -1, left)):
        points = points[reason[paths.vehicle[points]] & ~paths.slow[points]]
        points = points[paths.t_us[points] != paths.t_us[points + inner]]
        step_us = paths.t_us[points] - paths.t_us[points + inner]
        stretch = params.extend_steps * np.minimum(1.0, params.max_gap_s * SECOND_US / np.abs(step_us))
        pieces.append(_beyond(paths, points, inner, stretch))
    if params.extend_steps == 0:
        return paths
    return _merged([paths, *pieces])


def split_at_bins(paths: Paths, bins: Bins) -> Paths:
    """Insert a point wherever a path goes on over the border of a bin, so that every segment lies in one bin."""
    borders = np.unique(np.r_[bins.start_us, bins.end_us])
    i = paths.begin
    from_border = np.searchsorted(borders, paths.t_us[i], "right")
    until_border = np.searchsorted(borders, paths.t_us[i + 1], "left")
    many = until_border - from_border
    if not (many > 0).any():
        return paths
    segment = np.repeat(np.arange(len(i)), np.maximum(many, 0))
    rank = np.arange(len(segment)) - np.searchsorted(segment, segment, "left")
    t_us = borders[from_border[segment] + rank]
    before = i[segment]
    share = (t_us - paths.t_us[before]) / (paths.t_us[before + 1] - paths.t_us[before])
    return _merged([paths, _between(paths, before, share, t_us)])


def _column(frame: pd.DataFrame, name: str, order: Ints, *, text: bool = False) -> NDArray:
    if name not in frame:
        return np.full(len(order), "" if text else np.nan)
    if text:
        return frame[name].astype("object").to_numpy()[order]
    return frame[name].to_numpy(dtype=float, na_value=np.nan)[order]


def _filled_speed(paths: Paths) -> Floats:
    """Return the speed at each point; where none is given, that of the segment after it, or else before it."""
    speed = paths.speed_mps.copy()
    chord = np.divide(
        paths.length_m, paths.duration_s, out=np.full(len(paths.begin), np.nan), where=paths.duration_s > 0
    )
    for points in (paths.begin, paths.begin + 1):
        missing = np.isnan(speed[points])
        speed[points[missing]] = chord[missing]
    return speed


def _beyond(paths: Paths, points: Ints, inner: int, stretch: Floats) -> Paths:
    """Return one point beyond each end: the last step once more, times *stretch*."""
    near = points + inner
    step = (paths.t_us[points] - paths.t_us[near]) * stretch
    return replace(
        _taken(paths, points),
        t_us=paths.t_us[points] + np.rint(step).astype(np.int64),
        x_m=paths.x_m[points] + stretch * (paths.x_m[points] - paths.x_m[near]),
        y_m=paths.y_m[points] + stretch * (paths.y_m[points] - paths.y_m[near]),
        guessed=np.ones(len(points), bool),
    )


def _between(paths: Paths, before: Ints, share: Floats, t_us: Ints) -> Paths:
    """Return points a *share* of the way from each point *before* to the next."""

    def mixed(values: Floats) -> Floats:
        return values[before] + share * (values[before + 1] - values[before])

    after = before + 1
    return replace(
        _taken(paths, before),
        t_us=t_us,
        x_m=mixed(paths.x_m),
        y_m=mixed(paths.y_m),
        speed_mps=mixed(paths.speed_mps),
        sigma_mps=mixed(paths.sigma_mps),
        parked=paths.parked[before] & paths.parked[after],
        slow=paths.slow[before] & paths.slow[after],
        guessed=paths.guessed[before] | paths.guessed[after],
    )


def _taken(paths: Paths, points: Ints) -> Paths:
    return Paths(**{name: getattr(paths, name)[points] for name in Paths.__dataclass_fields__})


def _merged(parts: list[Paths]) -> Paths:
    whole = Paths(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in Paths.__dataclass_fields__}
    )
    return _taken(whole, np.lexsort((whole.t_us, whole.vehicle)))
