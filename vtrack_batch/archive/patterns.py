"""Times in file names: a small pattern language, and the ISO-like stamps that need none."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

from vtrack_batch.archive.stamps import Stamp, stamp_from_parts

PLATFORM_FIELDS = ("camera", "platform", "sequence")

_DIRECTIVES = {
    "Y": r"\d{4}",
    "y": r"\d{2}",
    "m": r"\d{2}",
    "d": r"\d{2}",
    "j": r"\d{3}",
    "b": r"[A-Za-z]{3}",
    "B": r"[A-Za-z]{3,9}",
    "H": r"\d{2}",
    "I": r"\d{2}",
    "p": r"[AaPp][Mm]",
    "M": r"\d{2}",
    "S": r"\d{2}",
    "f": r"\d{1,9}",
    "z": r"Z|[+-]\d{2}:?\d{2}",
}
_UNPADDED = frozenset("mdHIMS")
_EPOCHS = {
    "epoch_s": (r"\d{1,11}(?:\.\d{1,9})?", 1_000_000),
    "epoch_ms": (r"\d{1,14}(?:\.\d{1,9})?", 1000),
    "epoch_us": (r"\d{1,17}", 1),
}
_TOKEN = re.compile(r"\{(?P<name>[A-Za-z][A-Za-z0-9_]*)(?::(?P<format>[^{}]*))?\}|(?P<any>\{\*\}|\*)")
_ISO_LIKE = re.compile(
    r"(?<!\d)(?P<Y>(?:19|20)\d\d)(?P<_d>[-_.]?)(?P<m>0[1-9]|1[0-2])(?P=_d)(?P<d>0[1-9]|[12]\d|3[01])[T_. -]?"
    r"(?P<H>[01]\d|2[0-3])(?P<_t>[-_.:]?)(?P<M>[0-5]\d)(?P=_t)(?P<S>[0-5]\d|60)"
    r"(?:[.,](?P<f>\d{1,9})|(?P<_glued>\d{3}|\d{6}))?(?P<z>Z|\+\d\d:?\d\d|-\d\d:\d\d)?(?P<_doubt>-(?:0\d|1[0-4])(?:00|30|45))?(?!\d)",
    re.ASCII,
)


class Reading(NamedTuple):
    """What a name says: its stamp (None = digits that are no time) and its platform (None = it does not say)."""

    stamp: Stamp | None
    platform: str | None


class AmbiguousNameError(ValueError):
    """A name holds more than one thing that may be its time."""


@dataclass(frozen=True)
class NamePattern:
    """A compiled pattern; ``whole_path``: it describes the path below the root, not the file name alone."""

    text: str
    regex: re.Pattern[str]
    groups: dict[str, tuple[str, int]]
    whole_path: bool

    def read(self, path: str) -> Reading | None:
        """Return what the name of *path* (below the root, with '/') says; None if it does not fit the pattern."""
        found = self.regex.fullmatch(path if self.whole_path else path.rpartition("/")[2])
        if found is None:
            return None
        parts: dict[str, str] = {}
        for group, (letter, unit_us) in self.groups.items():
            text = found[group]
            if parts.setdefault(letter, text) != text:
                return Reading(None, None)
            if unit_us:
                parts["unit_us"] = str(unit_us)
        named = [found[field] for field in PLATFORM_FIELDS if field in self.regex.groupindex]
        return Reading(stamp_from_parts(parts), "/".join(named) or None)


@dataclass(frozen=True)
class IsoLikeNames:
    """Names that hold one year-first date with a time of day, such as ``cam1_2026-05-17T06-00-00.500Z.jpg``."""

    text: str = "ISO-like date and time in the file name"
    whole_path: bool = False

    def read(self, path: str) -> Reading | None:
        """Return the stamp in the file name of *path*; None if there is none; AmbiguousNameError if two differ."""
        name = path.rpartition("/")[2]
        stamps = {stamp_from_parts(_iso_parts(found, name)) for found in _ISO_LIKE.finditer(name)}
        if len(stamps) > 1:
            raise AmbiguousNameError("it holds more than one date and time")
        return Reading(stamps.pop(), None) if stamps else None


def compile_pattern(text: str) -> NamePattern:
    """Compile a pattern such as ``{camera}/{time:%Y%m%dT%H%M%S.%f}.jpg``; ValueError says what is wrong with it."""
    pieces: list[str] = []
    groups: dict[str, tuple[str, int]] = {}
    seen: set[str] = set()
    end = 0
    for token in _TOKEN.finditer(text):
        pieces.append(_literal(text[end : token.start()]))
        end = token.end()
        name = token["name"]
        if token["any"]:
            pieces.append("[^/]*")
        elif name == "time":
            pieces.append(_time_regex(token["format"] or "", groups))
        elif token["format"] is not None:
            raise ValueError(f"{token[0]}: only {{time:...}} takes a format")
        elif name in seen:
            pieces.append(f"(?P={name})")
        else:
            seen.add(name)
            pieces.append(f"(?P<{name}>[^/]+)")
    pieces.append(_literal(text[end:]))
    _check_complete({letter for letter, _ in groups.values()})
    return NamePattern(text, re.compile("".join(pieces), re.ASCII | re.IGNORECASE | re.DOTALL), groups, "/" in text)


def _iso_parts(found: re.Match[str], name: str) -> dict[str, str]:
    if found["_doubt"]:
        raise AmbiguousNameError(f"{found['_doubt']!r} after the time may be a number or an offset from UTC")
    parts = {key: value for key, value in found.groupdict().items() if value is not None and not key.startswith("_")}
    if found["_glued"]:
        parts["f"] = found["_glued"]
    return parts


def _literal(text: str) -> str:
    if "{" in text or "}" in text:
        raise ValueError(f"{text!r}: a brace without its partner")
    return re.escape(text)


def _time_regex(time_format: str, groups: dict[str, tuple[str, int]]) -> str:
    """Return the regex of one {time:...}, and enter its groups: group name -> (letter, us per unit of an epoch)."""
    if time_format in _EPOCHS:
        regex, unit_us = _EPOCHS[time_format]
        return _group("epoch", regex, groups, unit_us)
    pieces = []
    position = 0
    while position < len(time_format):
        character = time_format[position]
        position += 1
        if character == "Z":
            pieces.append(_group("z", "Z", groups))
        elif character != "%":
            pieces.append(_literal(character))
        else:
            unpadded = time_format[position : position + 1] == "-"
            letter = time_format[position + unpadded : position + unpadded + 1]
            position += 1 + unpadded
            pieces.append(_directive(letter, unpadded, groups))
    return "".join(pieces)


def _directive(letter: str, unpadded: bool, groups: dict[str, tuple[str, int]]) -> str:
    if letter == "%":
        return "%"
    if letter not in _DIRECTIVES or (unpadded and letter not in _UNPADDED):
        known = " ".join("%" + each for each in _DIRECTIVES)
        raise ValueError(
            f"%{'-' if unpadded else ''}{letter} is not understood; known are {known} and {{time:epoch_s}}"
        )
    regex = r"\d{1,2}" if unpadded else _DIRECTIVES[letter]
    return _group("b" if letter == "B" else letter, regex, groups)


def _group(letter: str, regex: str, groups: dict[str, tuple[str, int]], unit_us: int = 0) -> str:
    name = f"_{letter}{len(groups)}"
    groups[name] = (letter, unit_us)
    return f"(?P<{name}>{regex})"


def _check_complete(letters: set[str]) -> None:
    if "epoch" in letters:
        if len(letters) > 1:
            raise ValueError("seconds since 1970 and a calendar time in one pattern")
        return
    if not letters:
        raise ValueError("it needs {time:...}, for example {time:%Y%m%dT%H%M%S} or {time:epoch_ms}")
    needed = {
        "a year (%Y)": letters & {"Y", "y"},
        "a month (%m)": letters & {"m", "b", "j"},
        "a day (%d)": letters & {"d", "j"},
        "an hour (%H)": "H" in letters or {"I", "p"} <= letters,
        "minutes (%M)": "M" in letters,
        "seconds (%S)": "S" in letters,
    }
    missing = [what for what, there in needed.items() if not there]
    if missing:
        raise ValueError(f"its time lacks {', '.join(missing)}")
