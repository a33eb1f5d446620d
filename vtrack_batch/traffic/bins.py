"""Time bins aligned to the local clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Times = NDArray[np.int64]
SECOND_US = 1_000_000


@dataclass(frozen=True)
class Bins:
    """Half-open bins [start, start + length) in order of time; days without data hold none.

    ``start_us`` (b,) int64, microseconds since 1970 UTC; ``length_s`` (b,) int64.
    """

    start_us: Times
    length_s: Times

    def __len__(self) -> int:
        """Return the number of bins."""
        return len(self.start_us)

    @property
    def end_us(self) -> Times:
        """Ends of the bins (b,), exclusive."""
        return self.start_us + self.length_s * SECOND_US

    @property
    def start_utc(self) -> pd.DatetimeIndex:
        """Starts of the bins as datetime64[us, UTC]."""
        return to_utc(self.start_us)

    def index(self, t_us: Times) -> Times:
        """Return the bin of each time (n,), -1 where it is in none."""
        if len(self) == 0:
            return np.full(np.shape(t_us), -1)
        at = np.searchsorted(self.start_us, t_us, "right") - 1
        return np.where((at >= 0) & (t_us < self.end_us[at]), at, -1)


def clock_bins(start_us: Times, end_us: Times, *, time_zone: str, bin_s: int) -> Bins:
    """Return all bins that meet any of the spans (n,) of time, ends included, and those between them on one local date.

    A bin begins wherever the wall clock of *time_zone* shows a multiple of *bin_s* since midnight. When the clocks
    change, quarter-hours number 92 or 100; bins that the change cuts say so by their length. None straddles midnight.
    """
    if len(start_us) == 0:
        return Bins(np.empty(0, np.int64), np.empty(0, np.int64))
    edges = [_edges_us(date, time_zone, bin_s) for date in _dates(start_us, end_us, time_zone)]
    starts = np.concatenate([of_date[:-1] for of_date in edges])
    ends = np.concatenate([of_date[1:] for of_date in edges])
    begun = np.zeros(len(starts) + 1, np.int64)
    np.add.at(begun, np.searchsorted(starts, start_us, "right") - 1, 1)
    np.add.at(begun, np.searchsorted(starts, end_us, "right"), -1)
    met = np.cumsum(begun[:-1]) > 0
    keep = np.concatenate([_filled(part) for part in np.split(met, np.cumsum([len(of) - 1 for of in edges])[:-1])])
    return Bins(starts[keep], (ends[keep] - starts[keep]) // SECOND_US)


def to_us(times: pd.Series | pd.DatetimeIndex) -> Times:
    """Return times (n,) of any resolution as int64 microseconds since 1970 UTC."""
    index = pd.DatetimeIndex(times)
    index = index.tz_localize("UTC") if index.tz is None else index.tz_convert("UTC")
    return np.asarray(index.tz_localize(None).to_numpy().astype("datetime64[us]").astype(np.int64))


def to_utc(t_us: Times) -> pd.DatetimeIndex:
    """Return int64 microseconds since 1970 as datetime64[us, UTC]."""
    return pd.DatetimeIndex(np.asarray(t_us, np.int64).astype("datetime64[us]")).tz_localize("UTC")


def _dates(start_us: Times, end_us: Times, time_zone: str) -> list[pd.Timestamp]:
    """Return the local dates that the spans touch, in order."""
    first, last = (to_utc(t_us).tz_convert(time_zone).tz_localize(None).floor("D") for t_us in (start_us, end_us))
    spans = pd.MultiIndex.from_arrays([first, last]).unique()
    return sorted({date for start, end in spans for date in pd.date_range(start, end, freq="D")})


def _filled(met: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return True from the first to the last True."""
    return np.logical_or.accumulate(met) & np.logical_or.accumulate(met[::-1])[::-1]


def _edges_us(date: pd.Timestamp, time_zone: str, bin_s: int) -> Times:
    """Return the edges of all bins of one local date, from its first instant to the first of the next date."""
    clock = date + pd.to_timedelta(np.arange(0, 86400, bin_s), unit="s")
    midnight = _instants_us(pd.DatetimeIndex([date + pd.Timedelta(days=1)]), time_zone).min()
    edges = np.unique(_instants_us(pd.DatetimeIndex(clock), time_zone))
    return np.append(edges[edges < midnight], midnight)


def _instants_us(clock: pd.DatetimeIndex, time_zone: str) -> Times:
    """Return every instant at which the local clock shows these readings: two where it was put back, the next where
    it was put forward over them."""
    return np.concatenate(
        [
            to_us(clock.tz_localize(time_zone, ambiguous=np.full(len(clock), summer), nonexistent="shift_forward"))
            for summer in (True, False)
        ]
    )
