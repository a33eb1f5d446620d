"""Compare what is stored with what was written: the hashes of every file that a snapshot or a part names."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from vtrack_batch.errors import StorageError
from vtrack_batch.storage.output import Output


@dataclass(frozen=True)
class Damage:
    """A file that is not what was written."""

    place: str
    what: str


def check_snapshot(snapshot: Path) -> Iterator[Damage]:
    """Yield what is wrong with the files of *snapshot*: missing, of another size or content, or not of it."""
    try:
        manifest = json.loads((snapshot / "manifest.json").read_bytes())
        listed: Mapping[str, Mapping[str, Any]] = manifest["files"]
    except (OSError, ValueError, KeyError) as problem:
        yield Damage(f"{snapshot.name}/manifest.json", f"cannot be read ({problem})")
        return
    for place, about in listed.items():
        if not is_confined(place):
            yield Damage(place, "names a file outside the snapshot")
            continue
        yield from _check(snapshot / place, about, f"{snapshot.name}/{place}")
    tables = {place.split("/")[0] for place in listed if place.endswith(".parquet")}
    for table in sorted(tables):
        for path in sorted((snapshot / table).rglob("*")):
            place = path.relative_to(snapshot).as_posix()
            if path.is_file() and place not in listed:
                yield Damage(f"{snapshot.name}/{place}", "was not published: somebody put it there")


def check_parts(output: Output) -> Iterator[tuple[str, str, Damage]]:
    """Yield step, key and what is wrong with each part of *output* that is not what was written."""
    for step in sorted(path.name for path in output.data.iterdir() if path.is_dir()):
        for key in sorted(output.keys(step)):
            for damage in _check_part(output, step, key):
                yield step, key, damage


def is_confined(place: str) -> bool:
    """Return whether *place*, as a manifest names it, lies inside its snapshot."""
    path = PurePosixPath(place)
    return bool(place) and not path.is_absolute() and ".." not in path.parts and "\0" not in place


def _check_part(output: Output, step: str, key: str) -> Iterator[Damage]:
    place = f"data/{step}/{key}"
    try:
        part = output.part(step, key)
    except StorageError as problem:
        yield Damage(place, str(problem))
        return
    if part is None:
        yield Damage(place, "has no part.json")
        return
    for name, about in part.files.items():
        if is_confined(name):
            yield from _check(part.file(name), about, f"{place}/{name}")
        else:
            yield Damage(f"{place}/part.json", "names a file outside the part")


def _check(path: Path, about: Mapping[str, Any], place: str) -> Iterator[Damage]:
    try:
        with path.open("rb") as stream:
            sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as problem:
        yield Damage(place, "is missing" if isinstance(problem, FileNotFoundError) else f"cannot be read ({problem})")
        return
    size = path.stat().st_size
    if size != about["bytes"]:
        yield Damage(place, f"has {size} bytes, not {about['bytes']}")
    elif sha256 != about["sha256"]:
        yield Damage(place, "has another content than was written")
