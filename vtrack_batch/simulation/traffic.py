"""Motion: from SUMO's samples of front bumpers to the centres of vehicles at the frames, and what lines they pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
import shapely

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation.fleet import Fleet, Ints
from vtrack_batch.simulation.roadnet import RoadNet

STANDING_MPS = 0.3
_HALVINGS = 40


@dataclass(frozen=True)
class Motion:
    """All samples, by vehicle and time: (n,) arrays; ``xy_m``, ``forward`` (unit vector) (n, 2) in scene coordinates.

    ``step`` counts samples of ``period_s`` from the first frame; ``way_m`` is the way gone since departure. ``lane``
    is an index into ``lanes``, ``ahead_m`` the way from the front bumper to the lane's end.
    """

    vehicle: Ints
    step: Ints
    xy_m: Array
    forward: Array
    speed_mps: Array
    accel_mps2: Array
    way_m: Array
    standing_s: Array
    lane: Ints
    ahead_m: Array
    lanes: tuple[str, ...]
    period_s: float


@dataclass(frozen=True)
class States:
    """Vehicles on the roads at the frames: (n,) arrays sorted by frame and vehicle.

    ``xy_m`` (centres), ``velocity_mps`` and ``forward`` (unit vector of the body) are (n, 2) in scene coordinates.
    """

    frame: Ints
    vehicle: Ints
    s_m: Array
    xy_m: Array
    velocity_mps: Array
    forward: Array
    accel_mps2: Array
    standing_s: Array


def motion(samples: pd.DataFrame, fleet: Fleet, net: RoadNet, *, period_s: float) -> Motion:
    """Return where the vehicles' centres were: half a length behind the front bumper that SUMO reports.

    SUMO's angle is that of the line from rear to front bumper, so the centre is exact on straight roads and off the
    path by the sagitta of half the vehicle on bends.
    """
    vehicle = pd.Index(fleet.names).get_indexer(pd.Index(samples["name"])).astype(np.int64)
    angle = np.deg2rad(samples["angle"].to_numpy(float))
    forward = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    front = samples[["x", "y"]].to_numpy(float)
    half = fleet.looks.length_m[vehicle][:, None] / 2
    speed, accel, way, waited = (
        samples[name].to_numpy(float) for name in ("speed", "acceleration", "odometer", "waiting")
    )
    names = tuple(lane.id for lane in net.lanes)
    lengths_m = np.array([np.hypot(*np.diff(lane.shape_m, axis=0).T).sum() for lane in net.lanes])
    lane = pd.Index(names).get_indexer(pd.Index(samples["lane"])).astype(np.int64)
    ahead_m = lengths_m[lane] - samples["pos"].to_numpy(float)
    step = samples["step"].to_numpy(np.int64)
    centre = front - half * forward
    return Motion(vehicle, step, centre, forward, speed, accel, way, waited, lane, ahead_m, names, period_s)


def states_at(moved: Motion, times_s: Array) -> States:
    """Return the states at *times_s* (frames,) since the first frame, between samples by cubic interpolation."""
    by_step = np.argsort(moved.step, kind="stable")
    at = times_s / moved.period_s
    first = np.floor(at + 1e-6).astype(np.int64)
    begin, end = (np.searchsorted(moved.step[by_step], first, side=side) for side in ("left", "right"))
    row = np.concatenate([by_step[a:b] for a, b in zip(begin, end, strict=True)] or [np.zeros(0, np.int64)])
    frame = np.repeat(np.arange(len(times_s)), end - begin)
    part = np.maximum(at - first, 0.0)[frame] * (at - first > 1e-6)[frame]
    after = np.minimum(row + 1, max(len(moved.step) - 1, 0))
    followed = (moved.vehicle[after] == moved.vehicle[row]) & (moved.step[after] == moved.step[row] + 1)
    keep = (part == 0) | followed
    row, frame, part = row[keep], frame[keep], part[keep]
    after = np.where(part > 0, after[keep], row)

    def between(values: Array) -> Array:
        share = part if values.ndim == 1 else part[:, None]
        return np.asarray(values[row] * (1 - share) + values[after] * share)

    forward = between(moved.forward)
    forward /= np.hypot(*forward.T)[:, None]
    speed = between(moved.speed_mps)
    order = np.lexsort((moved.vehicle[row], frame))
    return States(
        frame[order], moved.vehicle[row][order], between(moved.way_m)[order],
        _place(moved, row, after, part)[order], (forward * speed[:, None])[order], forward[order],
        between(moved.accel_mps2)[order], between(moved.standing_s)[order],
    )  # fmt: skip


def passages(moved: Motion, lines: Array) -> pd.DataFrame:
    """Return when centres passed the *lines* (m, 2, 2) of scene metres: vehicle, line, t_s, forward, speed_mps, way_m.

    ``forward`` = from the left to the right of the line as drawn. Times are since the first frame, by cubic
    interpolation between samples.
    """
    row = np.flatnonzero((moved.vehicle[1:] == moved.vehicle[:-1]) & (moved.step[1:] == moved.step[:-1] + 1))
    pieces = shapely.linestrings(np.stack([moved.xy_m[row], moved.xy_m[row + 1]], axis=1))
    tree = shapely.STRtree(shapely.linestrings(lines) if len(lines) else [])
    piece, line = tree.query(pieces, predicate="intersects")
    row = row[piece]
    along = lines[line, 1] - lines[line, 0]
    right = np.stack([along[:, 1], -along[:, 0]], axis=1)

    def beyond(share: Array) -> Array:
        return np.asarray(((_place(moved, row, row + 1, share) - lines[line, 0]) * right).sum(axis=1))

    before, after = beyond(np.zeros(len(row))) < 0, beyond(np.ones(len(row))) < 0
    low, high = np.zeros(len(row)), np.ones(len(row))
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        same = (beyond(middle) < 0) == before
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    found = pd.DataFrame(
        {
            "vehicle": moved.vehicle[row],
            "line": line,
            "t_s": (moved.step[row] + high) * moved.period_s,
            "forward": before,
            "speed_mps": moved.speed_mps[row] * (1 - high) + moved.speed_mps[row + 1] * high,
            "way_m": moved.way_m[row] * (1 - high) + moved.way_m[row + 1] * high,
        }
    )
    return found[before != after].sort_values(["vehicle", "t_s", "line"], ignore_index=True)


def _place(moved: Motion, row: Ints, after: Ints, share: Array) -> Array:
    """Return the centres (n, 2) at the *share* of the time from sample *row* to *after*: Hermite's cubic."""
    u = share[:, None]
    velocity = moved.forward * moved.speed_mps[:, None] * moved.period_s
    p0, p1, v0, v1 = moved.xy_m[row], moved.xy_m[after], velocity[row], velocity[after]
    bend = u * (1 - u) ** 2 * v0 - u**2 * (1 - u) * v1
    # where both are one sample, there is nothing to bend
    moving = np.where((after != row)[:, None], bend, 0.0)
    return np.asarray((1 + 2 * u) * (1 - u) ** 2 * p0 + u**2 * (3 - 2 * u) * p1 + moving)
