"""An evaluation as a plain page of text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

_TITLES = {
    "detection": "Detection",
    "links": "Links over consecutive frames",
    "tracks": "Tracks",
    "od": "OD pairs",
    "turns": "Turns",
    "speeds": "Speeds",
}
_HEADLINES = {
    ("detection", "detections", "f1"): "detection F1",
    ("detection", "movers", "recall"): "recall of movers, per frame after tracking",
    ("detection", "movers", "precision"): "precision of movers",
    ("links", "precision"): "link precision",
    ("tracks", "idf1"): "identity of tracks (IDF1)",
    ("od", "error"): "OD table error",
    ("od", "unknown_share_found"): "share of trips with an unknown end, found",
    ("od", "unknown_share_true"): "share of trips with an unknown end, true",
    ("turns", "share_error"): "turn share error",
    ("speeds", "rms_kmh"): "speed error, RMS km/h",
}
_PERCENT = {
    "precision", "recall", "f1", "precision_between_vehicles", "label_rate", "idf1", "mota", "hota", "deta", "assa",
    "end_to_end", "found_on_one_track", "first_to_last", "error", "unknown_share_found", "unknown_share_true",
    "geh_below_5_share", "count_error", "share_error", "within_stated_95", "count_ratio",
}  # fmt: skip
_WIDTH = 46


def page(numbers: Mapping[str, Any]) -> str:
    """Return *numbers* of an evaluation as text: one line a score, its 95 % interval in brackets."""
    frames = numbers["frames"]
    lines = [
        f"{frames['scored']} frames scored, {frames['not_used_by_the_run']} of them not used by the run; "
        f"[95 % intervals] over {frames['blocks']} blocks of {frames['block_s']:g} s"
    ]
    lines += ["", "In short", *_headlines(numbers)]
    for section, title in _TITLES.items():
        lines += ["", title]
        lines += list(_lines(numbers[section], 1)) if numbers[section] else ["  the truth says nothing about it"]
    if numbers["remarks"]:
        lines += ["", "Remarks", *(f"  {remark}" for remark in numbers["remarks"])]
    return "\n".join(lines) + "\n"


def _headlines(numbers: Mapping[str, Any]) -> Iterator[str]:
    for path, label in _HEADLINES.items():
        value: Any = numbers
        for name in path:
            value = value.get(name) if isinstance(value, Mapping) else None
        if value is not None:
            yield f"{'  ' + label:<{_WIDTH}}{_shown(path[-1], value)}"


def _lines(numbers: Mapping[str, Any], depth: int) -> Iterator[str]:
    for name, value in numbers.items():
        label = "  " * depth + name.replace("_", " ")
        if isinstance(value, list):
            yield from ("  " * depth + row for row in _table(value))
        elif isinstance(value, Mapping) and "lo" not in value:
            yield label
            yield from _lines(value, depth + 1)
        else:
            yield f"{label:<{_WIDTH}}{_shown(name, value)}"


def _table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield counts of truth and result side by side."""
    for row in rows:
        *names, true, found = row.values()
        yield f"{' -> '.join(map(str, names)):<{_WIDTH - 2}}{true:>9.1f} true {found:>9.1f} found"


def _shown(name: str, value: Any) -> str:
    if not isinstance(value, Mapping):
        return _number(name, value)
    low, high = value["lo"], value["hi"]
    interval = "" if low is None else f"  [{_number(name, low).strip()}, {_number(name, high).strip()}]"
    return _number(name, value["value"]) + interval


def _number(name: str, value: float | int | None) -> str:
    if value is None:
        return f"{'–':>9}"
    if name in _PERCENT:
        return f"{100 * value:>8.1f}%"
    return f"{value:>9}" if isinstance(value, int) else f"{value:>9.2f}"
