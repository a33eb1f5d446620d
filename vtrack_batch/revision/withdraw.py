"""After the second tracking: filled sightings leave the tables, and what never moves is parked or queued."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.model.ids import vehicle_id
from vtrack_batch.revision.absences import FILLED
from vtrack_batch.revision.crossing import DRIVES_MPS, drivers_through
from vtrack_batch.revision.params import RevisionParams
from vtrack_batch.revision.tracked import Tracked


def without_filled(track_points: pd.DataFrame) -> pd.DataFrame:
    """Return *track_points* with null in place of filled sightings: what they are is predicted."""
    return track_points.assign(detection_id=track_points["detection_id"].mask(_filled(track_points["detection_id"])))


def contracted(matches: pd.DataFrame) -> pd.DataFrame:
    """Return *matches* with links by way of filled sightings made one: from the sighting before to the one after.

    The probability is the least on the way. Where the way ends at a filled sighting, the link ends in nothing.
    """
    onward = matches[_filled(matches["detection_id_from"])].set_index("detection_id_from")
    out = matches[~_filled(matches["detection_id_from"])].copy()
    while _filled(out["detection_id_to"]).any():
        open_ = _filled(out["detection_id_to"])
        after = onward.reindex(out.loc[open_, "detection_id_to"])
        out.loc[open_, "probability"] = np.fmin(out.loc[open_, "probability"], after["probability"].to_numpy())
        ends = after["detection_id_to"].isna().to_numpy()
        later = after["t_to_utc"].to_numpy()
        out.loc[open_, "t_to_utc"] = np.where(ends, out.loc[open_, "t_to_utc"], later)
        out.loc[open_, "detection_id_to"] = after["detection_id_to"].to_numpy()
    names = out[["detection_id_from", "detection_id_to"]].fillna("").astype(str)
    kept = out.assign(match_id=names["detection_id_from"] + ">" + names["detection_id_to"])
    kept = kept[kept["match_id"] != ">"]
    return kept.drop_duplicates("match_id").sort_values("match_id", ignore_index=True)


def renamed(vehicle_ids: pd.Series, track_points: pd.DataFrame) -> pd.Series:
    """Return *vehicle_ids*, those of filled sightings made from the first real one; null where there is none."""
    real = track_points[~_filled(track_points["detection_id"]) & track_points["detection_id"].notna()]
    first = real.sort_values("t_utc", kind="stable").groupby("vehicle_id")["detection_id"].first()
    names = {old: vehicle_id(new) for old, new in first.items()}
    return vehicle_ids.map(names)


def queued(told: Tracked, parked: NDArray[np.bool_], params: RevisionParams) -> NDArray[np.bool_]:
    """Return which of the *parked* vehicles (bool, by number) lie where others drive at other times."""
    out = np.zeros(len(parked), np.bool_)
    spots = told.spots(parked, params.pierced_share)
    out[parked] = drivers_through(spots, told.ways(DRIVES_MPS), during=False) >= params.pierced_by
    return out


def _filled(ids: pd.Series) -> pd.Series:
    return ids.astype("string").str.startswith(FILLED).fillna(False).astype(bool)
