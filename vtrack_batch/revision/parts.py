"""Parts of one vehicle: boxes that drive so close behind one another that no driver would.

A lorry with a light load, or a bus with dark windows, may come as two boxes, each with a track of its own. Vehicles
that follow one another leave a gap that they pass in half a second at least; parts of one vehicle leave none.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from vtrack_batch.revision.params import RevisionParams
from vtrack_batch.revision.tracked import Tracked

_LONGEST_M = 20.0  # no vehicle is longer
_DRIVES_MPS = 4.0  # slower ones may be a queue
_APART = 1e6  # metres a second: sightings of different frames are never near one another
_FEWEST = 2  # moments that two boxes must drive like one
_GAP_M = 4.0  # parts of one vehicle are no farther from one another
_PLACE = ["x_m", "y_m", "col_px", "row_px"]


def joined_parts(
    detections: pd.DataFrame, told: Tracked, params: RevisionParams
) -> tuple[pd.DataFrame, NDArray[np.int64]]:
    """Return *detections* with one box where parts of one vehicle were seen together, and the rows too many then."""
    seen = told.points[told.points["row"] >= 0].reset_index(drop=True)
    a, b = _together(seen)
    vehicle, length = seen["vehicle"].to_numpy(int), seen["length_m"].to_numpy()
    whole = _wholes(seen, a, b, len(told.vehicles), params)
    # a track may go astray: only what is close here and now is of one box
    away = np.hypot(*(seen[["x_m", "y_m"]].to_numpy()[b] - seen[["x_m", "y_m"]].to_numpy()[a]).T)
    close = (whole[vehicle[a]] == whole[vehicle[b]]) & (away - 0.5 * (length[a] + length[b]) < _GAP_M)
    box = _connected(a[close], b[close], len(seen))
    seen = seen.assign(box=box)[np.bincount(box, minlength=1)[box] > 1]
    return (detections, np.zeros(0, np.int64)) if seen.empty else _with_hulls(detections, seen, told)


def _wholes(
    seen: pd.DataFrame, a: NDArray[np.int64], b: NDArray[np.int64], vehicles: int, params: RevisionParams
) -> NDArray[np.int64]:
    """Return for every vehicle by number which whole it is of: those that mostly drive like one, in pairs *a*, *b*."""
    v = 0.5 * (seen[["vx_mps", "vy_mps"]].to_numpy()[a] + seen[["vx_mps", "vy_mps"]].to_numpy()[b])
    speed = np.hypot(*v.T)
    drives = speed > _DRIVES_MPS
    a, b, u, speed = a[drives], b[drives], v[drives] / speed[drives, None], speed[drives]
    apart = seen[["x_m", "y_m"]].to_numpy()[b] - seen[["x_m", "y_m"]].to_numpy()[a]
    along, across = np.abs((apart * u).sum(axis=1)), np.abs(apart[:, 0] * u[:, 1] - apart[:, 1] * u[:, 0])
    length, vehicle = seen["length_m"].to_numpy(), seen["vehicle"].to_numpy(int)
    gap = along - 0.5 * (length[a] + length[b])
    pairs = pd.DataFrame(
        {
            "a": np.minimum(vehicle[a], vehicle[b]),
            "b": np.maximum(vehicle[a], vehicle[b]),
            "like_one": (gap < params.part_gap_s * speed) & (across < params.part_across_m),
        }
    )
    told = pairs.groupby(["a", "b"])["like_one"].agg(["sum", "mean"]).reset_index()
    told = told[(told["sum"] >= _FEWEST) & (told["mean"] >= params.part_share)]
    return _connected(told["a"].to_numpy(), told["b"].to_numpy(), vehicles)


def _connected(a: NDArray[np.int64], b: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Return which of the groups that pairs *a*, *b* (n,) connect each of *size* things is of."""
    joined = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(size, size))
    return np.asarray(connected_components(joined, directed=False)[1], np.int64)


def _together(seen: pd.DataFrame) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs of rows of *seen* that are of one moment and near one another."""
    if len(seen) < 2:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    at = np.column_stack([seen["x_m"], seen["y_m"], _APART * (seen["t_s"] - seen["t_s"].min())])
    near = cKDTree(at).query_pairs(_LONGEST_M, output_type="ndarray")
    return near[:, 0], near[:, 1]


def _with_hulls(detections: pd.DataFrame, seen: pd.DataFrame, told: Tracked) -> tuple[pd.DataFrame, NDArray[np.int64]]:
    """Write into one row of each box the one around all its parts; return the other rows too.

    The row is that of the vehicle seen most often. The middle lies on the line between the first and the last part, so
    that its pixels follow from theirs.
    """
    sightings = told.vehicles["sightings"].to_numpy()
    part = detections.loc[seen["row"], [*_PLACE, "length_m", "width_m", "area_m2", "heading_deg"]].reset_index(
        drop=True
    )
    of = np.unique(seen["box"], return_inverse=True)[1]
    often = sightings[seen["vehicle"].to_numpy(int)]
    main = np.lexsort((seen["vehicle"].to_numpy(), -often, of))
    main = main[np.r_[True, np.diff(of[main]) > 0]]
    turn = np.radians(part["heading_deg"].to_numpy()[main])[of]
    along = part["x_m"].to_numpy() * np.sin(turn) + part["y_m"].to_numpy() * np.cos(turn)
    ends = pd.DataFrame({"low": along - 0.5 * part["length_m"], "high": along + 0.5 * part["length_m"]}).groupby(of)
    low, high = ends["low"].min().to_numpy(), ends["high"].max().to_numpy()
    order = np.lexsort((along, of))
    begins = np.r_[True, np.diff(of[order]) > 0]
    first, last = order[begins], order[np.r_[begins[1:], True]]
    share = (0.5 * (low + high) - along[first]) / np.maximum(along[last] - along[first], 0.5)
    share = np.clip(share, 0, 1)[:, None]
    place = (1 - share) * part.loc[first, _PLACE].to_numpy() + share * part.loc[last, _PLACE].to_numpy()
    width = part["width_m"].groupby(of).max().to_numpy()
    area = part["area_m2"].groupby(of).sum().to_numpy()
    fits, row = high - low <= _LONGEST_M, seen["row"].to_numpy()
    kept = row[main[fits]]
    out = detections.copy()
    out.loc[kept, _PLACE] = place[fits]
    for name, values in {"length_m": high - low, "width_m": width, "area_m2": area}.items():
        out.loc[kept, name] = values[fits]
    return out, np.setdiff1d(row[fits[of]], kept)
