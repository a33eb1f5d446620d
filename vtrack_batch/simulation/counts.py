"""True counts: OD pairs, turns, and speeds and flows at gates, counted from the truth's own events."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from vtrack_batch.model.homography import Array

SLOWEST_MPS = 0.1
"""Floor of speeds over a line in harmonic means, as in the traffic chapter."""


@dataclass(frozen=True)
class Clock:
    """Times of the frames, IANA zone whose clock aligns the bins, length of a bin."""

    t_utc: pd.DatetimeIndex
    time_zone: str
    bin_s: int

    def bin_start(self, t_s: Array) -> pd.DatetimeIndex:
        """Return the begin of the bin that holds each moment *t_s* (n,) since the first frame."""
        at = self.t_utc[0] + pd.to_timedelta(np.asarray(t_s, float), unit="s")
        local = at.tz_convert(self.time_zone)
        into = (local.tz_localize(None) - local.normalize().tz_localize(None)).total_seconds().to_numpy()
        return (at - pd.to_timedelta(np.mod(into, self.bin_s), unit="s")).round("ms").as_unit("us")

    def observed(self, begin: pd.Series) -> pd.DataFrame:
        """Return ``observed_s`` and ``status`` of the bins that begin at *begin*."""
        end = begin + pd.to_timedelta(self.bin_s, unit="s")
        step = self.t_utc[1] - self.t_utc[0] if len(self.t_utc) > 1 else pd.Timedelta(0)
        first, last = self.t_utc[0], self.t_utc[-1] + step
        seconds = (end.where(end < last, last) - begin.where(begin > first, first)).dt.total_seconds()
        return pd.DataFrame(
            {"observed_s": seconds, "status": np.where(seconds >= 0.9 * self.bin_s, "observed", "partial")}
        )


def od_table(trajectories: pd.DataFrame, clock: Clock) -> pd.DataFrame:
    """Return the table ``od_pairs``: one row per pair, class and bin that occurs, class ``all`` included."""
    trips = with_bins(trajectories.rename(columns={"t_origin_s": "t_s"}), clock)
    keys = ["origin", "destination", "vehicle_class", "bin_start_utc", "bin_s"]
    cells = _counted(trips, keys, clock)
    times = trips.groupby(keys, observed=True)["travel_s"].median()
    cells = cells.merge(times.rename("median_travel_time_s").reset_index(), on=keys)
    return cells[[*keys, "count", "count_lo", "count_hi", "observed_s", "status", "median_travel_time_s"]]


def turn_table(turns: pd.DataFrame, clock: Clock) -> pd.DataFrame:
    """Return the table ``turns``; a vehicle that entered the junction and was not seen to leave it is ``unknown``."""
    keys = ["junction", "approach", "movement", "vehicle_class", "bin_start_utc", "bin_s"]
    cells = _counted(with_bins(turns, clock), keys, clock)
    known = cells["count"].where(cells["movement"] != "unknown")
    total = known.groupby([cells[key] for key in keys if key != "movement"], observed=True).transform("sum")
    share = known / total
    cells = cells.assign(
        share=share, share_lo=share, share_hi=share, rate_vph=cells["count"] * 3600 / cells["observed_s"]
    )
    share_names = ["share", "share_lo", "share_hi", "rate_vph"]
    return cells[[*keys, "count", "count_lo", "count_hi", *share_names, "observed_s", "status"]]


def gate_cells(crossings: pd.DataFrame, clock: Clock) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the rows of ``speeds`` and of ``flows`` at gates, from crossings with their ``vehicle_class``."""
    seconds = (crossings["t_utc"] - clock.t_utc[0]).dt.total_seconds()
    over = crossings.rename(columns={"gate": "place"}).assign(
        t_s=seconds, slowness=1 / crossings["speed_mps"].clip(lower=SLOWEST_MPS)
    )
    speeds = speed_cells(with_bins(over, clock).query("vehicle_class == 'all'"), clock)
    groups = with_bins(over, clock).groupby(["place", "vehicle_class", "bin_start_utc", "bin_s"], observed=True)
    flows = groups.agg(count=("t_s", "size"), space_mean_mps=("slowness", lambda s: 1 / s.mean())).reset_index()
    flows = pd.concat([flows, clock.observed(flows["bin_start_utc"])], axis=1)
    return speeds, flow_columns(flows.assign(flow_vph=3600 * flows["count"] / flows["observed_s"], density_vpkm=np.nan))


def speed_cells(samples: pd.DataFrame, clock: Clock) -> pd.DataFrame:
    """Return rows of ``speeds`` from samples with place, bin, speed_mps and slowness (s/m, its mean's inverse = space
    mean; weighted by ``distance_m`` where there is one)."""
    weight = samples["distance_m"] if "distance_m" in samples else pd.Series(1.0, samples.index)
    samples = samples.assign(weight=weight, time_s=samples["slowness"] * weight)
    groups = samples.groupby(["place", "bin_start_utc", "bin_s"], observed=True)
    speed = groups["speed_mps"]
    cells = pd.DataFrame(
        {
            "vehicles": speed.size().astype("int32"),
            "time_mean_mps": speed.mean(),
            "space_mean_mps": groups["weight"].sum() / groups["time_s"].sum(),
            "p15_mps": speed.quantile(0.15),
            "p50_mps": speed.quantile(0.5),
            "p85_mps": speed.quantile(0.85),
            "standard_error_mps": speed.std() / np.sqrt(speed.size()),
        }
    ).reset_index()
    return pd.concat([cells, clock.observed(cells["bin_start_utc"])], axis=1)


def flow_columns(cells: pd.DataFrame) -> pd.DataFrame:
    """Return the columns of ``flows`` in their order."""
    cells = cells.assign(count=cells["count"].astype(float))
    cells = cells.assign(count_lo=cells["count"], count_hi=cells["count"])
    keys = ["place", "vehicle_class", "bin_start_utc", "bin_s", "count", "flow_vph", "density_vpkm", "space_mean_mps"]
    return cells[[*keys, "count_lo", "count_hi", "observed_s", "status"]]


def with_bins(events: pd.DataFrame, clock: Clock) -> pd.DataFrame:
    """Return the events at ``t_s`` with their bins, once by class and once more as class ``all``."""
    binned = events.assign(bin_start_utc=clock.bin_start(events["t_s"].to_numpy(float)), bin_s=np.int32(clock.bin_s))
    return pd.concat([binned, binned.assign(vehicle_class="all")], ignore_index=True)


def _counted(events: pd.DataFrame, keys: list[str], clock: Clock) -> pd.DataFrame:
    count = events.groupby(keys, observed=True).size().rename("count").astype(float).reset_index()
    count = count.assign(count_lo=count["count"], count_hi=count["count"])
    return pd.concat([count, clock.observed(count["bin_start_utc"])], axis=1)
