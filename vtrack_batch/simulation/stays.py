"""True speeds, flows and densities on the arms of junctions, by Edie's definitions (1963)."""

from __future__ import annotations

import numpy as np
import pandas as pd
import shapely

from vtrack_batch.simulation.counts import Clock, flow_columns, speed_cells, with_bins
from vtrack_batch.simulation.fleet import Ints
from vtrack_batch.simulation.places import Places
from vtrack_batch.simulation.traffic import Motion


def stays_in(moved: Motion, places: Places, clock: Clock, vehicles: Ints) -> pd.DataFrame:
    """Return one row per vehicle, arm and bin of *vehicles* (numbers): place, vehicle, t_s, time_s, distance_m.

    Each sample stands for one sampling period.
    """
    end_s = float((clock.t_utc[-1] - clock.t_utc[0]).total_seconds())
    t_s = moved.step * moved.period_s
    row = np.flatnonzero((t_s >= 0) & (t_s < end_s) & np.isin(moved.vehicle, vehicles))
    tree = shapely.STRtree([shapely.Polygon(arm.ring) for arm in places.arms])
    sample, arm = tree.query(shapely.points(moved.xy_m[row]), predicate="within")
    row = row[sample]
    inside = pd.DataFrame(
        {
            "place": np.array([a.id for a in places.arms], object)[arm] if len(arm) else np.zeros(0, object),
            "vehicle": moved.vehicle[row],
            "t_s": t_s[row],
            "time_s": moved.period_s,
            "distance_m": moved.speed_mps[row] * moved.period_s,
        }
    )
    inside["bin"] = clock.bin_start(inside["t_s"].to_numpy(float))
    groups = inside.groupby(["place", "vehicle", "bin"], observed=True)
    return groups.agg({"t_s": "first", "time_s": "sum", "distance_m": "sum"}).reset_index().drop(columns="bin")


def area_cells(stays: pd.DataFrame, places: Places, clock: Clock) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the rows of ``speeds`` and of ``flows`` on arms, from stays with their ``vehicle_class``."""
    slowness = stays["time_s"] / stays["distance_m"].clip(lower=1e-3)
    stays = with_bins(stays.assign(speed_mps=stays["distance_m"] / stays["time_s"], slowness=slowness), clock)
    speeds = speed_cells(stays.query("vehicle_class == 'all'"), clock)
    groups = stays.groupby(["place", "vehicle_class", "bin_start_utc", "bin_s"], observed=True)
    cells = groups.agg(count=("t_s", "size"), time_s=("time_s", "sum"), way_m=("distance_m", "sum")).reset_index()
    cells = pd.concat([cells, clock.observed(cells["bin_start_utc"])], axis=1)
    length_m = cells["place"].map({arm.id: arm.length_m for arm in places.arms}).astype(float)
    space = length_m * cells["observed_s"]
    measured = cells.assign(
        flow_vph=3600 * cells["way_m"] / space,
        density_vpkm=1000 * cells["time_s"] / space,
        space_mean_mps=cells["way_m"] / cells["time_s"],
    )
    return speeds, flow_columns(measured)
