"""One page that says what was found, what was not, and what to doubt: self-contained, no scripts, no network."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape
from string import Template
from typing import Any

import cv2
import numpy as np
import pandas as pd

from vtrack_batch.report import sections
from vtrack_batch.report.canvas import resized

_PICTURE_WIDTH_PX, _PICTURE_QUALITY = 1600, 82
_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
body { font: 15px/1.45 system-ui, sans-serif; color: #1d1d1f; max-width: 1180px; margin: 2em auto; padding: 0 1em }
h1 { margin-bottom: 0 } h2 { margin-top: 2em; border-bottom: 1px solid #ccc }
.sub, figcaption, .note { color: #555 }
.warnings { background: #fdf1d5; border-left: 5px solid #e69f00; padding: .4em 1.2em; margin: 1.2em 0 }
table { border-collapse: collapse; margin: .8em 0; font-variant-numeric: tabular-nums }
th, td { padding: .22em .7em; text-align: right; border-bottom: 1px solid #e3e3e3 }
th { font-weight: 600; background: #f5f5f5 } th:first-child, td:first-child { text-align: left }
.wide { overflow-x: auto } figure { margin: 1.2em 0 } img { max-width: 100%; height: auto; border: 1px solid #ccc }
</style>
</head>
<body>
<h1>$title</h1>
<p class="sub">$subtitle</p>
$body
</body>
</html>
""")


def summary_page(manifest: Mapping[str, Any], tables: Mapping[str, pd.DataFrame], pictures: Mapping[str, bytes]) -> str:
    """Return the page as HTML.

    *manifest*: ``survey``, ``version``, ``crs``, ``time_zone``, ``frames`` (used, quarantined), ``zones_proposed``,
    each optional; *tables*: of the data dictionary, by name, each optional (od_pairs, turns, speeds, coverage, stops,
    quarantine, trajectories are shown); *pictures*: what `page_picture` made, by caption, embedded as they are.
    """
    zone = str(manifest.get("time_zone") or "UTC")
    parts = [
        sections.warnings(manifest, tables),
        sections.frames(manifest, tables),
        _figures(pictures),
        sections.trajectories(tables.get("trajectories")),
        sections.od_pairs(tables.get("od_pairs")),
        sections.turns(tables.get("turns")),
        sections.speeds(tables.get("speeds")),
        sections.stops(tables.get("stops")),
        sections.coverage(tables.get("coverage"), zone),
    ]
    title = escape(str(manifest.get("survey") or "Survey"))
    return _PAGE.substitute(
        title=title, subtitle=_subtitle(manifest, tables, zone), body="\n".join(filter(None, parts))
    )


def page_picture(picture: bytes) -> bytes:
    """Return an image of any format as JPEG for the page, at most 1600 px wide."""
    shown = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    if shown is None:
        raise ValueError("a picture for the page cannot be read")
    pixels = resized(np.asarray(shown, np.uint8), min(1.0, _PICTURE_WIDTH_PX / shown.shape[1]))
    how = [cv2.IMWRITE_JPEG_QUALITY, _PICTURE_QUALITY, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    return cv2.imencode(".jpg", pixels, how)[1].tobytes()


def _subtitle(manifest: Mapping[str, Any], tables: Mapping[str, pd.DataFrame], zone: str) -> str:
    texts = []
    coverage = tables.get("coverage")
    if coverage is not None and len(coverage):
        seen = coverage.loc[coverage["observed_s"] > 0]
        if len(seen):
            start = seen["bin_start_utc"].min().tz_convert(zone)
            last = (
                (seen["bin_start_utc"] + pd.to_timedelta(seen["bin_s"].astype("int64"), unit="s"))
                .max()
                .tz_convert(zone)
            )
            longest_s = float(seen.groupby("place", observed=True)["observed_s"].sum().max())
            texts.append(f"{start:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M} ({zone}), {_duration(longest_s)} observed")
    texts.append(f"coordinates: {manifest['crs']}" if manifest.get("crs") else "coordinates: local metres")
    texts.append(f"vtrack-batch {manifest.get('version', '')}".strip())
    return escape(" · ".join(texts))


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.1f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


def _figures(pictures: Mapping[str, bytes]) -> str:
    if not pictures:
        return ""
    figures = []
    for caption in sorted(pictures):
        text = escape(caption)
        source = f"data:image/jpeg;base64,{base64.b64encode(pictures[caption]).decode('ascii')}"
        figures.append(f'<figure><img alt="{text}" src="{source}"><figcaption>{text}</figcaption></figure>')
    return "<h2>Pictures</h2>\n" + "\n".join(figures)
