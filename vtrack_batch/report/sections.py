"""The sections of the summary page: each a table or two as HTML, empty where there is nothing to show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.model.flags import TrajectoryFlag, legend

_ALL = "all"
_MAX_MATRIX = 24
_MAX_ROWS = 60
_KMH = 3.6


def warnings(manifest: Mapping[str, Any], tables: Mapping[str, pd.DataFrame]) -> str:
    """Return what a reader must know before believing any number."""
    texts = []
    used, lost = _frame_counts(manifest)
    if used == 0:
        texts.append("No frame could be used: the tables are empty.")
    elif lost > 0.05 * (used + lost):
        texts.append(f"{lost} of {used + lost} frames could not be used; see Frames.")
    if manifest.get("zones_proposed"):
        texts.append(
            "No zones were given: zones were proposed from where vehicles appear and disappear. "
            "Look at the map, correct the GeoJSON beside this page, and name it in the survey file."
        )
    unknown = _unknown_share(tables.get("od_pairs"))
    if unknown is not None and unknown > 0.3:
        texts.append(f"{unknown:.0%} of trips have an unknown origin or destination.")
    coverage = tables.get("coverage")
    if coverage is not None and len(coverage):
        partial = float((coverage["observed_s"] < 0.95 * coverage["bin_s"]).mean())
        if partial > 0.2:
            texts.append(
                f"{partial:.0%} of all places and time bins were in view for part of the time or not at all; "
                "vehicles an hour are scaled up from the time in view."
            )
    if not texts:
        return ""
    return '<div class="warnings"><ul>' + "".join(f"<li>{escape(text)}</li>" for text in texts) + "</ul></div>"


def frames(manifest: Mapping[str, Any], tables: Mapping[str, pd.DataFrame]) -> str:
    """Return how many frames were used, and why the others were not."""
    used, lost = _frame_counts(manifest)
    rows: list[tuple[object, ...]] = [("used", used, "")]
    quarantine = tables.get("quarantine")
    if quarantine is not None and len(quarantine):
        by_reason = quarantine.astype({"reason": str}).groupby("reason", sort=True)
        rows += [(reason, len(group), str(group["path"].min())) for reason, group in by_reason]
    elif lost:
        rows.append(("set aside", lost, ""))
    return "<h2>Frames</h2>" + html_table(("", "frames", "for example"), rows)


def trajectories(table: pd.DataFrame | None) -> str:
    """Return how many trajectories there are, and how many of them carry each doubt; only ``flags`` is read."""
    if table is None or table.empty:
        return ""
    flags = table["flags"].to_numpy(int)
    rows: list[tuple[object, ...]] = [("all", len(flags), "")]
    rows += [
        (flag.name.replace("_", " "), int((flags & flag.bit > 0).sum()), flag.meaning)
        for flag in legend(TrajectoryFlag)
    ]
    return "<h2>Trajectories</h2>" + html_table(("", "trajectories", "meaning"), rows)


def od_pairs(table: pd.DataFrame | None) -> str:
    """Return the matrix of trips of all classes over all bins, with totals."""
    if table is None or table.empty:
        return ""
    trips = _all_classes(table).astype({"origin": str, "destination": str})
    matrix = trips.pivot_table(index="origin", columns="destination", values="count", aggfunc="sum", fill_value=0.0)
    if matrix.empty or not matrix.to_numpy().sum():
        return "<h2>Origins and destinations</h2><p>No trips.</p>"
    names = sorted(set(matrix.index) | set(matrix.columns), key=lambda name: (name in ("unknown", "parked"), name))
    matrix = matrix.reindex(index=names, columns=names, fill_value=0.0)
    note = ""
    if len(names) > _MAX_MATRIX:
        weight = matrix.sum(axis=1) + matrix.sum(axis=0)
        kept = set(weight.sort_values(ascending=False, kind="stable").index[:_MAX_MATRIX])
        names = [name for name in names if name in kept]
        note = f'<p class="note">The {_MAX_MATRIX} busiest places; all are in the table od_pairs.</p>'
    largest = max(float(matrix.to_numpy().max()), 1.0)
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    body = []
    for origin in names:
        cells = "".join(_shaded(value, largest) for value in np.asarray(matrix.loc[origin, names], float).tolist())
        body.append(f"<tr><td>{escape(origin)}</td>{cells}<td><b>{matrix.loc[origin].sum():.0f}</b></td></tr>")
    totals = "".join(f"<td><b>{matrix[name].sum():.0f}</b></td>" for name in names)
    body.append(f"<tr><td><b>total</b></td>{totals}<td><b>{matrix.to_numpy().sum():.0f}</b></td></tr>")
    return (
        '<h2>Origins and destinations</h2><p class="sub">vehicles from row to column, all bins</p>'
        f'<div class="wide"><table><tr><th>from \\ to</th>{head}<th>total</th></tr>{"".join(body)}</table></div>{note}'
    )


def turns(table: pd.DataFrame | None) -> str:
    """Return counts, shares and rates of movements over all bins."""
    if table is None or table.empty:
        return ""
    keys = ["junction", "approach", "movement"]
    counted = _all_classes(table).astype(dict.fromkeys(keys, str))
    sums = counted.groupby(keys, sort=True)[["count", "observed_s"]].sum(min_count=1).reset_index()
    known = sums["count"].where(sums["movement"] != "unknown")
    per_approach = known.groupby([sums["junction"], sums["approach"]]).transform("sum")
    rate_vph = 3600 * sums["count"] / sums["observed_s"].where(sums["observed_s"] > 0)
    rows = zip(
        *(sums[key] for key in keys),
        sums["count"].map(_whole),
        (known / per_approach.where(per_approach > 0)).map(_percent),
        rate_vph.map(_whole),
        strict=True,
    )
    return "<h2>Turns</h2>" + html_table((*keys, "vehicles", "share of known turns", "veh/h"), rows)


def speeds(table: pd.DataFrame | None) -> str:
    """Return speeds per place over all bins, each bin weighted by its vehicles."""
    if table is None or table.empty:
        return ""
    measured = table.loc[table["vehicles"].fillna(0) > 0].astype({"place": str})
    rows = []
    for place, group in measured.groupby("place", sort=True):
        weight = group["vehicles"].to_numpy(float)
        values = [_weighted(group[name], weight) for name in ("time_mean_mps", "space_mean_mps", "p50_mps", "p85_mps")]
        rows.append((place, _whole(weight.sum()), *(_kmh(value) for value in values)))
    head = ("place", "vehicles", "time mean km/h", "space mean km/h", "median km/h", "85 % km/h")
    note = (
        '<p class="note">Median and 85 % are means over bins, weighted by vehicles; the table speeds has every bin.</p>'
    )
    return "<h2>Speeds</h2>" + html_table(head, rows) + note if rows else "<h2>Speeds</h2><p>None measured.</p>"


def stops(table: pd.DataFrame | None) -> str:
    """Return how often and how long vehicles stood, by kind."""
    if table is None or table.empty:
        return ""
    rows = [
        (kind, len(group), f"{group['duration_s'].median():.0f}", f"{group['duration_s'].max():.0f}")
        for kind, group in table.astype({"kind": str}).groupby("kind", sort=True)
    ]
    return "<h2>Stops</h2>" + html_table(("kind", "stops", "median s", "longest s"), rows)


def coverage(table: pd.DataFrame | None, time_zone: str) -> str:
    """Return for how long each place was in view."""
    if table is None or table.empty:
        return ""
    rows = []
    for place, group in table.astype({"place": str}).groupby("place", sort=True):
        share = float(group["observed_s"].sum() / max(float(group["bin_s"].sum()), 1.0))
        first = group["bin_start_utc"].min().tz_convert(time_zone)
        rows.append((place, len(group), f"{first:%Y-%m-%d %H:%M}", f"{group['observed_s'].sum():.0f}", _percent(share)))
    return "<h2>Coverage</h2>" + html_table(("place", "bins", "from", "observed s", "share of bins"), rows)


def html_table(head: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """Return a table of escaped cells; long ones are cut, and say so."""
    lines = ["".join(f"<td>{escape(str(cell))}</td>" for cell in row) for row in rows]
    titles = "".join(f"<th>{escape(str(cell))}</th>" for cell in head)
    body = "".join(f"<tr>{line}</tr>" for line in lines[:_MAX_ROWS])
    more = f'<p class="note">and {len(lines) - _MAX_ROWS} more</p>' if len(lines) > _MAX_ROWS else ""
    return f'<div class="wide"><table><tr>{titles}</tr>{body}</table></div>{more}'


def _frame_counts(manifest: Mapping[str, Any]) -> tuple[int, int]:
    counts = manifest.get("frames") or {}
    return int(counts.get("used", 0)), int(counts.get("quarantined", 0))


def _all_classes(table: pd.DataFrame) -> pd.DataFrame:
    rows = table.loc[table["vehicle_class"].astype(str) == _ALL]
    return rows if len(rows) else table


def _unknown_share(table: pd.DataFrame | None) -> float | None:
    if table is None or table.empty:
        return None
    trips = _all_classes(table)
    total = float(trips["count"].sum())
    unknown = (trips["origin"].astype(str) == "unknown") | (trips["destination"].astype(str) == "unknown")
    return float(trips.loc[unknown, "count"].sum()) / total if total else None


def _weighted(values: pd.Series, weight: np.ndarray) -> float:
    numbers = values.to_numpy(float, na_value=np.nan)
    known = np.isfinite(numbers)
    return float(np.average(numbers[known], weights=weight[known])) if known.any() else float("nan")


def _shaded(value: float, largest: float) -> str:
    strength = 0.75 * (value / largest) ** 0.5
    return f'<td style="background:rgba(86,180,233,{strength:.2f})">{value:.0f}</td>' if value else "<td></td>"


def _whole(value: float) -> str:
    return "–" if pd.isna(value) else f"{value:.0f}"


def _percent(value: float) -> str:
    return "–" if pd.isna(value) else f"{value:.0%}"


def _kmh(value: float) -> str:
    return "–" if pd.isna(value) else f"{_KMH * value:.1f}"
