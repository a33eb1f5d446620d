"""What a flow map says between two moments: of the places of the vehicles then and now, and of ways between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.matching.candidates import Array, Edges, Index, bell

NEAREST = 32  # motions that speak for a place
VOTERS = 48  # motions that are asked in finer detail
ALIKE = np.array([1, 8, 24])  # ranks of the motions alike to which distances are told
PLACE_RANK = 8  # of the motion whose distance tells how well a place is known
ALIKE_M, ALIKE_MPS = 4.0, 5.0  # a motion is like another up to this distance, plus this much a second
UNKNOWN_M = 6.0  # places farther than this from the 8th motion are not known
PLACE_M = 4.0  # how far they speak (Gaussian sigma)
SEARCH_M, WIDER = 8.0, 1.5  # motions are first sought so near; so many times as far, if these are too few
SQUARE_M, MOST_SQUARES = 4.0, 250_000  # motions are sorted into squares of this side, or larger ones
NOTHING = 50.0  # squared distance, in variances, from which on a vote adds nothing


class Motions(NamedTuple):
    """Motions in squares of the place at one of their ends (a named tuple, because compiled code reads it).

    ``here`` (n, 2) that end, ``there`` (n, 2) the other one; those in square c are the rows from ``first[c]`` on;
    squares go by rows of ``shape[1]`` each. ``origin`` is the corner of the first and the ``side`` of all.
    """

    here: Array
    there: Array
    first: Index
    shape: tuple[int, int]
    origin: tuple[float, float, float]

    @classmethod
    def of(cls, here: Array, there: Array) -> Motions:
        """Sort motions by their ends *here*."""
        low, extent = here.min(axis=0), np.ptp(here, axis=0)
        side = max(SQUARE_M, float(np.sqrt(extent.prod() / MOST_SQUARES)), float(extent.max()) / MOST_SQUARES)
        square = np.floor((here - low) / side).astype(np.int64)
        columns, rows = (int(n) + 1 for n in square.max(axis=0))
        code = square[:, 1] * columns + square[:, 0]
        order = np.argsort(code, kind="stable")
        first = np.searchsorted(code[order], np.arange(rows * columns + 1))
        return cls(here[order], there[order], first, (rows, columns), (float(low[0]), float(low[1]), side))


class Near(NamedTuple):
    """The motions nearest to places, all (p, v): the ``weight`` with which they speak, where their far ends are (``x``,
    ``y``), and how far these are from their near ones (``dx``, ``dy``); the ``NEAREST`` ones first.

    ``known`` (p,) is the distance (m) of the motion of ``PLACE_RANK``, which tells how well a place is known.
    """

    known: Array
    weight: Array
    x: Array
    y: Array
    dx: Array
    dy: Array


@dataclass(frozen=True)
class LocalFlow:
    """Motions of a map that last *elapsed_s*, asked from places (n, 2) of one moment and (m, 2) of a later one.

    ``spread_m`` is how far displacements of vehicles at one place differ.
    """

    starting: Motions
    ending: Motions
    earlier_xy: Array
    later_xy: Array
    elapsed_s: float
    spread_m: float

    @cached_property
    def _from(self) -> Near:
        """The motions that start nearest to the earlier places (n,)."""
        return _nearest(self.starting, self.earlier_xy)

    @cached_property
    def _to(self) -> Near:
        """The motions that end nearest to the later places (m,)."""
        return _nearest(self.ending, self.later_xy)

    def possible(self, edges: Edges) -> NDArray[np.bool_]:
        """Tell which *edges* (e,) are like a motion ever seen, or lead through the unknown."""
        unknown_from, unknown_to = self._from.known > UNKNOWN_M, self._to.known > UNKNOWN_M
        alike_m = ALIKE_M + ALIKE_MPS * self.elapsed_s
        alike = _any_alike(self.starting, edges.first, edges.k, self.earlier_xy, self.later_xy, alike_m)
        return np.asarray(alike | unknown_from[edges.i] | unknown_to[edges.k])

    def mixed(self, edges: Edges, prior: Array, *, prior_weight: float) -> Array:
        """Return densities (e,) of displacements: the *prior* (e,) where nothing was seen.

        Like the votes of neighbours: (κ prior + Σ w N(d; v t)) / (κ + Σ w), with κ = *prior_weight*.
        """
        found, size = self._from, min(NEAREST, len(self.starting.here))
        votes = _votes(edges.i, edges.displacement, found.dx, found.dy, found.weight, size, np.array([self.spread_m]))
        density, weight = votes[:, 0] / (2 * np.pi * self.spread_m**2), found.weight[:, :size].sum(axis=1)
        return np.asarray((prior_weight * prior + density) / (prior_weight + weight[edges.i]))

    def evidence(self, edges: Edges) -> Array:
        """Return what the map knows of *edges*, as ten columns (e, 10).

        Distances (m) to the 1st, 8th and 24th most similar motion, to the 8th start and the 8th end of any motion; log
        shares of the motions that start (end) nearby and go (come) the same way, narrowly and widely; log of their
        number.
        """
        size = len(self.starting.here)
        ranks = np.minimum(ALIKE, size) - 1
        alike = _most_alike(self.starting, edges.first, edges.k, self.earlier_xy, self.later_xy, ranks)
        there, here = self._from.known[edges.i], self._to.known[edges.k]
        forward = self._shares(edges.i, self.later_xy[edges.k], self._from)
        backward = self._shares(edges.k, self.earlier_xy[edges.i], self._to)
        return np.column_stack([alike, there, here, forward, backward, np.full(len(edges), np.log(size))])

    def _shares(self, place: Index, other: Array, found: Near) -> Array:
        """Return the log shares (e, 2) of the motions nearest to each *place* whose far end is near *other* (e, 2)."""
        spreads = np.array([0.7 + 0.35 * self.elapsed_s, 0.8 + 1.2 * self.elapsed_s])
        votes = _votes(place, other, found.x, found.y, found.weight, found.weight.shape[1], spreads)
        return np.log((votes + 0.02) / (found.weight.sum(axis=1)[place, None] + 1))


class Found(NamedTuple):
    """Room for the motions found near a place: squared distance of this end, row, and place of the other end."""

    square: Array
    row: Index
    x: Array
    y: Array
    sum: Array


@njit(cache=True, nogil=True)
def _room(size):  # type: ignore[no-untyped-def]
    return Found(np.empty(size), np.empty(size, np.int64), np.empty(size), np.empty(size), np.empty(size))


@njit(cache=True, nogil=True)
def _within(motions, x, y, radius, found):  # type: ignore[no-untyped-def]
    """Write what lies within *radius* of (x, y); returns how many motions do."""
    rows, columns = motions.shape
    left, low, side = motions.origin
    a = int(min(max(np.floor((x - radius - left) / side), 0.0), columns - 1.0))
    b = int(min(max(np.floor((x + radius - left) / side), 0.0), columns - 1.0))
    c = int(min(max(np.floor((y - radius - low) / side), 0.0), rows - 1.0))
    d = int(min(max(np.floor((y + radius - low) / side), 0.0), rows - 1.0))
    count, limit = 0, radius * radius
    for row in range(c, d + 1):
        for s in range(motions.first[row * columns + a], motions.first[row * columns + b + 1]):
            dx, dy = motions.here[s, 0] - x, motions.here[s, 1] - y
            square = dx * dx + dy * dy
            found.square[count], found.row[count] = square, s
            found.x[count], found.y[count] = motions.there[s, 0], motions.there[s, 1]
            count += square <= limit  # what is too far is written over by the next
    return count


@njit(cache=True, nogil=True)
def _ranked(key, count, rank, high):  # type: ignore[no-untyped-def]
    """Return which of *count* keys, none negative and more than *rank* of them up to *high*, has this rank.

    By halving: keys are counted, not moved, for that goes side by side.
    """
    low, before, below = -1.0, 0, count + 1
    while before < rank and below != rank + 1:
        middle = 0.5 * (low + high)
        if middle <= low or middle >= high:
            return high  # many are equal
        below = 0
        for s in range(count):
            below += key[s] <= middle
        if below <= rank:
            low, before = middle, below
        else:
            high = middle
    if before == rank:
        least = np.inf
        for s in range(count):
            least = key[s] if low < key[s] < least else least
        return least
    greatest = 0.0
    for s in range(count):
        greatest = key[s] if greatest < key[s] <= high else greatest
    return greatest


@njit(cache=True, nogil=True)
def _nearest(motions, places):  # type: ignore[no-untyped-def]
    """Return the motions nearest to *places* (p, 2): ``VOTERS`` if there are so many, ``NEAREST`` of them first."""
    total, size = len(motions.here), len(places)
    voters, nearest, place_rank = min(VOTERS, total), min(NEAREST, total), min(PLACE_RANK, total) - 1
    known, weight, found = np.empty(size), np.empty((size, voters)), _room(total)
    x, y, dx, dy = np.empty_like(weight), np.empty_like(weight), np.empty_like(weight), np.empty_like(weight)
    first, second = np.empty(total + 1, np.int64), np.empty(total + 1, np.int64)
    for p in range(size):
        radius = SEARCH_M
        near = _within(motions, places[p, 0], places[p, 1], radius, found)
        while near < voters:
            radius *= WIDER
            near = _within(motions, places[p, 0], places[p, 1], radius, found)
        farthest = _ranked(found.square, near, voters - 1, radius * radius)
        middle = _ranked(found.square, near, nearest - 1, farthest)
        known[p] = np.sqrt(_ranked(found.square, near, place_rank, middle))
        closer, closest = 0, 0
        for s in range(near):
            closer += found.square[s] < farthest
            closest += found.square[s] < middle
        # of those that are equally far the first ones are taken
        room, more = nearest - closest, voters - nearest - max(closer - nearest, 0)
        a, b = 0, 0
        for s in range(near):
            square = found.square[s]
            equal = square == middle
            of_first = (square < middle) | (equal & (room > 0))
            room -= equal
            equal = (square == farthest) & (not of_first)
            of_second = ((square < farthest) & (not of_first)) | (equal & (more > 0))
            more -= equal
            first[a], second[b] = s, s
            a += of_first
            b += of_second
        for c in range(voters):
            s = first[c] if c < nearest else second[c - nearest]
            weight[p, c] = min(found.square[s] / PLACE_M**2, NOTHING)
            x[p, c], y[p, c] = found.x[s], found.y[s]
            row = found.row[s]
            dx[p, c], dy[p, c] = found.x[s] - motions.here[row, 0], found.y[s] - motions.here[row, 1]
        for c in range(voters):
            weight[p, c] = bell(weight[p, c])
    return Near(known, weight, x, y, dx, dy)


@njit(cache=True, nogil=True)
def _any_alike(motions, first, k, earlier_xy, later_xy, radius):  # type: ignore[no-untyped-def]
    """Tell which edges have a motion less than *radius* away, the distances at both ends taken together."""
    alike, limit, found = np.zeros(len(k), np.bool_), radius * radius, _room(len(motions.here))
    for i in range(len(earlier_xy)):
        if first[i] == first[i + 1]:
            continue
        near = _within(motions, earlier_xy[i, 0], earlier_xy[i, 1], radius, found)
        for e in range(first[i], first[i + 1]):
            x, y = later_xy[k[e], 0], later_xy[k[e], 1]
            count = 0  # all of them: this goes side by side, and ends no sooner where most edges are like none
            for s in range(near):
                dx, dy = found.x[s] - x, found.y[s] - y
                count += found.square[s] + dx * dx + dy * dy < limit
            alike[e] = count > 0
    return alike


@njit(cache=True, nogil=True)
def _most_alike(motions, first, k, earlier_xy, later_xy, ranks):  # type: ignore[no-untyped-def]
    """Return the distances (e, r) to the motions of certain *ranks* (r,), by distance at both ends taken together."""
    out, told = np.empty((len(k), len(ranks))), np.zeros(len(k), np.bool_)
    found = _room(len(motions.here))
    both, most = found.sum, ranks[-1]
    for i in range(len(earlier_xy)):
        radius, left = SEARCH_M, first[i + 1] - first[i]
        while left:
            near = _within(motions, earlier_xy[i, 0], earlier_xy[i, 1], radius, found)
            # what starts farther away is farther away altogether
            limit = radius * radius if near < len(motions.here) else np.inf
            for e in range(first[i], first[i + 1]):
                if told[e]:
                    continue
                x, y, below = later_xy[k[e], 0], later_xy[k[e], 1], 0
                for s in range(near):
                    dx, dy = found.x[s] - x, found.y[s] - y
                    both[s] = found.square[s] + dx * dx + dy * dy
                    below += both[s] < limit
                if below <= most:
                    continue
                told[e] = True
                left -= 1
                count, high = _lowest(both, near, most, limit)
                for r in range(len(ranks) - 1, -1, -1):
                    high = _ranked(both, count, ranks[r], high)
                    out[e, r] = np.sqrt(high)
            radius *= WIDER
    return out


@njit(cache=True, nogil=True)
def _lowest(key, count, rank, limit):  # type: ignore[no-untyped-def]
    """Keep, in place, those of *count* keys below a quarter of the *limit*, or all, if not more than *rank* are.

    Returns how many there are, and what none of those that matter is above.
    """
    if limit == np.inf:
        return count, key[:count].max()
    below, kept = 0, 0
    for s in range(count):
        below += key[s] < limit / 4
    if below <= rank:
        return count, limit
    for s in range(count):
        key[kept] = key[s]
        kept += key[kept] < limit / 4
    return kept, limit / 4


@njit(cache=True, nogil=True)
def _votes(place, other, x, y, weight, size, spreads):  # type: ignore[no-untyped-def]
    """Sum (e, s) over the motions of each edge's *place*: their weight, the less the farther they are from *other*.

    *x*, *y* and *weight* (p, v) are those of the motions of each place, of which *size* are asked; *spreads* (s,) those
    of the Gaussians.
    """
    out, vote = np.zeros((len(place), len(spreads))), np.zeros(size + 3)
    for e in range(len(place)):
        p = place[e]
        for s in range(len(spreads)):
            narrow = 1 / spreads[s] ** 2
            for v in range(size):
                z = ((x[p, v] - other[e, 0]) ** 2 + (y[p, v] - other[e, 1]) ** 2) * narrow
                near = bell(min(z, NOTHING)) * weight[p, v]
                vote[v] = near if z < NOTHING else 0.0
            sums = (0.0, 0.0, 0.0, 0.0)
            for v in range(0, size, 4):  # four sums beside one another need not wait for each other
                sums = (sums[0] + vote[v], sums[1] + vote[v + 1], sums[2] + vote[v + 2], sums[3] + vote[v + 3])
            out[e, s] = sums[0] + sums[1] + sums[2] + sums[3]
    return out
