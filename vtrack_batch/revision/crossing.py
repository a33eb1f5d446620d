"""Who drives through a place: paths between two frames against boxes that lie still for a while."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DRIVES_MPS = 2.0
"""Faster than this from one frame to the next is a drive; slower may be the noise of one that stands."""


@dataclass(frozen=True, eq=False)
class Ways:
    """What vehicles drove from one frame to the next: ``start``, ``stop`` (n, 2), ``begin_s``, ``end_s`` (n,)."""

    vehicle: Index
    start: Array
    stop: Array
    begin_s: Array
    end_s: Array


@dataclass(frozen=True, eq=False)
class Spots:
    """Boxes that lie still: ``centre`` (k, 2), ``half`` (k, 2) along and across, ``axis`` (k, 2) unit, and when."""

    centre: Array
    half: Array
    axis: Array
    begin_s: Array
    end_s: Array


def drivers_through(spots: Spots, ways: Ways, *, during: bool) -> Index:
    """Return how many vehicles (k,) drive through each spot, while it is there or, not *during*, at other times."""
    spot, way = _near(spots, ways)
    within = (ways.begin_s[way] >= spots.begin_s[spot]) & (ways.end_s[way] <= spots.end_s[spot])
    outside = (ways.end_s[way] < spots.begin_s[spot]) | (ways.begin_s[way] > spots.end_s[spot])
    chosen = within if during else outside
    spot, way = spot[chosen], way[chosen]
    through = _pierces(spots, ways, spot, way)
    pairs = np.unique(np.stack([spot[through], ways.vehicle[way[through]]], axis=1), axis=0)
    return np.bincount(pairs[:, 0], minlength=len(spots.centre))


def _near(spots: Spots, ways: Ways) -> tuple[Index, Index]:
    """Return pairs of a spot and a way that may meet; long ways are sought apart, so that short ones stay cheap."""
    if not len(spots.centre) or not len(ways.vehicle):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    tree = cKDTree(spots.centre)
    reach = 0.5 * np.hypot(*(ways.stop - ways.start).T)
    found = tree.query_ball_point((ways.start + ways.stop) / 2, reach + float(np.hypot(*spots.half.T).max()))
    many = np.array([len(each) for each in found])
    return np.concatenate([*found, []]).astype(np.int64), np.repeat(np.arange(len(found)), many)


def _pierces(spots: Spots, ways: Ways, spot: Index, way: Index) -> NDArray[np.bool_]:
    """Return whether each way enters its spot: the straight line clipped at all four sides (Liang and Barsky 1984)."""
    axis = spots.axis[spot]
    side = np.stack([-axis[:, 1], axis[:, 0]], axis=1)
    start, stop = (ends[way] - spots.centre[spot] for ends in (ways.start, ways.stop))
    first, last = np.zeros(len(spot)), np.ones(len(spot))
    for direction, half in ((axis, spots.half[spot, 0]), (side, spots.half[spot, 1])):
        here, there = (start * direction).sum(axis=1), (stop * direction).sum(axis=1)
        run = np.where(np.abs(there - here) < 1e-9, 1e-9, there - here)
        into, out = (-half - here) / run, (half - here) / run
        first, last = np.maximum(first, np.minimum(into, out)), np.minimum(last, np.maximum(into, out))
    return np.asarray(first <= last)
