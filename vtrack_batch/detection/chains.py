"""Fast, straight chains of sightings: what surely is traffic, found before anything is known of the place.

Roofs seen from moving platforms drift slowly and trees move to and fro; only vehicles hold a speed of some metres a
second along their own axis, with one colour, over four sightings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.detection.params import DetectionParams

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sightings:
    """Strict candidates of one frame in metres: ``xy`` (n, 2), unit ``axis`` (n, 2), ``colour`` (n, 3)."""

    xy: Floats
    axis: Floats
    colour: Floats


@dataclass(frozen=True, eq=False)
class Chains:
    """Vehicles at several frames: ``frames``, ``rows`` (m, links) = which sightings, ``lines`` (m, links, 2) where."""

    frames: NDArray[np.int64]
    rows: NDArray[np.int64]
    lines: Floats


def find_chains(
    frames: Sequence[Sightings], times_s: Floats, *, links: int, least_mps: float, params: DetectionParams
) -> Chains:
    """Return all chains of *links* sightings at successive frames, faster than *least_mps* all the way.

    Where frames come faster than ``chain_interval_s``, every s-th frame counts as successive. The speed is nearly
    constant, along the axis of every box, and colours agree.
    """
    order = np.argsort(times_s, kind="stable")
    step = _frame_step(np.diff(times_s[order]), params.chain_interval_s)
    limits = np.array(
        [least_mps, params.fastest_mps, params.chain_miss_m, params.chain_accel_mps2, params.chain_colour]
    )
    where, which = [np.zeros((0, links), np.int64)], [np.zeros((0, links), np.int64)]
    lines = [np.zeros((0, links, 2))]
    for first in range(len(order) - (links - 1) * step):
        members = order[first + step * np.arange(links)]
        parts = [frames[i] for i in members]
        starts = np.cumsum([0, *(len(part.xy) for part in parts)])
        xy, axis, colour = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("xy", "axis", "colour")
        )
        rows = _chains(xy, axis, colour, starts, times_s[members], limits)
        where.append(np.broadcast_to(members, rows.shape))
        which.append(rows)
        lines.append(xy[rows + starts[:-1]])
    return Chains(np.concatenate(where), np.concatenate(which), np.concatenate(lines))


def _frame_step(intervals_s: Floats, wanted_s: float) -> int:
    if len(intervals_s) == 0 or not np.median(intervals_s) > 0:
        return 1
    return max(1, round(wanted_s / float(np.median(intervals_s))))


@njit(cache=True, nogil=True)
def _chains(xy, axis, colour, starts, times, limits):  # type: ignore[no-untyped-def]
    links = len(starts) - 1
    slowest, fastest, miss, accel, colour_limit = limits
    chains = []
    for i in range(starts[0], starts[1]):
        for j in range(starts[1], starts[2]):
            elapsed = times[1] - times[0]
            dx, dy = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
            way = np.hypot(dx, dy)
            if way < slowest * elapsed or way > fastest * elapsed:
                continue
            if not _fits(i, j, dx / way, dy / way, axis, colour, colour_limit):
                continue
            members = np.empty(links, np.int64)
            members[0], members[1] = i, j
            complete = True
            for k in range(2, links):
                last, before = members[k - 1], members[k - 2]
                elapsed, ahead = times[k - 1] - times[k - 2], times[k] - times[k - 1]
                vx = (xy[last, 0] - xy[before, 0]) / elapsed
                vy = (xy[last, 1] - xy[before, 1]) / elapsed
                speed = np.hypot(vx, vy)
                if speed == 0.0:
                    complete = False
                    break
                reach = miss + accel * ahead * (elapsed + ahead) / 2
                best, nearest = -1, reach
                for n in range(starts[k], starts[k + 1]):
                    ex, ey = xy[n, 0] - xy[last, 0] - vx * ahead, xy[n, 1] - xy[last, 1] - vy * ahead
                    away = np.hypot(ex, ey)
                    # Speed may change along the way, the way itself is straight.
                    aside = abs(ex * vy - ey * vx) / speed
                    if (
                        away <= nearest
                        and aside <= miss
                        and _fits(last, n, vx / speed, vy / speed, axis, colour, colour_limit)
                    ):
                        best, nearest = n, away
                if best < 0:
                    complete = False
                    break
                members[k] = best
            if complete:
                for k in range(links):
                    members[k] -= starts[k]
                chains.append(members)
    found = np.empty((len(chains), links), np.int64)
    for n in range(len(chains)):
        found[n] = chains[n]
    return found


@njit(cache=True, nogil=True)
def _fits(i, j, x, y, axis, colour, limit):  # type: ignore[no-untyped-def]
    """Whether both boxes point along (x, y), within 25 degrees, and have one colour."""
    if abs(axis[i, 0] * x + axis[i, 1] * y) < 0.906 or abs(axis[j, 0] * x + axis[j, 1] * y) < 0.906:
        return False
    return np.abs(colour[i] - colour[j]).max() <= limit
