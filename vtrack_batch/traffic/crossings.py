"""Where and when paths cross lines."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pandas as pd
import shapely
from shapely.geometry import LineString

from vtrack_batch.traffic.paths import Floats, Ints, Mask, Paths
from vtrack_batch.traffic.places import Place

CROSSING_COLUMNS = (
    "vehicle",
    "place",
    "segment",
    "share",
    "forward",
    "guessed",
    "t_us",
    "way_m",
    "speed_mps",
    "sigma_mps",
)


def line_crossings(paths: Paths, places: Sequence[Place], *, hysteresis_m: float) -> pd.DataFrame:
    """Return every crossing of the places that are lines, by vehicle, time and place.

    Columns as in ``CROSSING_COLUMNS``: ``forward`` = from the left of the line as drawn to its right; ``share`` = how
    far along the segment; speed and its sigma interpolated between the track points. A vehicle that wavers over a line
    without getting ``hysteresis_m`` beyond it crosses once (if it ends on the other side) or not at all.
    """
    parts = [
        _steady(paths, _crossings(paths, place.shape, number), place.shape, hysteresis_m)
        for number, place in enumerate(places)
        if place.is_line
    ]
    table = pd.concat([*parts, _table(paths, *_NONE)], ignore_index=True)
    return table.sort_values(["vehicle", "t_us", "place"], kind="stable", ignore_index=True)


_EMPTY = np.empty(0, np.int64)
_NONE = (_EMPTY, np.empty(0), np.empty(0, bool), 0)


def _crossings(paths: Paths, line: LineString, number: int) -> pd.DataFrame:
    """Return the crossings of one line in order of vehicle and time.

    A segment crosses a piece of the line where each has its ends on different sides of the other. A side is closed on
    the left only, and that of a corner is the same for both pieces that meet there, so that a path through a corner of
    the line, or a line through a point of the path, is counted once.
    """
    corners = shapely.get_coordinates(line)
    found: list[tuple[Ints, Floats, Mask]] = []
    for (ax, ay), (bx, by) in pairwise(corners):
        near = segments_near(paths, min(ax, bx), min(ay, by), max(ax, bx), max(ay, by))
        i = paths.begin[near]
        x0, y0, x1, y1 = paths.x_m[i], paths.y_m[i], paths.x_m[i + 1], paths.y_m[i + 1]
        side0 = (bx - ax) * (y0 - ay) - (by - ay) * (x0 - ax)
        side1 = (bx - ax) * (y1 - ay) - (by - ay) * (x1 - ax)
        left_a = (x1 - x0) * (ay - y0) - (y1 - y0) * (ax - x0) >= 0
        left_b = (x1 - x0) * (by - y0) - (y1 - y0) * (bx - x0) >= 0
        hit = np.flatnonzero(((side0 >= 0) != (side1 >= 0)) & (left_a != left_b))
        found.append((near[hit], side0[hit] / (side0 - side1)[hit], side0[hit] >= 0))
    segment, share, forward = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    order = np.lexsort((share, segment))
    return _table(paths, segment[order], share[order], forward[order], number)


def segments_near(paths: Paths, x0: float, y0: float, x1: float, y1: float) -> Ints:
    """Return the segments whose bounding box meets the box."""
    i = paths.begin
    xa, xb, ya, yb = paths.x_m[i], paths.x_m[i + 1], paths.y_m[i], paths.y_m[i + 1]
    meets = (np.minimum(xa, xb) <= x1) & (np.maximum(xa, xb) >= x0)
    meets &= (np.minimum(ya, yb) <= y1) & (np.maximum(ya, yb) >= y0)
    return np.flatnonzero(meets)


def _table(paths: Paths, segment: Ints, share: Floats, forward: Mask, number: int) -> pd.DataFrame:
    i = paths.begin[segment]

    def mixed(values: Floats) -> Floats:
        return values[i] + share * (values[i + 1] - values[i])

    columns = (
        paths.vehicle[i],
        np.full(len(segment), number),
        segment,
        share,
        forward,
        paths.segment_guessed[segment],
        paths.when(segment, share),
        paths.way(segment, share),
        mixed(paths.speed_mps),
        mixed(paths.sigma_mps),
    )
    return pd.DataFrame(dict(zip(CROSSING_COLUMNS, columns, strict=True)))


def _steady(paths: Paths, table: pd.DataFrame, line: LineString, hysteresis_m: float) -> pd.DataFrame:
    """Drop pairs of crossings between which the vehicle stayed within *hysteresis_m* of the line."""
    if len(table) < 2 or hysteresis_m == 0:
        return table
    vehicle, segment = table["vehicle"].to_numpy(), table["segment"].to_numpy()
    joined = (vehicle[1:] == vehicle[:-1]) & (_excursion(paths, segment, line) < hysteresis_m)
    group = np.r_[0, np.cumsum(~joined)]
    size = np.bincount(group)
    first = np.r_[True, ~joined]
    # An even number of crossings leads back to the same side; an odd one is one crossing, at the first touch.
    return table[first & (size[group] % 2 == 1)]


def _excursion(paths: Paths, segment: Ints, line: LineString) -> Floats:
    """Return how far (c-1,) from the line the path gets between each crossing and the next in the list."""
    lowest, highest = paths.begin[segment[:-1]] + 1, paths.begin[segment[1:]]
    same = paths.vehicle[lowest] == paths.vehicle[highest]
    many = np.where(same, highest - lowest + 1, 0).clip(0)
    pair = np.repeat(np.arange(len(many)), many)
    points = lowest[pair] + np.arange(len(pair)) - np.repeat(np.cumsum(many) - many, many)
    farthest = np.zeros(len(many))
    np.maximum.at(farthest, pair, shapely.distance(line, shapely.points(paths.x_m[points], paths.y_m[points])))
    return farthest
