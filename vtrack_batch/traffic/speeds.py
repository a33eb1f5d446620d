"""How fast vehicles were: over each gate, and within each area."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from vtrack_batch.traffic.coverage import Coverage, status_of
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.places import Place, names_of
from vtrack_batch.traffic.tables import blank_where, cell_of, grid

SLOWEST_MPS = 0.1
"""Floor of the speed over a line in harmonic means: one vehicle that starts from rest on it must not stop them all."""


def speeds_table(
    crossings: pd.DataFrame,
    stays: pd.DataFrame,
    places: Sequence[Place],
    *,
    coverage: Coverage,
    params: TrafficParams,
) -> pd.DataFrame:
    """Return the table ``speeds``: a row per place and bin.

    Over a line: the speeds of the crossings, their harmonic mean as space mean. In an area: each vehicle's way over
    its time inside; the space mean is total way over total time (Edie 1963). Speeds above ``max_speed_mps`` stay out.
    The standard error of a single crossing is that of its own speed.
    """
    samples = speed_samples(crossings, stays, coverage, params=params)
    cells = grid(pd.DataFrame({"place": np.arange(len(places))}), coverage.bins)
    measured = _summaries(samples, cell_of(cells, samples, ["place", "bin"])).reindex(np.arange(len(cells)))
    cells = pd.concat([cells, measured.assign(vehicles=measured["vehicles"].fillna(0))], axis=1)
    observed_s = observed_seconds(cells, places, coverage)
    some = cells["vehicles"].to_numpy(float) > 0
    status = status_of(observed_s, cells["bin_s"].to_numpy(), some, params=params)
    cells = cells.assign(observed_s=observed_s, status=status, place=named(cells, places))
    return blank_where(cells, status == "not_observed", ["vehicles"])


def speed_samples(
    crossings: pd.DataFrame, stays: pd.DataFrame, coverage: Coverage, *, params: TrafficParams
) -> pd.DataFrame:
    """Return one row per crossing of a line, and per vehicle, area and bin: vehicle, place, bin, speed_mps, sigma_mps,
    and the distance_m and time_s whose ratio of sums is the space mean."""
    over = crossings[~crossings["guessed"] & (crossings["speed_mps"] <= params.max_speed_mps)]
    lines = over[["vehicle", "place", "speed_mps", "sigma_mps"]].assign(
        bin=coverage.bins.index(over["t_us"].to_numpy(np.int64)),
        distance_m=1.0,
        time_s=1 / over["speed_mps"].clip(lower=SLOWEST_MPS),
    )
    within = stays[stays["time_s"] > 0]
    within = within.assign(speed_mps=within["distance_m"] / within["time_s"], sigma_mps=np.nan)
    within = within[within["speed_mps"] <= params.max_speed_mps]
    filled = [part for part in (lines, within) if len(part)]
    return pd.concat(filled, ignore_index=True) if filled else lines


def observed_seconds(cells: pd.DataFrame, places: Sequence[Place], coverage: Coverage) -> np.ndarray:
    """Return the seconds for which the place of each row was in view in its bin."""
    seconds = np.array([coverage.seconds(i) for i in range(len(places))]).reshape(len(places), len(coverage.bins))
    return seconds[cells["place"], cells["bin"]]


def named(cells: pd.DataFrame, places: Sequence[Place]) -> pd.Series:
    """Return the ids of the places whose numbers the rows hold."""
    return cells["place"].map(names_of(places))


def _summaries(samples: pd.DataFrame, row: np.ndarray) -> pd.DataFrame:
    """Return number, means, percentiles and standard error of the speeds, by the *row* (n,) that they belong to."""
    groups = samples.groupby(row)
    speed = groups["speed_mps"]
    percentiles = (
        speed.quantile(np.array([0.15, 0.5, 0.85])).unstack()
        if len(samples)
        else pd.DataFrame(columns=[0.15, 0.5, 0.85])
    )
    many = speed.count()
    spread: pd.Series = (speed.std() / np.sqrt(many)).fillna(groups["sigma_mps"].first())
    return pd.DataFrame(
        {
            "vehicles": many,
            "time_mean_mps": speed.mean(),
            "space_mean_mps": groups["distance_m"].sum() / groups["time_s"].sum(),
            "p15_mps": percentiles[0.15],
            "p50_mps": percentiles[0.5],
            "p85_mps": percentiles[0.85],
            "standard_error_mps": spread,
        }
    )
