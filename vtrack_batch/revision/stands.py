"""Shape and place of standing vehicles: what one sighting says otherwise is held to what all say."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.model.flags import DetectionFlag
from vtrack_batch.revision.params import RevisionParams
from vtrack_batch.revision.tracked import Tracked

_STANDS_MPS = 0.8
_FEWEST = 3
_SIZE = ["length_m", "width_m", "area_m2"]


def held(detections: pd.DataFrame, told: Tracked, real: NDArray[np.bool_], params: RevisionParams) -> pd.DataFrame:
    """Return *detections* with size, axis and place of standing vehicles held; what was changed is flagged HELD.

    Where length, width, their product or the area is off the vehicle's own medians by more than ``size_share``, sizes
    and axis become these, which are those of its drive if that was seen at least three times; a place more than
    ``jump_m`` off the median of its stand becomes that.
    """
    points = told.points
    stand = stands_of(points, params.stand_s)
    here = (stand >= 0) & (points["row"].to_numpy() >= 0) & real[points["vehicle"].to_numpy(int)]
    p, row = points[here], points["row"].to_numpy()[here]
    own = _own(told, stand).loc[p["vehicle"], [*_SIZE, "heading_deg"]].reset_index(drop=True)
    was = detections.loc[row, [*_SIZE, "heading_deg", "x_m", "y_m", "flags"]].reset_index(drop=True)
    off = (was[_SIZE] / own[_SIZE]).assign(box=was["length_m"] * was["width_m"] / (own["length_m"] * own["width_m"]))
    wrong = (np.abs(off - 1) > params.size_share).any(axis=1).to_numpy()
    middle = was[["x_m", "y_m"]].groupby(stand[here]).transform("median")
    moved = np.hypot(*(was[["x_m", "y_m"]] - middle).to_numpy().T) > params.jump_m
    out = detections.copy()
    for name in (*_SIZE, "heading_deg"):
        out.loc[row[wrong], name] = own.loc[wrong, name].to_numpy()
    for name in ("x_m", "y_m"):
        out.loc[row[moved], name] = middle.loc[moved, name].to_numpy()
    changed = wrong | moved
    flags = was.loc[changed, "flags"].to_numpy(np.int32) | np.int32(DetectionFlag.HELD)
    out.loc[row[changed], "flags"] = flags
    out["flags"] = out["flags"].astype(np.int32)
    return out


def _own(told: Tracked, stand: NDArray[np.int64]) -> pd.DataFrame:
    """Return sizes and axis of every vehicle, by number: sizes from its drive where that was seen well."""
    driving = told.points[(stand < 0) & (told.points["row"] >= 0)].groupby("vehicle")
    seen = driving[_SIZE].median()[driving.size() >= _FEWEST]
    own = told.vehicles[[*_SIZE, "heading_deg"]].copy()
    own.loc[seen.index, _SIZE] = seen
    return own


def stands_of(points: pd.DataFrame, least_s: float) -> NDArray[np.int64]:
    """Return the number of the stand that each point belongs to, -1 = drives: runs slower than 0.8 m/s."""
    slow = (points["speed_mps"] < _STANDS_MPS).to_numpy()
    vehicle, t_s = points["vehicle"].to_numpy(), points["t_s"].to_numpy()
    begins = np.r_[True, (slow[1:] != slow[:-1]) | (vehicle[1:] != vehicle[:-1])] if len(slow) else slow
    run = np.cumsum(begins) - 1
    first = np.flatnonzero(begins)
    last = np.append(first[1:], len(slow)) - 1 if len(first) else first
    long = slow[first] & (t_s[last] - t_s[first] >= least_s)
    return np.where(long, np.cumsum(long) - 1, -1)[run]
