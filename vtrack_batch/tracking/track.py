"""Chain detections into tracks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

from vtrack_batch.errors import ConfigError
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.model.views import Views
from vtrack_batch.tracking import tables
from vtrack_batch.tracking.ends import cut_impossible_ends
from vtrack_batch.tracking.link import link
from vtrack_batch.tracking.pairs import chain_pairs
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.tracking.paths import paths_of
from vtrack_batch.tracking.sightings import Sightings, read_detections, sightings_of

CHAINED = ("default", "untrained")
PAIRWISE = ("original", "colour", "opposite", "proposed", "assignment", "nearest")


@dataclass(frozen=True)
class Tracks:
    """What tracking finds: tables ``track_points``, ``trajectories`` and ``matches`` of the data dictionary."""

    track_points: pd.DataFrame
    trajectories: pd.DataFrame
    matches: pd.DataFrame


def track(
    detections: pd.DataFrame,
    *,
    views: Mapping[str, Views] | None = None,
    method: str = "default",
    flow_map: FlowMap | None = None,
    matching: MatchingParams | None = None,
    params: TrackingParams | None = None,
) -> Tracks:
    """Find out which detections are the same vehicle, and the path of each, sequence by sequence.

    *detections* holds ``detection_id``, ``t_utc`` (with time zone), ``x_m``, ``y_m`` and may hold ``sequence``,
    ``red, green, blue``, ``length_m``, ``width_m``; rows in any order. *views* tells times and footprints of all
    frames, also of those without detections; without it the frames are the times of the detections. *method*
    ``default`` chains over the whole sequence; the names of pair matchers chain their links without prediction.
    Columns that are missing, values that are missing or infinite, and repeated ids raise ``UnusableData``.
    """
    matching, params = matching or MatchingParams(), params or TrackingParams()
    chosen = matching.method if method == "default" else method
    if chosen not in (*CHAINED, *PAIRWISE):
        raise ConfigError(f"tracking method {method!r} is unknown")
    checked = read_detections(detections)
    found = [
        _track_sequence(
            sightings_of(rows, str(name), views.get(str(name)) if views else None, params.motion.position_sigma_m),
            chosen,
            flow_map,
            matching,
            params,
        )
        for name, rows in checked.groupby("sequence", sort=True, observed=True)
    ]
    found = found or [_track_sequence(sightings_of(checked, "all", None, 1.0), chosen, flow_map, matching, params)]
    return Tracks(
        _joined([f.track_points for f in found], ["vehicle_id", "t_utc"]),
        _joined([f.trajectories for f in found], ["vehicle_id"]),
        _joined([f.matches for f in found], ["match_id"]),
    )


def _track_sequence(
    s: Sightings, method: str, flow_map: FlowMap | None, matching: MatchingParams, params: TrackingParams
) -> Tracks:
    if method in CHAINED:
        chains = link(s, matching, params, flow_map)
        chains = cut_impossible_ends(s, chains, max_accel_mps2=params.link.max_end_accel_mps2)
    else:
        chains = chain_pairs(s, method, matching, flow_map)
    paths = paths_of(s, chains, params)
    return Tracks(
        tables.track_points(s, paths, params), tables.trajectories(s, paths, params), tables.matches(s, chains, method)
    )


def _joined(parts: list[pd.DataFrame], key: list[str]) -> pd.DataFrame:
    if len(parts) == 1:
        return parts[0]
    return pd.concat(parts, ignore_index=True).sort_values(key, ignore_index=True)
