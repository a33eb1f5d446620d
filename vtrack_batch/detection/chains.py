"""Fast, straight chains of sightings: what surely is traffic, found before anything is known of the place.

Roofs seen from moving platforms drift slowly and trees move to and fro; only vehicles hold a speed of some metres a
second along their own axis, with one colour, over four sightings; or over three that fit closely, where frames are far
apart in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.detection.params import DetectionParams

Floats = NDArray[np.float64]

_CELL_M = 1.0
# What goes to and fro does not drive.
_STRAIGHT = 0.8
_TURN = float(np.radians(25.0))
_COS_TURN = float(np.cos(_TURN))
_GROWTH = 1.6
_FEWEST_LINKS = 3
# Another vehicle may have come to the place of one.
_MOST_STANDING = 1
_ROOFS_DRIFT_MPS = 1.0


@dataclass(frozen=True, eq=False)
class Sightings:
    """Strict candidates of a frame, metres: ``xy`` (n, 2), unit ``axis`` (n, 2), ``length`` (n,), ``colour`` (n, 3)."""

    xy: Floats
    axis: Floats
    length: Floats
    colour: Floats


@dataclass(frozen=True, eq=False)
class Chains:
    """Vehicles at several frames: ``frames``, ``rows`` (m, links) = which sightings, ``lines`` (m, links, 2) where."""

    frames: NDArray[np.int64]
    rows: NDArray[np.int64]
    lines: Floats

    def take(self, chosen: NDArray[np.bool_]) -> Chains:
        """Return the chains that a mask (m,) chooses."""
        return Chains(self.frames[chosen], self.rows[chosen], self.lines[chosen])


@dataclass(frozen=True)
class Kind:
    """What a chain must be: so many ``links``, faster than ``least_mps`` where it begins, of so little ``misfit``."""

    links: int
    least_mps: float
    misfit: float = np.inf

    @property
    def loose(self) -> bool:
        """Whether a chain has so many links that it need not fit closely."""
        return not np.isfinite(self.misfit)


def kinds_of(times_s: Floats, params: DetectionParams) -> list[Kind]:
    """Return the kinds of chains that frames at *times_s* may show.

    Where frames are far apart, vehicles are gone before they were seen often: fewer sightings that span a time do, but
    must fit closely, for chance makes chains of few, and leads from one that stands to the next.
    """
    intervals = np.diff(np.sort(times_s))
    apart_s = _frame_step(intervals, params.chain_interval_s) * float(np.median(intervals)) if len(intervals) else 0.0
    fast = params.chain_links, params.chain_speed_mps, params.chain_span_s
    slow = params.slow_chain_links, params.slow_chain_speed_mps, params.slow_chain_span_s
    kinds = []
    for links, least_mps, span_s in (fast, slow):
        kinds.append(Kind(links, least_mps))
        fewer = max(_FEWEST_LINKS, 1 + int(np.ceil(span_s / apart_s - 1e-6))) if apart_s > 0 else links
        if fewer < links:
            kinds.append(Kind(fewer, least_mps, params.short_chain_misfit))
    if apart_s > 0 and all(kind.links > _FEWEST_LINKS for kind in kinds):
        # Between two bridges what is fast is seen three times; nothing but traffic is so fast.
        kinds.append(Kind(_FEWEST_LINKS, params.short_chain_speed_mps, params.short_chain_misfit))
    return kinds


def find_chains(frames: Sequence[Sightings], times_s: Floats, kind: Kind, *, params: DetectionParams) -> Chains:
    """Return all straight chains of a *kind* at successive frames.

    Where frames come faster than ``chain_interval_s``, every s-th frame counts as successive. The speed is nearly
    constant, along the axis of every box, on the whole faster than roofs seem to drift, and colours agree.
    """
    order = np.argsort(times_s, kind="stable")
    step = _frame_step(np.diff(times_s[order]), params.chain_interval_s)
    links = kind.links
    speeds = kind.least_mps, min(kind.least_mps, params.slow_chain_speed_mps), params.fastest_mps
    limits = np.array([*speeds, params.chain_miss_m, params.chain_accel_mps2, params.chain_colour])
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
        if not kind.loose:
            length = np.concatenate([part.length for part in parts])
            chosen = rows + starts[:-1]
            off = _misfit(xy[chosen], axis[chosen], length[chosen], colour[chosen], times_s[members], params)
            rows = rows[off <= kind.misfit]
        where.append(np.broadcast_to(members, rows.shape))
        which.append(rows)
        lines.append(xy[rows + starts[:-1]])
    found = Chains(np.concatenate(where), np.concatenate(which), np.concatenate(lines))
    if kind.loose:
        return found
    starts = np.cumsum([0, *(len(seen.xy) for seen in frames)])
    stands = _standing(frames, times_s, params, drift_mps=_ROOFS_DRIFT_MPS)[starts[found.frames] + found.rows]
    return found.take(stands.sum(axis=1) <= _MOST_STANDING)


def _misfit(
    lines: Floats, axis: Floats, length: Floats, colour: Floats, times_s: Floats, params: DetectionParams
) -> Floats:
    """Return for each chain (m, links, ...) the sum of the squares of what does not fit, each in parts of its limit.

    That is the miss sideways and along the way, turns of the boxes, changes of colour and of length. Chance fills the
    limits evenly, so the sum says how rare such a chain is by chance.
    """
    elapsed = np.diff(times_s)
    steps = np.diff(lines, axis=1)
    velocity = steps / elapsed[:, None]
    speed = np.maximum(np.linalg.norm(velocity, axis=2), 1e-9)
    way = velocity / speed[:, :, None]
    off = steps[:, 1:] - velocity[:, :-1] * elapsed[1:, None]
    aside = np.abs(off[..., 0] * way[:, :-1, 1] - off[..., 1] * way[:, :-1, 0])
    along = np.abs((off * way[:, :-1]).sum(axis=2))
    reach = params.chain_miss_m + params.chain_accel_mps2 * elapsed[1:] * (elapsed[:-1] + elapsed[1:]) / 2
    turned = [np.arccos(np.clip(np.abs((box * way).sum(axis=2)), 0, 1)) for box in (axis[:, :-1], axis[:, 1:])]
    changes = np.abs(np.diff(colour, axis=1)).max(axis=2)
    parts = (
        aside / params.chain_miss_m,
        along / reach,
        np.maximum(*turned) / _TURN,
        changes / params.chain_colour,
        np.diff(np.log(length), axis=1) / np.log(_GROWTH),
    )
    return np.asarray(sum((part**2).max(axis=1) for part in parts))


def supported(
    kinds: Sequence[Chains], frames: Sequence[Sightings], times_s: Floats, *, params: DetectionParams
) -> list[Chains]:
    """Return the chains along which what is seen moves: a share of ``chain_support`` is chained, the rest stands.

    Chance leads from dormer to dormer, and through a crowd, past others that stand; traffic has nothing in its way.
    What stands is seen again at its place in the frame before or after.
    """
    starts = np.cumsum([0, *(len(seen.xy) for seen in frames)])
    chained = np.zeros(starts[-1], np.bool_)
    for kind in kinds:
        chained[starts[kind.frames] + kind.rows] = True
    if not chained.any():
        return list(kinds)
    places, stands = np.concatenate([seen.xy for seen in frames]), _standing(frames, times_s, params)
    origin = places.min(axis=0) - _CELL_M
    size = ((places.max(axis=0) - origin) // _CELL_M).astype(int) + 2
    every, moving = (_crowds(places[part], origin, size) for part in (chained | stands, chained))
    shares = [_along(kind.lines, moving, origin) / _along(kind.lines, every, origin) for kind in kinds]
    return [kind.take(share >= params.chain_support) for kind, share in zip(kinds, shares, strict=True)]


def _standing(
    frames: Sequence[Sightings], times_s: Floats, params: DetectionParams, *, drift_mps: float = 0.0
) -> NDArray[np.bool_]:
    """Return which sightings, one frame after the other, are seen again nearby in the frame before or after in time.

    Nearby is what may be missed by, or what *drift_mps* reaches.
    """
    order = np.argsort(times_s, kind="stable")
    step = _frame_step(np.diff(times_s[order]), params.chain_interval_s)
    found = [np.zeros(len(seen.xy), np.bool_) for seen in frames]
    for one, other in zip(order[:-step], order[step:], strict=True):
        here, there = frames[one], frames[other]
        reach = max(params.chain_miss_m, drift_mps * float(times_s[other] - times_s[one]))
        limits = reach, params.chain_colour
        _mark_again(here.xy, here.colour, there.xy, there.colour, *limits, found[one], found[other])
    return np.concatenate(found)


@njit(cache=True, nogil=True)
def _mark_again(xy, colour, others, their_colour, reach, limit, mine, theirs):  # type: ignore[no-untyped-def]
    """Set in *mine* and *theirs* what lies within *reach* of one of the others and has its colour."""
    for i in range(len(xy)):
        for j in range(len(others)):
            if np.hypot(xy[i, 0] - others[j, 0], xy[i, 1] - others[j, 1]) > reach:
                continue
            if np.abs(colour[i] - their_colour[j]).max() <= limit:
                mine[i] = theirs[j] = True


def _crowds(places: Floats, origin: Floats, size: NDArray[np.int64]) -> Floats:
    """Return how many *places* (n, 2) lie in each cell and its neighbours; *size* = columns and rows."""
    columns, rows = size.tolist()
    cell = ((places - origin) // _CELL_M).astype(np.int64)
    count = np.bincount(cell[:, 1] * columns + cell[:, 0], minlength=rows * columns).reshape(rows, columns)
    return np.asarray(cv2.boxFilter(count.astype(np.float32), -1, (3, 3), normalize=False), np.float64)


def _along(lines: Floats, counts: Floats, origin: Floats) -> Floats:
    """Return the sum (m,) of *counts* at places evenly along each of *lines* (m, links, 2)."""
    if not len(lines):
        return np.zeros(0)
    longest = float(np.linalg.norm(np.diff(lines, axis=1), axis=2).max())
    part = np.linspace(0, 1, 2 + int(longest / _CELL_M), endpoint=False)[:, None]
    points = lines[:, :-1, None] + part * (lines[:, 1:, None] - lines[:, :-1, None])
    cell = np.floor((points - origin) / _CELL_M).astype(np.int64)
    return np.asarray(counts[cell[..., 1], cell[..., 0]].sum(axis=(1, 2)))


def _frame_step(intervals_s: Floats, wanted_s: float) -> int:
    if len(intervals_s) == 0 or not np.median(intervals_s) > 0:
        return 1
    return max(1, round(wanted_s / float(np.median(intervals_s))))


@njit(cache=True, nogil=True)
def _chains(xy, axis, colour, starts, times, limits):  # type: ignore[no-untyped-def]
    links = len(starts) - 1
    slowest, drift, fastest, miss, accel, colour_limit = limits
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
            members[:] = j
            members[0] = i
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
                way += np.hypot(xy[best, 0] - xy[last, 0], xy[best, 1] - xy[last, 1])
            last = members[links - 1]
            whole = np.hypot(xy[last, 0] - xy[i, 0], xy[last, 1] - xy[i, 1])
            if complete and whole >= max(_STRAIGHT * way, drift * (times[links - 1] - times[0])):
                for k in range(links):
                    members[k] -= starts[k]
                chains.append(members)
    found = np.empty((len(chains), links), np.int64)
    for n in range(len(chains)):
        found[n] = chains[n]
    return found


@njit(cache=True, nogil=True)
def _fits(i, j, x, y, axis, colour, limit):  # type: ignore[no-untyped-def]
    """Whether both boxes point along (x, y), within _TURN, and have one colour."""
    if abs(axis[i, 0] * x + axis[i, 1] * y) < _COS_TURN or abs(axis[j, 0] * x + axis[j, 1] * y) < _COS_TURN:
        return False
    return np.abs(colour[i] - colour[j]).max() <= limit
