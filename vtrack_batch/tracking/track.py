"""Chain detections into tracks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import pandas as pd

from vtrack_batch.errors import ConfigError
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.params import METHODS, MatchingParams
from vtrack_batch.model.views import Views
from vtrack_batch.tracking import tables
from vtrack_batch.tracking.ends import cut_impossible_ends
from vtrack_batch.tracking.identity import calibrated, identity_probability
from vtrack_batch.tracking.link import Chains
from vtrack_batch.tracking.pairs import chain_pairs
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.tracking.paths import paths_of
from vtrack_batch.tracking.regions import chain_regions
from vtrack_batch.tracking.sightings import Sightings, read_detections, sightings_of
from vtrack_batch.tracking.teach import Taught
from vtrack_batch.tracking.windows import linked_in_windows

CHAINED = ("default", "untrained")
REGIONS = "regions"


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
    chosen = chosen_method(method, matching)
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
    return joined(found)


def chosen_method(method: str, matching: MatchingParams) -> str:
    """Return the method that *method* stands for; raises ``ConfigError`` where there is none of that name."""
    chosen = matching.method if method == "default" else method
    if chosen not in METHODS:
        raise ConfigError(f"tracking method {method!r} is unknown; there are {', '.join(METHODS)}")
    return chosen


def _track_sequence(
    s: Sightings, method: str, flow_map: FlowMap | None, matching: MatchingParams, params: TrackingParams
) -> Tracks:
    return joined(list(track_runs([s], method, flow_map, matching, params)))


def track_runs(
    runs: Iterable[Sightings], method: str, flow_map: FlowMap | None, matching: MatchingParams, params: TrackingParams
) -> Iterator[Tracks]:
    """Yield the tracks of one sequence that comes in *runs* of successive frames, as they end."""

    taught = Taught(matching.model_copy(update={"method": method}), params, flow_map)

    def linked(s: Sightings) -> Chains:
        if method in CHAINED:
            return cut_impossible_ends(s, calibrated(taught(s)), max_accel_mps2=params.link.max_end_accel_mps2)
        if method == REGIONS:
            return chain_regions(s, matching.regions, params)
        return chain_pairs(s, method, matching, flow_map)

    # regions are followed by what was, however long ago: cheap, so a window may hold any number of them
    windows = params.windows.model_copy(update={"window_sightings": 10**12}) if method == REGIONS else params.windows
    for s, chains in linked_in_windows(runs, linked, windows, params.link.coast_s):
        paths = paths_of(s, chains, params)
        found = tables.trajectories(s, paths, params)
        if method in CHAINED:
            by_id = pd.Series(identity_probability(chains, paths), index=tables.vehicle_ids(s, paths), dtype=float)
            found["identity_probability"] = found["vehicle_id"].map(by_id).astype(float)
        yield Tracks(
            tables.track_points(s, paths, params),
            found,
            tables.matches(s, chains, method),
        )


def joined(parts: list[Tracks]) -> Tracks:
    """Return one set of tables, in the order of their keys."""
    return Tracks(
        _joined([p.track_points for p in parts], ["vehicle_id", "t_utc"]),
        _joined([p.trajectories for p in parts], ["vehicle_id"]),
        _joined([p.matches for p in parts], ["match_id"]),
    )


def _joined(parts: list[pd.DataFrame], key: list[str]) -> pd.DataFrame:
    if len(parts) == 1:
        return parts[0]
    return pd.concat(parts, ignore_index=True).sort_values(key, ignore_index=True)
