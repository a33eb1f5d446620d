"""What ``vtrack-batch init`` writes: a commented survey file, its schema for editors, a template for zones."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from vtrack_batch.config.example import example_yaml, schema_json
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import CannotCreate, ConfigError, NoArchive, VtrackError
from vtrack_batch.model.zones import TEMPLATE_NAME
from vtrack_batch.storage.output import make_folder

ZONES_TEMPLATE = {
    "type": "FeatureCollection",
    "vtrack_coordinates": "local_m",
    "features": [
        {
            "type": "Feature",
            "properties": {"id": "north", "role": "gate", "name": TEMPLATE_NAME, "junction": "main"},
            "geometry": {"type": "LineString", "coordinates": [[100.0, -20.0], [130.0, -20.0]]},
        },
        {
            "type": "Feature",
            "properties": {"id": "south", "role": "gate", "name": TEMPLATE_NAME, "junction": "main"},
            "geometry": {"type": "LineString", "coordinates": [[100.0, -200.0], [130.0, -200.0]]},
        },
    ],
}


def write_survey(folder: Path, archive: Path | None) -> Iterator[str]:
    """Write survey.yaml, its schema and a template of zones into *folder*; yields what was written or guessed.

    Raises ``ConfigError`` when a survey file is already there, ``NoArchive`` when *archive* is no folder,
    ``CannotCreate`` when the folder cannot be written.
    """
    if archive is not None and not archive.is_dir():
        raise NoArchive(f"{archive}: no such folder; --from takes the folder of the frames")
    if (folder / "survey.yaml").exists():
        raise ConfigError(f"{folder / 'survey.yaml'} exists already; choose another folder or move it away")
    make_folder(folder)  # before looking: paths relative to it lead through it
    chosen: dict[str, Any] = {}
    if archive is not None:
        chosen["archive"] = {"root": os.path.relpath(archive.resolve(), folder.resolve())}
        yield from _look_at(archive, folder, chosen["archive"])
    files = {
        "survey.yaml": example_yaml(chosen, ask="gsd_m"),
        "survey.schema.json": schema_json(),
        "zones-template.geojson": json.dumps(ZONES_TEMPLATE, indent=1) + "\n",
    }
    try:
        for name, content in files.items():
            (folder / name).write_text(content, encoding="utf-8")
            yield f"written: {folder / name}"
    except OSError as problem:
        raise CannotCreate(f"{folder}: cannot be written ({problem.strerror})") from None
    yield f"next: set georeference.gsd_m in {folder / 'survey.yaml'}, then vtrack-batch check {folder / 'survey.yaml'}"


def _look_at(archive: Path, folder: Path, chosen: dict[str, Any]) -> Iterator[str]:
    """Try how the archive's times can be told; say what was guessed."""
    from vtrack_batch.pipeline.index import scan_archive

    indexes = sorted([*archive.glob("*.csv"), *archive.parent.glob("*.csv")])
    tries: list[dict[str, Any]] = [{}]
    tries += [{"index": os.path.relpath(path.resolve(), folder.resolve())} for path in indexes]
    tries += [{"exif": True}]
    for more in tries:
        survey = Survey.model_validate({"archive": {**chosen, **more}}).based_at(folder)
        try:
            found = scan_archive(survey)
        except NoArchive as problem:
            yield f"to do: {problem}"
            return
        except VtrackError as problem:
            if "time_zone" in str(problem):
                chosen |= more
                yield f"to do: {problem}"
                return
            continue
        if len(found.files):
            chosen |= more
            yield f"guessed: {len(found.files)} frames, times from {found.source}"
            return
    yield f"to do: no time could be told from {archive}; write archive.pattern or archive.index"
