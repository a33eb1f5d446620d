"""When paths were inside areas: exact entries and exits, and the way and time spent there in each time bin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import shapely
from shapely.geometry import Polygon

from vtrack_batch.traffic.bins import Bins
from vtrack_batch.traffic.crossings import segments_near
from vtrack_batch.traffic.paths import Floats, Ints, Paths
from vtrack_batch.traffic.places import Place

VISIT_COLUMNS = (
    "vehicle", "place", "t_in_us", "t_out_us", "way_in_m", "way_out_m", "x_in_m", "y_in_m", "x_out_m", "y_out_m",
    "begins", "ends",
)  # fmt: skip
STAY_COLUMNS = ("vehicle", "place", "bin", "distance_m", "time_s")
_CHUNK = 2_000_000
_SAME_M = 1e-6


@dataclass(frozen=True)
class Pieces:
    """Parts of segments that lie inside one area, by segment and share: all arrays (p,)."""

    segment: Ints
    share_in: Floats
    share_out: Floats


def area_visits(
    paths: Paths, places: Sequence[Place], *, bins: Bins, hysteresis_m: float
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the visits and the stays of all vehicles in the places that are areas.

    Visits: one row per unbroken time inside, by vehicle, entry and place; ``begins`` = the vehicle is not seen before,
    ``ends`` = nor after. Two visits are one where the way between them is shorter than twice ``hysteresis_m``.
    Stays: way and time inside per vehicle, place and bin, without prolonged and parked parts; segments must not
    straddle bins.
    """
    visits, stays = [pd.DataFrame(columns=list(VISIT_COLUMNS))], [pd.DataFrame(columns=list(STAY_COLUMNS))]
    for number, place in enumerate(places):
        if not place.is_line:
            pieces = clip(paths, place.shape)
            visits.append(_visits(paths, pieces, number, 2 * hysteresis_m))
            stays.append(_stays(paths, pieces, number, bins))
    return _joined(visits, ["vehicle", "t_in_us", "place"]), _joined(stays, ["vehicle", "place", "bin"])


def clip(paths: Paths, area: Polygon) -> Pieces:
    """Return the parts of all segments inside the area, exactly, holes and hollows included.

    Segments that do not touch the border are inside or outside as a whole; the few others are cut at every edge and
    each part is judged by its middle.
    """
    near = segments_near(paths, *area.bounds)
    i = paths.begin[near]
    x0, y0, x1, y1 = paths.x_m[i], paths.y_m[i], paths.x_m[i + 1], paths.y_m[i + 1]
    border = area.boundary
    shapely.prepare(area)
    shapely.prepare(border)
    touching = np.zeros(len(near), bool)
    moving = np.flatnonzero((x0 != x1) | (y0 != y1))
    ends = np.stack([x0, y0, x1, y1], axis=-1)[moving].reshape(-1, 2, 2)
    touching[moving] = shapely.intersects(border, shapely.linestrings(ends))
    whole = near[~touching & shapely.contains_xy(area, x0, y0)]
    cut = near[touching]
    edges = _edges(area)
    step = max(1, _CHUNK // len(edges))
    parts = [_cut(paths, cut[k : k + step], area, edges) for k in range(0, len(cut), step)]
    segment = np.concatenate([whole, *(part.segment for part in parts)])
    share_in = np.concatenate([np.zeros(len(whole)), *(part.share_in for part in parts)])
    share_out = np.concatenate([np.ones(len(whole)), *(part.share_out for part in parts)])
    order = np.lexsort((share_in, segment))
    return Pieces(segment[order], share_in[order], share_out[order])


def _edges(area: Polygon) -> Floats:
    """Return the edges (m, 2, 2) of all rings."""
    rings = [shapely.get_coordinates(ring) for ring in (area.exterior, *area.interiors)]
    return np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])


def _cut(paths: Paths, segment: Ints, area: Polygon, edges: Floats) -> Pieces:
    """Cut segments (k,) at the edges (m, 2, 2) and return the parts whose middle is inside."""
    i = paths.begin[segment]
    px, py = paths.x_m[i][:, None], paths.y_m[i][:, None]
    dx, dy = paths.x_m[i + 1][:, None] - px, paths.y_m[i + 1][:, None] - py
    (ax, ay), (ex, ey) = edges[:, 0].T, (edges[:, 1] - edges[:, 0]).T
    across = dx * ey - dy * ex
    with np.errstate(divide="ignore", invalid="ignore"):
        share = ((ax - px) * ey - (ay - py) * ex) / across
        on = ((ax - px) * dy - (ay - py) * dx) / across
    hit = (share > 0) & (share < 1) & (on >= 0) & (on <= 1)
    cuts = np.sort(np.where(hit, share, 1.0), axis=1)[:, : hit.sum(axis=1).max(initial=0)]
    cuts = np.concatenate([np.zeros((len(i), 1)), cuts, np.ones((len(i), 1))], axis=1)
    middle = (cuts[:, 1:] + cuts[:, :-1]) / 2
    inside = shapely.contains_xy(area, px + middle * dx, py + middle * dy) & (np.diff(cuts, axis=1) > 1e-12)
    row, col = np.nonzero(inside)
    return Pieces(segment[row], cuts[row, col], cuts[row, col + 1])


def _visits(paths: Paths, pieces: Pieces, number: int, bridge_m: float) -> pd.DataFrame:
    vehicle = paths.vehicle[paths.begin[pieces.segment]]
    way_in, way_out = paths.way(pieces.segment, pieces.share_in), paths.way(pieces.segment, pieces.share_out)
    same = vehicle[1:] == vehicle[:-1]
    touching = (pieces.segment[1:] == pieces.segment[:-1]) & (pieces.share_in[1:] == pieces.share_out[:-1])
    touching |= (
        (pieces.segment[1:] == pieces.segment[:-1] + 1) & (pieces.share_in[1:] == 0) & (pieces.share_out[:-1] == 1)
    )
    new = np.flatnonzero(np.r_[True, ~(same & (touching | (way_in[1:] - way_out[:-1] < bridge_m)))])[: len(vehicle)]
    last = np.r_[new[1:] - 1, len(vehicle) - 1][: len(new)]
    segment_in, segment_out = pieces.segment[new], pieces.segment[last]
    share_in, share_out = pieces.share_in[new], pieces.share_out[last]
    first, last_seen = (_by_vehicle(paths, points) for points in paths.ends)
    columns = (
        vehicle[new],
        np.full(len(new), number),
        paths.when(segment_in, share_in),
        paths.when(segment_out, share_out),
        way_in[new],
        way_out[last],
        *paths.at(segment_in, share_in),
        *paths.at(segment_out, share_out),
        way_in[new] <= first[vehicle[new]] + _SAME_M,
        way_out[last] >= last_seen[vehicle[new]] - _SAME_M,
    )
    return pd.DataFrame(dict(zip(VISIT_COLUMNS, columns, strict=True)))


def _by_vehicle(paths: Paths, points: Ints) -> Floats:
    """Return the way gone at one point per vehicle, indexed by vehicle."""
    way = np.full(int(paths.vehicle.max(initial=-1)) + 1, np.nan)
    way[paths.vehicle[points]] = paths.along_m[points]
    return way


def _stays(paths: Paths, pieces: Pieces, number: int, bins: Bins) -> pd.DataFrame:
    begin = paths.begin[pieces.segment]
    counted = ~paths.segment_guessed[pieces.segment] & ~(paths.parked[begin] & paths.parked[begin + 1])
    segment, begin = pieces.segment[counted], begin[counted]
    share = (pieces.share_out - pieces.share_in)[counted]
    vehicle, of_bin = paths.vehicle[begin], bins.index(paths.t_us[begin])
    new = np.flatnonzero(np.r_[True, (np.diff(vehicle) != 0) | (np.diff(of_bin) != 0)])[: len(vehicle)]
    columns = (
        vehicle[new],
        np.full(len(new), number),
        of_bin[new],
        _sums(share * paths.length_m[segment], new),
        _sums(share * paths.duration_s[segment], new),
    )
    return pd.DataFrame(dict(zip(STAY_COLUMNS, columns, strict=True)))


def _sums(values: Floats, new: Ints) -> Floats:
    return np.add.reduceat(values, new) if len(new) else np.empty(0)


def _joined(parts: list[pd.DataFrame], by: list[str]) -> pd.DataFrame:
    """Join tables, keeping the types of those that have rows."""
    filled = [part for part in parts if len(part)]
    table = pd.concat(filled, ignore_index=True) if filled else parts[0].astype(float)
    flags = [name for name in ("begins", "ends") if name in table]
    whole = ["vehicle", "place", *(name for name in ("bin", "t_in_us", "t_out_us") if name in table)]
    table = table.astype({**dict.fromkeys(flags, bool), **dict.fromkeys(whole, "int64")})
    return table.sort_values(by, kind="stable", ignore_index=True)
