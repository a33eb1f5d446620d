"""How much traffic passed: counts over gates, and Edie's flow and density in areas.

Over a region of length L watched for a time T, with total way d and total time t of the vehicles in it (Edie 1963):
flow q = d / (L T), density k = t / (L T), space-mean speed v = d / t, so that q = k v. L is a lane's own length where
it is drawn as a line, an area's size over its ``width_m`` where that is given, else the longer side of its smallest
enclosing rectangle; property ``length_m`` overrides them. Where only part of the area is in view, L T is the time
integral of the visible part. Parked vehicles are no traffic.

The count of a place is of vehicles crossing or visiting it in the bin. It needs no identity, so it has no interval.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from vtrack_batch.traffic.coverage import Coverage, status_of
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.paths import Floats
from vtrack_batch.traffic.places import Place
from vtrack_batch.traffic.speeds import SLOWEST_MPS, named, observed_seconds
from vtrack_batch.traffic.tables import blank_where, cell_of, grid, per_hour, with_all_classes


def flows_table(
    vehicles: pd.DataFrame,
    crossings: pd.DataFrame,
    stays: pd.DataFrame,
    places: Sequence[Place],
    *,
    coverage: Coverage,
    params: TrafficParams,
) -> pd.DataFrame:
    """Return the table ``flows``: every place in every bin for class ``all``, and single classes that occur there."""
    events = with_all_classes(_events(vehicles, crossings, stays, coverage))
    keys = ["place", "vehicle_class"]
    possible = pd.DataFrame({"place": np.arange(len(places)), "vehicle_class": "all"})
    cells = grid(pd.concat([possible, events[keys]]).drop_duplicates(ignore_index=True), coverage.bins)
    row = cell_of(cells, events, [*keys, "bin"])
    count = np.bincount(row, minlength=len(cells)).astype(float)
    distance_m = np.bincount(row, events["distance_m"].to_numpy(float), len(cells)).astype(float)
    time_s = np.bincount(row, events["time_s"].to_numpy(float), len(cells)).astype(float)
    observed_s = observed_seconds(cells, places, coverage)
    line = np.array([place.is_line for place in places], bool)[cells["place"]]
    region_ms = np.where(line | (observed_s == 0), 0.0, _region(cells, places, coverage))
    status = status_of(observed_s, cells["bin_s"].to_numpy(), count > 0, params=params)
    cells = cells.assign(
        count=count,
        flow_vph=np.where(line, per_hour(count, observed_s), 3600 * _ratio(distance_m, region_ms)),
        density_vpkm=np.where(line, np.nan, 1000 * _ratio(time_s, region_ms)),
        space_mean_mps=_ratio(distance_m, time_s),
        observed_s=observed_s,
        status=status,
        place=named(cells, places),
    )
    return blank_where(cells, status == "not_observed", ["count"])


def _events(vehicles: pd.DataFrame, crossings: pd.DataFrame, stays: pd.DataFrame, coverage: Coverage) -> pd.DataFrame:
    """Return crossings (as one unit of way in the time their speed implies) and stays in one list."""
    over = crossings[~crossings["guessed"]]
    plausible = over["speed_mps"].notna()
    lines = over[["vehicle", "place"]].assign(
        bin=coverage.bins.index(over["t_us"].to_numpy(np.int64)),
        distance_m=np.where(plausible, 1.0, 0.0),
        time_s=np.where(plausible, 1 / over["speed_mps"].clip(lower=SLOWEST_MPS), 0.0),
    )
    filled = [part for part in (lines, stays[stays["time_s"] > 0]) if len(part)]
    events = pd.concat(filled, ignore_index=True) if filled else lines
    return events.assign(vehicle_class=vehicles["vehicle_class"].to_numpy()[events["vehicle"].to_numpy(int)])


def _region(cells: pd.DataFrame, places: Sequence[Place], coverage: Coverage) -> Floats:
    """Return L T of each row in metre seconds."""
    each = [place.length_m * coverage.share_seconds(i) for i, place in enumerate(places)]
    return np.array(each).reshape(len(places), len(coverage.bins))[cells["place"], cells["bin"]]


def _ratio(over: Floats, under: Floats) -> Floats:
    return np.divide(over, under, out=np.full(len(under), np.nan), where=under > 0)
