"""Step ``publish``: the finished parts of the plan become one snapshot."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from vtrack_batch import __version__
from vtrack_batch.model.tables import TABLES
from vtrack_batch.pipeline.index import Index
from vtrack_batch.pipeline.parts import Context, read
from vtrack_batch.pipeline.plan import Piece, Plan
from vtrack_batch.storage.output import Part, digest
from vtrack_batch.storage.parquet import write_table

OF_SEQUENCE = ("frames", "registrations", "references", "detections", "matches", "track_points")
OF_DATE = ("trajectories", "crossings", "od_pairs", "turns", "speeds", "flows", "stops", "coverage")


def publish(plan: Plan, index: Index, context: Context) -> tuple[Path, dict[str, Any]] | None:
    """Publish the parts of *plan*; returns the snapshot and its manifest, or None if it would equal the current one."""
    output = context.output
    sequences = [(piece, context.part(piece)) for piece in plan.track]
    dates = [(piece, context.part(piece)) for piece in plan.traffic]
    pictures = [(piece, context.part(piece)) for piece in plan.picture]
    links = dict(_table_links(sequences, dates)) | dict(_picture_links(pictures)) | dict(_zone_links(dates))
    hashes = {place: dict(part.files[source]) for place, (part, source) in links.items()}
    quarantine = pd.concat([index.quarantine, read([part for _, part in sequences], "quarantine")], ignore_index=True)
    content = digest(hashes, quarantine.to_dict("records"))
    current = output.current_manifest()
    if current is not None and current.get("content") == content:
        return None
    staged = output.state / "staging" / "quarantine.parquet"
    write_table(staged, TABLES["quarantine"], quarantine.drop_duplicates("path"))
    manifest = _manifest(context, index, sequences, dates, hashes, content)
    files = {place: part.file(source) for place, (part, source) in links.items()}
    files["quarantine/quarantine.parquet"] = staged
    written = {"report/report.html": _page(manifest, dates, pictures, quarantine)}
    folder = output.publish(files, written, manifest)
    staged.unlink()
    return folder, manifest


def slug(name: str) -> str:
    """Return *name* as a plain file name: letters, digits, dots, dashes."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("_.")[:80] or "x"


def _table_links(
    sequences: list[tuple[Piece, Part]], dates: list[tuple[Piece, Part]]
) -> Iterator[tuple[str, tuple[Part, str]]]:
    date_of = {need.key: piece.name for piece, _ in dates for need in piece.needs}
    for piece, part in sequences:
        for table in OF_SEQUENCE:
            place = f"{table}/date={date_of[piece.key]}/{slug(piece.name)}-{piece.key[:8]}.parquet"
            yield place, (part, f"{table}.parquet")
    for piece, part in dates:
        for table in OF_DATE:
            yield f"{table}/date={piece.name}/{piece.key[:8]}.parquet", (part, f"{table}.parquet")


def _picture_links(pictures: list[tuple[Piece, Part]]) -> Iterator[tuple[str, tuple[Part, str]]]:
    for piece, part in pictures:
        for name in part.files:
            folder = "ground" if name.endswith(".tif") else "report"
            yield f"{folder}/{slug(piece.name)}-{name}", (part, name)


def _zone_links(dates: list[tuple[Piece, Part]]) -> Iterator[tuple[str, tuple[Part, str]]]:
    for piece, part in dates:
        kind = "proposed-zones" if part.about["proposed"] else "zones"
        yield f"report/{kind}-{piece.name}.geojson", (part, "zones.geojson")


def _manifest(
    context: Context,
    index: Index,
    sequences: list[tuple[Piece, Part]],
    dates: list[tuple[Piece, Part]],
    hashes: Mapping[str, Mapping[str, Any]],
    content: str,
) -> dict[str, Any]:
    frames = read([part for _, part in sequences], "frames")
    crs = next((part.about["crs"] for _, part in sequences if part.about["crs"]), None)
    return {
        "survey": context.survey.survey.name,
        "version": __version__,
        "content": content,
        "crs": crs,
        "time_zone": context.survey.survey.time_zone,
        "tables": {name: {"schema": f"{name}/{table.version}"} for name, table in TABLES.items()},
        "files": {place: dict(about) for place, about in sorted(hashes.items())},
        "frames": {
            "used": int((frames["status"] == "used").sum()),
            "quarantined": int((frames["status"] != "used").sum() + len(index.quarantine)),
        },
        "zones_proposed": any(part.about["proposed"] for _, part in dates),
        "inputs": {"frames": len(index.frames), "content": digest(sorted(index.frames["sha256"]))},
        "parameters": context.survey.model_dump(mode="json", exclude={"execution": {"workers"}}),
    }


def _page(
    manifest: Mapping[str, Any],
    dates: list[tuple[Piece, Part]],
    pictures: list[tuple[Piece, Part]],
    quarantine: pd.DataFrame,
) -> str:
    from vtrack_batch.report.summary import summary_page

    parts = [part for _, part in dates]
    tables = {name: read(parts, name) for name in ("od_pairs", "turns", "speeds", "coverage", "stops")}
    images = {
        f"{piece.name} {name.removesuffix('.png')}": part.file(name).read_bytes()
        for piece, part in pictures
        for name in sorted(part.files)
        if name.endswith(".png")
    }
    return summary_page(dict(manifest), {**tables, "quarantine": quarantine}, images)
