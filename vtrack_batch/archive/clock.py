"""Readings of a wall clock, and what they are in UTC.

The two nights of summer time: a reading that does not exist (spring) has no UTC; a reading that exists twice (autumn)
is resolved by the frames before and after it, or not at all.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

_EPOCH = datetime(1970, 1, 1)
_MICROSECOND = timedelta(microseconds=1)
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_ISO = re.compile(
    r"(?P<Y>\d{4})-?(?P<m>\d\d)-?(?P<d>\d\d)[T ]"
    r"(?P<H>\d\d):?(?P<M>\d\d):?(?P<S>\d\d)(?:[.,](?P<f>\d{1,9}))?\s?(?P<z>Z|UTC|[+-]\d\d(?::?\d\d)?)?",
    re.ASCII | re.IGNORECASE,
)
_NUMBER = re.compile(r"\d{9,10}(\.\d+)?|\d{13}|\d{16}", re.ASCII)


class Stamp(NamedTuple):
    """A reading of a clock: microseconds since 1970-01-01T00:00 *by that clock*, and its offset from UTC if known."""

    clock_us: int
    offset_s: int | None


@dataclass(frozen=True)
class Utc:
    """UTC of n readings: ``t_utc`` (n,) datetime64[us], NaT where there is none, and masks (n,) bool that say why."""

    t_utc: NDArray[np.datetime64]
    ambiguous: NDArray[np.bool_]
    nonexistent: NDArray[np.bool_]


def stamp_from_parts(parts: Mapping[str, str]) -> Stamp | None:
    """Return the stamp that the texts *parts*, keyed by strptime letter, spell; None if there is no such time.

    A leap second (:60) is folded to the last microsecond of the minute.
    """
    if "epoch" in parts:
        return Stamp(_decimal_us(parts["epoch"], int(parts["unit_us"])), 0)
    try:
        year = int(parts["Y"]) if "Y" in parts else 2000 + int(parts["y"])
        second, micro = int(parts.get("S", "0")), int(parts.get("f", "0").ljust(6, "0")[:6])
        if second == 60:
            second, micro = 59, 999_999
        if "j" in parts:
            day = datetime.strptime(f"{year:04d}{parts['j']}", "%Y%j")
        else:
            day = datetime(year, _month(parts), int(parts["d"]))
        moment = day.replace(hour=_hour(parts), minute=int(parts["M"]), second=second, microsecond=micro)
    except ValueError:
        return None
    return Stamp((moment - _EPOCH) // _MICROSECOND, _offset_s(parts.get("z")))


def stamp_from_text(text: str) -> Stamp | None:
    """Return the stamp of an ISO 8601 date and time, or of a number of (milli-, micro-) seconds since 1970 UTC."""
    text = text.strip()
    found = _ISO.fullmatch(text)
    if found:
        return stamp_from_parts({key: value for key, value in found.groupdict().items() if value is not None})
    if _NUMBER.fullmatch(text):
        digits = len(text.partition(".")[0])
        return Stamp(_decimal_us(text, {13: 1000, 16: 1}.get(digits, 1_000_000)), 0)
    return None


def to_utc(stamps: list[Stamp], platform: list[str], *, time_zone: str | None, max_gap_s: float) -> Utc:
    """Return the UTC of *stamps*, given in the order in which frames were named or listed.

    Stamps without offset are read in *time_zone* (it must be given if there are any). An ambiguous run of frames of one
    platform is the first of the two hours if the frame before it is at most *max_gap_s* away then, the second if that
    holds for the frame after it, and both, in turn, if the clock falls back once within the run.
    """
    n = len(stamps)
    clock = np.array([stamp.clock_us for stamp in stamps], np.int64)
    offset_s = np.array([np.nan if stamp.offset_s is None else stamp.offset_s for stamp in stamps], float)
    naive = np.isnan(offset_s)
    t_us = clock - np.where(naive, 0, offset_s).astype(np.int64) * 1_000_000
    ambiguous, nonexistent = np.zeros(n, bool), np.zeros(n, bool)
    if naive.any():
        if time_zone is None:
            raise ValueError("stamps without offset need a time zone")
        first = _localise(clock[naive], time_zone, earlier=True)
        second = _localise(clock[naive], time_zone, earlier=False)
        nonexistent[naive] = np.isnat(first)
        doubtful = np.zeros(n, bool)
        doubtful[naive] = first != second
        doubtful &= ~nonexistent
        late = np.zeros(n, np.int64)
        late[naive] = (second - first).astype(np.int64)
        t_us[naive] = first.astype(np.int64)
        ambiguous = _resolve(_Readings(clock, t_us, late), doubtful, nonexistent, platform, max_gap_s)
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
    platform: list[str],
    max_gap_s: float,
) -> NDArray[np.bool_]:
    """Settle the doubtful readings of every platform in place; return the mask of those that stay ambiguous."""
    ambiguous = doubtful.copy()
    if not doubtful.any():
        return ambiguous
    names = np.array(platform, object)
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


def _month(parts: Mapping[str, str]) -> int:
    return int(parts["m"]) if "m" in parts else _MONTHS.index(parts["b"][:3].lower()) + 1


def _hour(parts: Mapping[str, str]) -> int:
    if "I" not in parts:
        return int(parts["H"])
    hour = int(parts["I"])
    if not 1 <= hour <= 12:
        raise ValueError("no hour of a twelve-hour clock")
    return hour % 12 + (12 if parts["p"].lower() == "pm" else 0)


def _offset_s(text: str | None) -> int | None:
    if text is None:
        return None
    if text.upper() in ("Z", "UTC"):
        return 0
    digits = text[1:].replace(":", "").ljust(4, "0")
    hours, minutes = int(digits[:2]), int(digits[2:])
    if hours > 15 or minutes > 59:
        raise ValueError("no offset from UTC")
    seconds = 3600 * hours + 60 * minutes
    return -seconds if text[0] == "-" else seconds


def _decimal_us(text: str, unit_us: int) -> int:
    """Return a decimal number of units of *unit_us* microseconds, exactly, as whole microseconds (rounded down)."""
    whole, _, fraction = text.partition(".")
    return int(whole) * unit_us + int(fraction.ljust(6, "0")[:6] or 0) * unit_us // 1_000_000
