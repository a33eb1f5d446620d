"""From trajectories to traffic: all measures of one survey, in one pass over the paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import shapely
from shapely.geometry import Point

from vtrack_batch.model.tables import TABLES
from vtrack_batch.model.views import Views
from vtrack_batch.model.zones import Zone
from vtrack_batch.traffic.bins import Bins, clock_bins, to_us, to_utc
from vtrack_batch.traffic.coverage import coverage_of, coverage_table
from vtrack_batch.traffic.crossings import line_crossings
from vtrack_batch.traffic.flows import flows_table
from vtrack_batch.traffic.junctions import junctions_of
from vtrack_batch.traffic.od import od_pairs, trips_of
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.paths import Paths, prolonged, read_paths, split_at_bins
from vtrack_batch.traffic.places import Place, names_of, places_of
from vtrack_batch.traffic.speeds import speeds_table
from vtrack_batch.traffic.stops import stops_table
from vtrack_batch.traffic.tables import declared
from vtrack_batch.traffic.turns import UNKNOWN, turns_made, turns_table
from vtrack_batch.traffic.visits import area_visits


def measure(
    trajectories: pd.DataFrame,
    track_points: pd.DataFrame,
    zones: Sequence[Zone],
    views: Mapping[str, Views],
    *,
    time_zone: str,
    params: TrafficParams | None = None,
) -> dict[str, pd.DataFrame]:
    """Return the tables trajectories, crossings, od_pairs, turns, speeds, flows, stops and coverage, as declared.

    *trajectories* needs ``vehicle_id``; ``vehicle_class``, ``start_reason``, ``end_reason`` and
    ``identity_probability`` are used where present; it comes back sorted by vehicle, with origin, destination and
    movement (the first one made) filled. *track_points* needs ``vehicle_id, t_utc, x_m, y_m``; ``speed_mps,
    speed_sigma_mps, heading_deg, state`` are used where present. *views* are the frames by sequence; *time_zone* is
    an IANA name. Order of rows does not matter. Exact for paths that are straight between track points.
    """
    params = params or TrafficParams()
    trajectories = trajectories.sort_values("vehicle_id", kind="stable", ignore_index=True)
    seen = read_paths(trajectories["vehicle_id"], track_points, params=params)
    vehicles = _vehicles(trajectories, seen)
    places = places_of(zones, site_centre=_site_centre(views, seen), params=params)
    junctions = junctions_of(zones, places)
    bins = _bins(views, vehicles, time_zone, params)
    coverage = coverage_of(views, places, bins=bins, params=params)

    entered = (vehicles["start_reason"] == "entered_view").to_numpy(bool)
    left = (vehicles["end_reason"] == "left_view").to_numpy(bool)
    paths = split_at_bins(prolonged(seen, entered, left, params=params), bins)
    crossings = line_crossings(paths, places, hysteresis_m=params.hysteresis_m)
    visits, stays = area_visits(paths, places, bins=bins, hysteresis_m=params.hysteresis_m)
    trips = trips_of(vehicles, paths, places, crossings, visits)
    turns = turns_made(junctions, places, crossings, visits)

    tables = {
        "crossings": _crossings_table(crossings, vehicles, places),
        "od_pairs": od_pairs(vehicles, trips, places, coverage=coverage, params=params),
        "turns": turns_table(vehicles, turns, junctions, places, coverage=coverage, params=params),
        "speeds": speeds_table(crossings, stays, places, coverage=coverage, params=params),
        "flows": flows_table(vehicles, crossings, stays, places, coverage=coverage, params=params),
        "stops": stops_table(vehicles, seen, places, junctions, params=params),
        "coverage": coverage_table(coverage, places),
    }
    filled = _filled(trajectories, trips, turns)
    return {"trajectories": filled, **{name: declared(table, name) for name, table in tables.items()}}


def _vehicles(trajectories: pd.DataFrame, paths: Paths) -> pd.DataFrame:
    """Return what counting needs to know of each vehicle, indexed by its number in the paths."""
    many = len(trajectories)
    given = trajectories.get("identity_probability", pd.Series(np.nan, index=trajectories.index)).astype(float)
    first, last = paths.ends
    t_first, t_last = np.zeros(many, np.int64), np.zeros(many, np.int64)
    if "t_start_utc" in trajectories and "t_end_utc" in trajectories:
        t_first, t_last = to_us(trajectories["t_start_utc"]), to_us(trajectories["t_end_utc"])
    starts_parked, ends_parked = np.zeros(many, bool), np.zeros(many, bool)
    t_first[paths.vehicle[first]], t_last[paths.vehicle[last]] = paths.t_us[first], paths.t_us[last]
    starts_parked[paths.vehicle[first]], ends_parked[paths.vehicle[last]] = paths.parked[first], paths.parked[last]
    start_reason, end_reason = _text(trajectories, "start_reason"), _text(trajectories, "end_reason")
    return pd.DataFrame(
        {
            "vehicle_id": trajectories["vehicle_id"],
            "vehicle_class": _text(trajectories, "vehicle_class"),
            "start_reason": start_reason,
            "end_reason": end_reason,
            "probability": given.fillna(1.0).clip(0.0, 1.0),
            "uncertain": given.notna(),
            "t_first_us": t_first,
            "t_last_us": t_last,
            "starts_parked": starts_parked | (start_reason == "parked"),
            "ends_parked": ends_parked | (end_reason == "parked"),
        }
    )


def _text(frame: pd.DataFrame, name: str) -> pd.Series:
    if name not in frame:
        return pd.Series("unknown", index=frame.index, dtype="object")
    return frame[name].astype("object").fillna("unknown")


def _bins(views: Mapping[str, Views], vehicles: pd.DataFrame, time_zone: str, params: TrafficParams) -> Bins:
    """Return the bins from the first to the last frame of each sequence, and those of all vehicles."""
    frames = [view.t_utc.astype("datetime64[us]").astype(np.int64) for view in views.values() if len(view)]
    start_us = np.r_[np.array([t_us[0] for t_us in frames], np.int64), vehicles["t_first_us"].to_numpy(np.int64)]
    end_us = np.r_[np.array([t_us[-1] for t_us in frames], np.int64), vehicles["t_last_us"].to_numpy(np.int64)]
    return clock_bins(start_us, end_us, time_zone=time_zone, bin_s=params.bin_s)


def _site_centre(views: Mapping[str, Views], paths: Paths) -> Point | None:
    """Return the middle of all that was ever in view; of the paths where there are no views."""
    corners = [view.corners_m.reshape(-1, 2) for view in views.values() if len(view)]
    points = np.concatenate(corners) if corners else np.stack([paths.x_m, paths.y_m], axis=1)
    return shapely.multipoints(points).convex_hull.centroid if len(points) else None


def _crossings_table(crossings: pd.DataFrame, vehicles: pd.DataFrame, places: Sequence[Place]) -> pd.DataFrame:
    over = crossings[~crossings["guessed"].astype(bool)]
    return pd.DataFrame(
        {
            "vehicle_id": vehicles["vehicle_id"].to_numpy()[over["vehicle"].to_numpy(int)],
            "gate": over["place"].map(names_of(places)).to_numpy(),
            "t_utc": to_utc(over["t_us"].to_numpy()),
            "direction": np.where(over["forward"], "forward", "backward"),
            "speed_mps": over["speed_mps"].to_numpy(),
            "speed_sigma_mps": over["sigma_mps"].to_numpy(),
        }
    )


def _filled(trajectories: pd.DataFrame, trips: pd.DataFrame, turns: pd.DataFrame) -> pd.DataFrame:
    """Return the trajectories with origin, destination and movement."""
    made = turns[turns["movement"] != UNKNOWN].drop_duplicates("vehicle").set_index("vehicle")["movement"]
    movement = made.reindex(trajectories.index).astype("str")
    filled = trajectories.assign(
        origin=trips["origin"].astype("str"), destination=trips["destination"].astype("str"), movement=movement
    )
    first = [name for name in TABLES["trajectories"].column_names if name in filled]
    return filled[[*first, *(name for name in filled if name not in first)]]
