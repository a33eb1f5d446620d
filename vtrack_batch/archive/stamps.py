"""Readings of a clock from text: date and time as written, with an offset from UTC where the text has one."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import NamedTuple

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
