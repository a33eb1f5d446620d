"""Step ``publish``: the finished parts of the plan become one snapshot."""

from __future__ import annotations

import gc
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from vtrack_batch import __version__
from vtrack_batch.archive.scan import OUT_OF_PERIOD
from vtrack_batch.errors import StorageError
from vtrack_batch.model.tables import TABLES
from vtrack_batch.pipeline.index import Index
from vtrack_batch.pipeline.parts import Context, read
from vtrack_batch.pipeline.plan import STEPS, Piece, Plan, date_of
from vtrack_batch.storage.durable import fsync
from vtrack_batch.storage.output import Output, Part, described, digest
from vtrack_batch.storage.parquet import write_table

QUARANTINE = "quarantine/quarantine.parquet"
LONGEST_SLUG = 80
OF_SEQUENCE = ("frames", "registrations", "references", "detections", "matches", "track_points")
OF_DATE = ("trajectories", "crossings", "od_pairs", "turns", "speeds", "flows", "stops", "coverage")


REPORT_DATES = 31
"""The report shows the newest dates only: of years, nobody reads all, and a page must stay readable."""

REPORT_PICTURES = 12
"""Of these dates, the newest pictures; all are files beside the report."""

ON_PAGE = ".page.jpg"
"""Ends the names of pictures as the report shows them; they are in its page only."""

Done = list[tuple[Piece, Part]]


@dataclass(frozen=True)
class Contents:
    """What a snapshot of finished parts holds: ``links`` place → (part, its file), and the rows of ``quarantine``."""

    plan: Plan
    sequences: Done
    dates: Done
    pictures: Done
    links: Mapping[str, tuple[Part, str]]
    quarantine: pd.DataFrame

    @cached_property
    def hashes(self) -> dict[str, dict[str, Any]]:
        """Place → {sha256, bytes, rows} of every linked file."""
        return {place: part.about["files"][source] for place, (part, source) in self.links.items()}

    @cached_property
    def parts(self) -> dict[str, dict[str, str]]:
        """Step → name of the piece → key of its part."""
        by_step: dict[str, dict[str, str]] = {step: {} for step in STEPS}
        for piece in self.plan.pieces():
            by_step[piece.step][piece.name] = piece.key
        return by_step

    @cached_property
    def digest(self) -> str:
        """What tells two snapshots apart."""
        files = "\n".join(f"{place} {about['sha256']}" for place, about in sorted(self.hashes.items()))
        return digest(files, self.parts, self.quarantine.to_dict("records"))

    def published_in(self, output: Output) -> bool:
        """Return whether the current snapshot of *output* is this one."""
        current = output.current_manifest()
        return current is not None and current.get("content") == self.digest and not output.is_distrusted()


def contents(plan: Plan, index: Index, context: Context) -> Contents:
    """Return what a snapshot of *plan* holds, all of whose parts must be there."""
    sequences = [(piece, context.part(piece)) for piece in plan.track]
    dates = [(piece, context.part(piece)) for piece in plan.traffic]
    pictures = [(piece, context.part(piece)) for piece in plan.picture]
    links = dict(_table_links(sequences, dates)) | dict(_picture_links(pictures)) | dict(_zone_links(dates))
    losing = [part for _, part in sequences if part.about["frames_lost"]]
    quarantine = pd.concat([index.quarantine, read(losing, "quarantine")], ignore_index=True).drop_duplicates("path")
    return Contents(plan, sequences, dates, pictures, links, quarantine)


def publish(plan: Plan, index: Index, context: Context) -> tuple[Path, dict[str, Any]] | None:
    """Publish the parts of *plan*; returns the snapshot and its manifest, or None if it would equal the current one.

    What is read, hashed and drawn grows with what a report shows, not with the archive; every file gets its name anew.
    """
    with _nothing_collected():
        return _publish(plan, index, context)


def _publish(plan: Plan, index: Index, context: Context) -> tuple[Path, dict[str, Any]] | None:
    output = context.output
    found = contents(plan, index, context)
    if found.published_in(output):
        return None
    staged = output.staging / "quarantine.parquet"
    try:
        write_table(staged, TABLES["quarantine"], found.quarantine)
        fsync(staged)
    except OSError as problem:
        raise StorageError(f"{staged}: cannot be written ({problem}); the earlier results are intact") from None
    hashes = {**found.hashes, QUARANTINE: described(staged)}
    manifest = _manifest(context, index, found, hashes)
    files: dict[str, str | Path] = {place: f"{part.folder}/{source}" for place, (part, source) in found.links.items()}
    written = {"report/report.html": _page(manifest, found)}
    folder = output.publish({**files, QUARANTINE: staged}, written, manifest)
    with suppress(OSError):  # published is published; what is left in staging is swept
        staged.unlink()
    return folder, manifest


@contextmanager
def _nothing_collected() -> Iterator[None]:
    """Keep the garbage collector from walking, again and again, through what is told of a hundred thousand files."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def slug(name: str) -> str:
    """Return the name of a sequence, platform/start, as a file name of its own: platform_start.

    A platform of other letters than a-z, digits, dots, dashes and inner underscores gets a piece of its hash, so that
    two never share a file; none begins with an underscore or a dot, which readers of Parquet folders pass over.
    """
    plain = re.sub(r"[^A-Za-z0-9.-]", "_", name).strip("_.")
    if "/".join(plain.rsplit("_", 1)) == name and len(plain) <= LONGEST_SLUG:
        return plain
    return f"{plain[-LONGEST_SLUG:].lstrip('_.')}-{digest(name)[:8]}"


def _table_links(sequences: Done, dates: Done) -> Iterator[tuple[str, tuple[Part, str]]]:
    date_of = {need.key: piece.name for piece, _ in dates for need in piece.needs}
    for piece, part in sequences:
        place = f"date={date_of[piece.key]}/{slug(piece.name)}-{piece.key[:8]}.parquet"
        for table in OF_SEQUENCE:
            yield f"{table}/{place}", (part, f"{table}.parquet")
    for piece, part in dates:
        for table in OF_DATE:
            yield f"{table}/date={piece.name}/{piece.key[:8]}.parquet", (part, f"{table}.parquet")


def _picture_links(pictures: Done) -> Iterator[tuple[str, tuple[Part, str]]]:
    for piece, part in pictures:
        for name in part.files:
            if name.endswith(ON_PAGE):
                continue
            folder = "ground" if name.endswith(".tif") else "report"
            yield f"{folder}/{slug(piece.name)}-{name}", (part, name)


def _zone_links(dates: Done) -> Iterator[tuple[str, tuple[Part, str]]]:
    for piece, part in dates:
        kind = "proposed-zones" if part.about["proposed"] else "zones"
        yield f"report/{kind}-{piece.name}.geojson", (part, "zones.geojson")


def _manifest(
    context: Context, index: Index, found: Contents, hashes: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    used = sum(part.about["frames_used"] for _, part in found.sequences)
    lost = sum(part.about["frames_lost"] for _, part in found.sequences)
    crs = next((part.about["crs"] for _, part in found.sequences if part.about["crs"]), None)
    set_aside = int((index.quarantine["reason"] != OUT_OF_PERIOD).sum())
    return {
        "survey": context.survey.survey.name,
        "version": __version__,
        "content": found.digest,
        "crs": crs,
        "time_zone": context.survey.survey.time_zone,
        "tables": {name: {"schema": f"{name}/{table.version}"} for name, table in TABLES.items()},
        "files": hashes,
        "frames": {"used": used, "quarantined": lost + set_aside},
        "parts": found.parts,
        "zones_proposed": any(part.about["proposed"] for _, part in found.dates),
        "inputs": {"frames": len(index.frames), "content": index.content()},
        "parameters": context.survey.model_dump(mode="json", exclude={"execution": {"workers"}}),
    }


def _page(manifest: Mapping[str, Any], found: Contents) -> str:
    from vtrack_batch.report.summary import summary_page

    shown = {piece.name for piece, _ in found.dates[-REPORT_DATES:]}
    parts = [part for piece, part in found.dates if piece.name in shown]
    tables = {name: read(parts, name) for name in ("od_pairs", "turns", "speeds", "coverage", "stops")}
    tables["trajectories"] = read(parts, "trajectories", ["flags"])
    pictures = [
        (f"{piece.name} {name.removesuffix(ON_PAGE)}", part.file(name))
        for piece, part in found.pictures
        if date_of(piece) in shown
        for name in sorted(part.files)
        if name.endswith(ON_PAGE)
    ]
    images = {caption: file.read_bytes() for caption, file in pictures[-REPORT_PICTURES:]}
    return summary_page(dict(manifest), {**tables, "quarantine": found.quarantine}, images)
