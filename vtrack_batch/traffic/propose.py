"""Zones where none are drawn: the places at which vehicles enter and leave the view.

Ends of moving vehicles are carried on along their heading to the border of the frame that saw them, for the last
sighting lies up to one frame interval inside it. Border points are put on a 2 m raster; points with enough neighbours
within ``link_m`` are cores, cores within ``link_m`` of each other one cluster (DBSCAN: Ester et al. 1996, on counted
cells, so that a day of traffic costs no more than an hour). Each cluster becomes a zone, the hull of its ends with a
margin. Where most paths between different zones meet in one place, all zones are arms of one junction. Zones are named
by their compass bearing from the junction, or else from the middle of the view. A platform that passes by gets none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from types import MappingProxyType

import numpy as np
import pandas as pd
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from shapely.geometry import LineString, MultiPoint, Point, Polygon

from vtrack_batch.model.views import Views
from vtrack_batch.model.zones import Zone
from vtrack_batch.traffic.params import ProposalParams, TrafficParams
from vtrack_batch.traffic.paths import Floats, Ints, Mask, Paths, read_paths

_COMPASS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
_CELL_M = 2.0
JUNCTION = "junction"


@dataclass(frozen=True)
class Ends:
    """Ends of paths at the border of the view: ``vehicle`` (k,), ``seen_m`` (k, 2) and ``border_m`` (k, 2)."""

    vehicle: Ints
    is_entry: Mask
    seen_m: Floats
    border_m: Floats


def propose_zones(
    trajectories: pd.DataFrame, track_points: pd.DataFrame, views: Mapping[str, Views], *, params: TrafficParams
) -> list[Zone]:
    """Return zones (role zone, ground metres) where vehicles entered and left, in order of name; none if too few did.

    *trajectories* need vehicle_id, sequence, start_reason, end_reason; *track_points* vehicle_id, t_utc, x_m, y_m.
    Every zone holds property ``proposed``; those of a junction also its ``junction_centre_m``.
    """
    rules = params.proposal
    trajectories = trajectories.sort_values("vehicle_id", kind="stable", ignore_index=True)
    paths = read_paths(trajectories["vehicle_id"], track_points, params=params)
    ends = _ends(trajectories, paths, views, rules)
    cluster = cluster_of(ends.border_m, params=rules)
    numbers = range(int(cluster.max(initial=-1)) + 1)
    shapes = [_zone_shape(ends, cluster == number, rules) for number in numbers]
    centre = _meeting_point(ends, cluster, paths, shapes, rules)
    names = compass_names([shape.centroid for shape in shapes], Point(centre) if centre else _middle(views, shapes))
    about = {"proposed": True} if centre is None else {"proposed": True, "junction_centre_m": centre}
    junction = None if centre is None else JUNCTION
    zones = [
        Zone(name, name, "zone", shape, junction, MappingProxyType(about))
        for name, shape in zip(names, shapes, strict=True)
    ]
    return sorted(zones, key=lambda zone: zone.id)


def cluster_of(points_m: Floats, *, params: ProposalParams) -> Ints:
    """Return the cluster (k,) of each point (k, 2), -1 for none; clusters are numbered by place (x, then y)."""
    if len(points_m) == 0:
        return np.empty(0, np.int64)
    need = max(params.min_vehicles, int(np.ceil(params.min_share * len(points_m))))
    cells, of_point, many = np.unique(np.floor(points_m / _CELL_M), axis=0, return_inverse=True, return_counts=True)
    of_point = of_point.reshape(-1)
    near = cKDTree(cells * _CELL_M).query_pairs(params.link_m, output_type="ndarray")
    around = many + np.bincount(near[:, 0], many[near[:, 1]], len(cells))
    around += np.bincount(near[:, 1], many[near[:, 0]], len(cells))
    core = around >= need
    linked = near[core[near].all(axis=1)]
    graph = coo_array((np.ones(len(linked)), (linked[:, 0], linked[:, 1])), shape=(len(cells), len(cells)))
    label = connected_components(graph, directed=False)[1]
    # Cells are sorted by x, then y: numbering components by their first core cell numbers them by place.
    first = np.unique(label[core], return_index=True)
    rank = np.full(label.max() + 1, -1)
    rank[first[0][np.argsort(first[1])]] = np.arange(len(first[0]))
    return np.asarray(np.where(core, rank[label], -1)[of_point], np.int64)


def compass_names(centres: list[Point], middle: Point) -> list[str]:
    """Return a name for each point by its bearing from the middle: N, NE, ...; several of one name are numbered
    clockwise."""
    bearing = np.array([np.degrees(np.arctan2(p.x - middle.x, p.y - middle.y)) % 360 for p in centres])
    letters = [_COMPASS[int(np.round(angle / 45)) % 8] for angle in bearing]
    # North begins at 337.5 degrees: turn by half a sector, so that its zones are counted clockwise too.
    keys = [(float(angle + 22.5) % 360, p.x, p.y) for angle, p in zip(bearing, centres, strict=True)]
    order = sorted(range(len(centres)), key=keys.__getitem__)
    names = [""] * len(centres)
    for letter in sorted(set(letters)):
        same = [i for i in order if letters[i] == letter]
        for number, i in enumerate(same, 1):
            names[i] = letter if len(same) == 1 else f"{letter}{number}"
    return names


def _ends(trajectories: pd.DataFrame, paths: Paths, views: Mapping[str, Views], rules: ProposalParams) -> Ends:
    first, last = paths.ends
    net_m = np.hypot(paths.x_m[last] - paths.x_m[first], paths.y_m[last] - paths.y_m[first])
    steady = [name for name, view in views.items() if _is_steady(view, rules)] if views else trajectories["sequence"]
    at_one_place = trajectories["sequence"].isin(steady).to_numpy(bool)
    far = (net_m >= rules.min_trip_m) & at_one_place[paths.vehicle[first]]
    parts = []
    for points, inner, column, reason in (
        (first[far], 1, "start_reason", "entered_view"),
        (last[far], -1, "end_reason", "left_view"),
    ):
        told = (trajectories[column] == reason).to_numpy(bool)
        points = points[told[paths.vehicle[points]]]
        seen = np.stack([paths.x_m[points], paths.y_m[points]], axis=1)
        outward = seen - np.stack([paths.x_m[points + inner], paths.y_m[points + inner]], axis=1)
        sequence = trajectories["sequence"].to_numpy()[paths.vehicle[points]]
        border = _border_points(seen, outward, _footprints(sequence, paths.t_us[points], views), rules)
        parts.append(Ends(paths.vehicle[points], np.full(len(points), inner == 1), seen, border))
    return Ends(*(np.concatenate([getattr(part, name) for part in parts]) for name in Ends.__dataclass_fields__))


def _is_steady(view: Views, rules: ProposalParams) -> bool:
    """Return whether the platform stayed over one place: the border of a view that passes by is nobody's way in."""
    if len(view) == 0:
        return False
    drift_m = np.hypot(*np.ptp(view.corners_m.mean(axis=1), axis=0))
    size_m = np.sqrt(MultiPoint(view.corners_m[0]).convex_hull.area)
    return bool(drift_m <= rules.steady_share * size_m)


def _footprints(sequence: np.ndarray, t_us: Ints, views: Mapping[str, Views]) -> Floats:
    """Return the footprint (k, 4, 2) of the frame at or before each time; NaN where its sequence has no views."""
    out = np.full((len(t_us), 4, 2), np.nan)
    for name, view in views.items():
        mine = np.flatnonzero(sequence == name)
        if len(view) and len(mine):
            frame = np.searchsorted(view.t_utc.astype("datetime64[us]").astype(np.int64), t_us[mine], "right") - 1
            out[mine] = view.corners_m[frame.clip(0)]
    return out


def _border_points(seen: Floats, outward: Floats, corners: Floats, rules: ProposalParams) -> Floats:
    """Carry points (k, 2) on by steps *outward* to the border of their footprints (k, 4, 2).

    Where it is far that way, the vehicle has turned: take the nearest border, and where that is far too, the point.
    """
    edge_from, edge = corners, np.roll(corners, -1, axis=1) - corners
    across = outward[:, None, 0] * edge[..., 1] - outward[:, None, 1] * edge[..., 0]
    gap = edge_from - seen[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = (gap[..., 0] * edge[..., 1] - gap[..., 1] * edge[..., 0]) / across
        on = (gap[..., 0] * outward[:, None, 1] - gap[..., 1] * outward[:, None, 0]) / across
    hit = (ahead >= 0) & (on >= 0) & (on <= 1)
    steps = np.where(hit, ahead, np.inf).min(axis=1)
    reach = np.where(np.isfinite(steps), steps, 0.0)
    close = (reach <= rules.border_steps) | (reach * np.hypot(*outward.T) <= rules.border_m)
    ahead_m = seen + np.where(close, reach, 0.0)[:, None] * outward
    nearest = _nearest_on(edge_from, edge, seen)
    turned = (~close | ~np.isfinite(steps)) & (np.hypot(*(nearest - seen).T) <= rules.depth_m)
    return np.asarray(np.where(turned[:, None], nearest, ahead_m))


def _nearest_on(edge_from: Floats, edge: Floats, points: Floats) -> Floats:
    """Return the point (k, 2) nearest to each of *points* (k, 2) on the edges (k, 4, 2) around it."""
    offset = points[:, None] - edge_from
    along = ((offset * edge).sum(axis=2) / np.maximum((edge**2).sum(axis=2), 1e-12)).clip(0, 1)
    foot = edge_from + along[..., None] * edge
    best = np.argmin(np.nan_to_num(((points[:, None] - foot) ** 2).sum(axis=2), nan=np.inf), axis=1)
    return np.asarray(foot[np.arange(len(points)), best])


def _zone_shape(ends: Ends, members: Mask, rules: ProposalParams) -> Polygon:
    """Return the hull of the ends with a margin, of limited depth; corners in whole centimetres, to be readable."""
    border = ends.border_m[members]
    inwards = ends.seen_m[members] - border
    depth = np.hypot(*inwards.T)
    near = inwards * np.minimum(1.0, rules.depth_m / np.maximum(depth, rules.depth_m))[:, None]
    points = np.concatenate([border + near, border])
    grown = MultiPoint(points).convex_hull.buffer(rules.margin_m, quad_segs=2).convex_hull
    return Polygon(np.round(shapely.get_coordinates(grown), 2))


def _middle(views: Mapping[str, Views], shapes: list[Polygon]) -> Point:
    corners = [view.corners_m.reshape(-1, 2) for view in views.values() if len(view)]
    if corners:
        return MultiPoint(np.concatenate(corners)).convex_hull.centroid
    return shapely.union_all(shapes).convex_hull.centroid if shapes else Point(0, 0)


def _meeting_point(
    ends: Ends, cluster: Ints, paths: Paths, shapes: list[Polygon], rules: ProposalParams
) -> tuple[float, float] | None:
    """Return where typical paths between different pairs of zones meet outside the zones; None where they do not.

    Fewer than three zones make no junction: two ends of a road have nothing to turn to. Nor does a network, whose paths
    meet all over the place.
    """
    if len(shapes) < 3:
        return None
    outside = shapely.union_all(shapes)
    lines = [(pair, line.difference(outside)) for pair, line in _typical_paths(ends, cluster, paths)]
    met = []
    for (pair_a, a), (pair_b, b) in combinations(lines, 2):
        if set(pair_a) != set(pair_b) and not a.is_empty and not b.is_empty and a.distance(b) <= rules.meet_m:
            met.append(shapely.shortest_line(a, b).centroid.coords[0])
    if not met:
        return None
    x, y = np.median(np.array(met), axis=0)
    if np.median(np.hypot(*(np.array(met) - (x, y)).T)) > rules.junction_m:
        return None
    return round(float(x), 2), round(float(y), 2)


def _typical_paths(ends: Ends, cluster: Ints, paths: Paths) -> list[tuple[tuple[int, int], LineString]]:
    """Return for each pair (from, to) of different zones that two vehicles or more joined a path of median length."""
    placed = cluster >= 0
    entry = pd.Series(cluster[placed & ends.is_entry], index=ends.vehicle[placed & ends.is_entry], name="entry")
    leave = pd.Series(cluster[placed & ~ends.is_entry], index=ends.vehicle[placed & ~ends.is_entry], name="leave")
    joined = pd.concat([entry, leave], axis=1, join="inner").sort_index()
    first, last = paths.ends
    length = pd.Series(paths.along_m[last] - paths.along_m[first], index=paths.vehicle[first])
    joined["length"] = length.reindex(joined.index)
    start = dict(zip(paths.vehicle[first].tolist(), zip(first.tolist(), last.tolist(), strict=True), strict=True))
    out = []
    for _, group in joined[joined["entry"] != joined["leave"]].groupby(["entry", "leave"]):
        if len(group) >= 2:
            a, b = group[["entry", "leave"]].to_numpy()[0]
            chosen = group["length"].sort_values(kind="stable").index.to_numpy()[len(group) // 2]
            i, j = start[int(chosen)]
            out.append(((int(a), int(b)), LineString(np.c_[paths.x_m[i : j + 1], paths.y_m[i : j + 1]])))
    return out
