"""Readings of a wall clock, and what they are in UTC.

The two nights of summer time: a reading that does not exist (spring) has no UTC; a reading that exists twice (autumn)
is resolved by the frames before and after it, or not at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray


@dataclass(frozen=True)
class Utc:
    """UTC of n readings: ``t_utc`` (n,) datetime64[us], NaT where there is none, and masks (n,) bool that say why."""

    t_utc: NDArray[np.datetime64]
    ambiguous: NDArray[np.bool_]
    nonexistent: NDArray[np.bool_]


def to_utc(
    clock_us: NDArray[np.int64],
    offset_s: NDArray[np.float64],
    platform: pd.Series,
    *,
    time_zone: str | None,
    max_gap_s: float,
) -> Utc:
    """Return the UTC of n stamps, given in the order in which frames were named or listed.

    *clock_us* (n,) microseconds since 1970 by each frame's own clock; *offset_s* (n,) its offset from UTC, NaN where
    the stamp says none: such are read in *time_zone* (it must be given if there are any). An ambiguous run of frames of
    one *platform* is the first of the two hours if the frame before it is at most *max_gap_s* away then, the second if
    that holds for the frame after it, and both, in turn, if the clock falls back once within the run.
    """
    n = len(clock_us)
    naive = np.isnan(offset_s)
    t_us = clock_us - np.where(naive, 0, offset_s).astype(np.int64) * 1_000_000
    ambiguous, nonexistent = np.zeros(n, bool), np.zeros(n, bool)
    if naive.any():
        if time_zone is None:
            raise ValueError("stamps without offset need a time zone")
        first = _localise(clock_us[naive], time_zone, earlier=True)
        second = _localise(clock_us[naive], time_zone, earlier=False)
        nonexistent[naive] = np.isnat(first)
        doubtful = np.zeros(n, bool)
        doubtful[naive] = first != second
        doubtful &= ~nonexistent
        late = np.zeros(n, np.int64)
        late[naive] = (second - first).astype(np.int64)
        t_us[naive] = first.astype(np.int64)
        ambiguous = _resolve(_Readings(clock_us, t_us, late), doubtful, nonexistent, platform, max_gap_s)
    t_utc = t_us.astype("datetime64[us]")
    t_utc[ambiguous | nonexistent] = np.datetime64("NaT")
    return Utc(t_utc, ambiguous, nonexistent)


@dataclass(frozen=True)
class _Readings:
    """Wall clock, UTC if the earlier of two meanings holds (changed in place), and what the later one adds; all us."""

    clock_us: NDArray[np.int64]
    t_us: NDArray[np.int64]
    later_us: NDArray[np.int64]


def _resolve(
    readings: _Readings,
    doubtful: NDArray[np.bool_],
    nonexistent: NDArray[np.bool_],
    platform: pd.Series,
    max_gap_s: float,
) -> NDArray[np.bool_]:
    """Settle the doubtful readings of every platform in place; return the mask of those that stay ambiguous."""
    ambiguous = doubtful.copy()
    if not doubtful.any():
        return ambiguous
    names = platform.to_numpy(object)
    for name in sorted(set(names[doubtful])):
        rows = np.flatnonzero((names == name) & ~nonexistent)
        inside = doubtful[rows].astype(np.int8)
        starts = np.flatnonzero(np.diff(inside, prepend=0) == 1)
        ends = np.flatnonzero(np.diff(inside, append=0) == -1) + 1
        for start, end in zip(starts, ends, strict=True):
            run = rows[start:end]
            before = rows[start - 1] if start > 0 else None
            after = rows[end] if end < len(rows) else None
            split = _falls_back_at(readings, run, before, after, max_gap_s)
            if split is not None:
                readings.t_us[run[split:]] += readings.later_us[run[split:]]
                ambiguous[run] = False
    return ambiguous


def _falls_back_at(
    readings: _Readings, run: NDArray[np.intp], before: np.intp | None, after: np.intp | None, max_gap_s: float
) -> int | None:
    """Return how many frames of *run* lie in the first of the two hours; None if that cannot be told."""
    drops = np.flatnonzero(np.diff(readings.clock_us[run]) < 0)
    if len(drops) == 1:
        return int(drops[0]) + 1
    if len(drops) > 1:
        return None
    gap_us = max_gap_s * 1e6
    early = before is not None and 0 <= readings.t_us[run[0]] - readings.t_us[before] <= gap_us
    last = readings.t_us[run[-1]] + readings.later_us[run[-1]]
    late = after is not None and 0 <= readings.t_us[after] - last <= gap_us
    if early == late:
        return None
    return len(run) if early else 0


def _localise(clock_us: NDArray[np.int64], time_zone: str, *, earlier: bool) -> NDArray[np.datetime64]:
    index = pd.DatetimeIndex(clock_us.astype("datetime64[us]"))
    local = index.tz_localize(time_zone, ambiguous=np.full(len(index), earlier), nonexistent="NaT")
    return local.tz_convert("UTC").tz_localize(None).to_numpy().astype("datetime64[us]")
