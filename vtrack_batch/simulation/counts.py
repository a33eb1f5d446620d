"""True counts: OD pairs and turns, counted from the truth's own trajectories."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vtrack_batch.simulation.zones import JUNCTION

Clock = tuple[pd.DatetimeIndex, str, int]
"""Times of the frames, IANA zone whose clock aligns the bins, length of a bin in seconds."""


def od_table(trajectories: pd.DataFrame, clock: Clock) -> pd.DataFrame:
    """Return the table ``od_pairs``: one row per pair, class and bin that occurs, class ``all`` included."""
    trips = trajectories.rename(columns={"t_origin_s": "t_s"})
    keys = ["origin", "destination", "vehicle_class", "bin_start_utc", "bin_s"]
    cells = _counted(trips, keys, clock)
    times = _with_all(trips, clock).groupby(keys, observed=True)["travel_s"].median()
    cells = cells.merge(times.rename("median_travel_time_s").reset_index(), on=keys)
    names = [*keys, "count", "count_lo", "count_hi", "observed_s", "status", "median_travel_time_s"]
    return cells[names]


def turn_table(trajectories: pd.DataFrame, clock: Clock) -> pd.DataFrame:
    """Return the table ``turns``; a vehicle that entered the junction and was not seen to leave it is ``unknown``."""
    entered = trajectories[trajectories["t_entry_s"].notna()].rename(columns={"t_entry_s": "t_s"})
    turned = entered.assign(junction=JUNCTION, approach="approach_" + entered["arm"].astype(str))
    keys = ["junction", "approach", "movement", "vehicle_class", "bin_start_utc", "bin_s"]
    cells = _counted(turned, keys, clock)
    known = cells["count"].where(cells["movement"] != "unknown")
    total = known.groupby([cells[key] for key in keys if key != "movement"], observed=True).transform("sum")
    share = known / total
    cells = cells.assign(
        share=share, share_lo=share, share_hi=share, rate_vph=cells["count"] * 3600 / cells["observed_s"]
    )
    share_names = ["share", "share_lo", "share_hi", "rate_vph"]
    return cells[[*keys, "count", "count_lo", "count_hi", *share_names, "observed_s", "status"]]


def _counted(trips: pd.DataFrame, keys: list[str], clock: Clock) -> pd.DataFrame:
    t_utc, _, bin_s = clock
    count = _with_all(trips, clock).groupby(keys, observed=True).size().rename("count").astype(float).reset_index()
    begin = count["bin_start_utc"]
    end = begin + pd.to_timedelta(bin_s, unit="s")
    last = t_utc[-1] + (t_utc[1] - t_utc[0] if len(t_utc) > 1 else pd.Timedelta(0))
    observed = (end.where(end < last, last) - begin.where(begin > t_utc[0], t_utc[0])).dt.total_seconds()
    status = np.where(observed >= 0.9 * bin_s, "observed", "partial")
    return count.assign(count_lo=count["count"], count_hi=count["count"], observed_s=observed, status=status)


def _with_all(trips: pd.DataFrame, clock: Clock) -> pd.DataFrame:
    """Return the trips with their bins, once by class and once more as class ``all``."""
    t_utc, time_zone, bin_s = clock
    at = t_utc[0] + pd.to_timedelta(trips["t_s"].to_numpy(), unit="s")
    local = at.tz_convert(time_zone)
    midnight = local.normalize()
    into = (local.tz_localize(None) - midnight.tz_localize(None)).total_seconds().to_numpy()
    begin = at - pd.to_timedelta(np.mod(into, bin_s), unit="s")
    binned = trips.assign(bin_start_utc=begin.round("ms").as_unit("us"), bin_s=np.int32(bin_s))
    return pd.concat([binned, binned.assign(vehicle_class="all")], ignore_index=True)
