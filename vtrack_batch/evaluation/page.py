"""An evaluation as a page: plain text for terminals, Markdown for reading."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

_TITLES = {
    "detection": "Detection",
    "links": "Links of tracks over consecutive frames",
    "matches": "Matches",
    "tracks": "Tracks",
    "od": "OD pairs",
    "turns": "Turns",
    "count_intervals": "Stated 95 % intervals of counts",
    "speeds": "Speeds",
}
_HEADLINES = {
    ("detection", "detections", "f1"): "detection F1",
    ("detection", "movers", "recall"): "recall of movers, per frame after tracking",
    ("detection", "movers", "precision"): "precision of movers",
    ("links", "precision"): "link precision",
    ("matches", "label_rate"): "label rate of matches",
    ("matches", "calibration_of_links", "ece"): "calibration error of match probabilities",
    ("tracks", "idf1"): "identity of tracks (IDF1)",
    ("tracks", "end_to_end"): "vehicles tracked end to end",
    ("tracks", "classes", "right_class"): "tracks of the right class (car, van, lorry, bus)",
    ("od", "error"): "OD table error",
    ("od", "unknown_share_found"): "share of trips with an unknown end, found",
    ("od", "unknown_share_true"): "share of trips with an unknown end, true",
    ("turns", "share_error"): "turn share error",
    ("speeds", "rms_kmh"): "speed error, RMS km/h",
    ("count_intervals", "od_pairs", "coverage"): "true OD counts within their stated 95 %",
}
_PERCENT = {
    "precision", "recall", "f1", "precision_between_vehicles", "label_rate", "label_rate_earlier", "label_rate_later",
    "idf1", "mota", "mota_carried", "hota", "deta", "assa", "end_to_end", "found_on_one_track", "first_to_last",
    "error", "unknown_share_found", "unknown_share_true", "geh_below_2", "geh_below_5", "count_error", "share_error",
    "count_ratio", "within_stated_50", "within_stated_80", "within_stated_95", "coverage", "too_low", "too_high",
    "mean_stated", "share_right", "ece", "right_class", "taken_for_car", "taken_for_van", "taken_for_lorry",
    "taken_for_bus", "taken_for_unknown",
}  # fmt: skip
_NOTHING = "the truth or the result says nothing about it"
_WIDTH = 48
_TERMINAL_ROWS, _ALL_ROWS = 20, 10**9


def page(numbers: Mapping[str, Any]) -> str:
    """Return *numbers* as text, one line a score, its 95 % interval in brackets; what matters most comes last."""
    lines = [_scope(numbers)]
    for section, title in _TITLES.items():
        lines += ["", title, *(_text_line(*row) for row in _rows(numbers[section], 1, _TERMINAL_ROWS))]
    if numbers["remarks"]:
        lines += ["", "Remarks", *(f"  {remark}" for remark in numbers["remarks"])]
    lines += [
        "",
        "In short",
        *(_text_line(1, label, _shown(name, value)) for label, name, value in _headlines(numbers)),
    ]
    return "\n".join(lines) + "\n"


def markdown(numbers: Mapping[str, Any]) -> str:
    """Return *numbers* as a Markdown page, what matters most first; docs/measures.md says what each score means."""
    lines = ["# Evaluation", "", _scope(numbers), "", "## In short", ""]
    lines += _markdown_table([(label, _shown(name, value)) for label, name, value in _headlines(numbers)])
    for section, title in _TITLES.items():
        lines += ["", f"## {title}", ""]
        rows = [
            ("&nbsp;" * 4 * (depth - 1) + label, shown) for depth, label, shown in _rows(numbers[section], 1, _ALL_ROWS)
        ]
        lines += _markdown_table(rows) if numbers[section] else [f"*{_NOTHING}*"]
    if numbers["remarks"]:
        lines += ["", "## Remarks", "", *(f"* {remark}" for remark in numbers["remarks"])]
    return "\n".join(lines) + "\n"


def _scope(numbers: Mapping[str, Any]) -> str:
    frames = numbers["frames"]
    return (
        f"{frames['scored']} frames scored, {frames['not_used_by_the_run']} of them not used by the run; "
        f"[95 % intervals] over {frames['blocks']} blocks of {frames['block_s']:g} s, "
        "of counts over bins or parts of them"
    )


def _headlines(numbers: Mapping[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Yield label, name and value of the scores that matter most, as far as they are known."""
    for path, label in _HEADLINES.items():
        value: Any = numbers
        for name in path:
            value = value.get(name) if isinstance(value, Mapping) else None
        if value is not None and not (isinstance(value, Mapping) and value["value"] is None):
            yield label, path[-1], value


def _rows(numbers: Mapping[str, Any] | None, depth: int, most: int) -> Iterator[tuple[int, str, str]]:
    """Yield depth, label and value in words, line by line; of lists at *most* so many rows."""
    if not numbers:
        yield depth, _NOTHING, ""
        return
    for name, value in numbers.items():
        label = name.replace("_", " ")
        if isinstance(value, list):
            yield from ((depth + 1, *_listed(row)) for row in value[:most])
            if len(value) > most:
                yield depth + 1, f"and {len(value) - most} more", ""
        elif isinstance(value, Mapping) and "lo" not in value:
            yield depth, label, ""
            yield from _rows(value, depth + 1, most)
        elif value is None and depth == 1 and name in ("od_pairs", "turns", "flows"):
            yield depth, label, _NOTHING
        elif name == "with_interval" and not value:
            yield depth, label, "none stated"
        else:
            yield depth, label, _shown(name, value)


def _listed(row: Mapping[str, Any]) -> tuple[str, str]:
    """Return one row of a list in words: a bin of a reliability curve, or counts of a cell side by side."""
    if "share_right" in row:
        label = f"stated {row['above']:.3g} to {row['up_to']:.3g}: {row['events']}"
        right = _shown("share_right", row["share_right"])
        return label, f"{right} right, {100 * row['mean_stated']:.1f}% stated"
    *names, true, found, geh = row.values()
    return " -> ".join(map(str, names)), f"{true:>8.1f} true {found:>8.1f} found, GEH {geh:.1f}"


def _text_line(depth: int, label: str, shown: str) -> str:
    return f"{'  ' * depth + label:<{_WIDTH}}{shown}".rstrip()


def _markdown_table(rows: Sequence[tuple[str, str]]) -> list[str]:
    return ["| | |", "|---|---:|", *(f"| {label} | {shown.strip()} |" for label, shown in rows)]


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
