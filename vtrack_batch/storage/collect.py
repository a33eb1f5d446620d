"""Remove what nobody needs any more: snapshots that were superseded a while ago, and parts that none names."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from vtrack_batch.storage.durable import remove_tree
from vtrack_batch.storage.output import MARK, Output

LEAST_HOURS = 24.0
"""A reader that resolved `current` before it moved on has so much time to finish."""


@dataclass(frozen=True)
class Rubbish:
    """What can go, and the bytes that only it holds."""

    snapshots: tuple[Path, ...]
    parts: tuple[Path, ...]
    bytes: int


def find_rubbish(output: Output, live: Mapping[str, Collection[str]], *, keep_hours: float = LEAST_HOURS) -> Rubbish:
    """Return what *output* can do without: step → keys of the parts in *live* are needed besides the published ones.

    Snapshots stay until *keep_hours* after they were superseded; parts stay as long as a snapshot names them, and for
    *keep_hours* after they were made, for a run that has not published yet.
    """
    if not (output.root / MARK).is_file():
        return Rubbish((), (), 0)
    before_s = time.time() - max(keep_hours, LEAST_HOURS) * 3600
    snapshots = tuple(_superseded(output, before_s))
    kept = [folder for folder in _numbered(output) if folder not in snapshots]
    named = {step: set(keys) for step, keys in live.items()}
    for folder in kept:
        for step, keys in _named(folder).items():
            named.setdefault(step, set()).update(keys)
    parts = tuple(
        folder
        for step in sorted(path for path in output.data.iterdir() if path.is_dir())
        for folder in sorted(step.iterdir())
        if folder.name not in named.get(step.name, ()) and folder.lstat().st_mtime < before_s
    )
    return Rubbish(snapshots, parts, _bytes_only_in((*snapshots, *parts)))


def remove(rubbish: Rubbish) -> None:
    """Remove *rubbish*, each folder at once."""
    for folder in (*rubbish.snapshots, *rubbish.parts):
        if folder.is_symlink():
            folder.unlink()
        elif folder.is_dir():
            remove_tree(folder)
        else:
            folder.unlink(missing_ok=True)
    for folder in {folder.parent for folder in (*rubbish.snapshots, *rubbish.parts)}:
        for rest in folder.glob(".removed-*"):
            shutil.rmtree(rest, ignore_errors=True)


def _numbered(output: Output) -> list[Path]:
    return sorted(path for path in output.snapshots.iterdir() if path.name.isdigit() and not path.is_symlink())


def _superseded(output: Output, before_s: float) -> Iterator[Path]:
    """Yield snapshots whose successor was published before *before_s*, and those that never became the current one."""
    current = output.current.resolve()
    folders = _numbered(output)
    for folder, successor in zip(folders, [*folders[1:], None], strict=True):
        if folder.resolve() == current:
            continue
        since = successor if successor is not None and folder.name < current.name else folder
        if since.stat().st_mtime < before_s:
            yield folder


def _named(snapshot: Path) -> dict[str, set[str]]:
    try:
        parts = json.loads((snapshot / "manifest.json").read_bytes())["parts"]
    except (OSError, ValueError, KeyError):
        return {}
    return {step: set(by_name.values()) for step, by_name in parts.items()}


def _bytes_only_in(folders: Collection[Path]) -> int:
    """Return the bytes that go when *folders* go: of files all of whose names are in them."""
    names: dict[tuple[int, int], int] = {}
    sizes: dict[tuple[int, int], tuple[int, int]] = {}
    for folder in folders:
        for path in folder.rglob("*"):
            status = path.lstat()
            if path.is_file() and not path.is_symlink():
                place = (status.st_dev, status.st_ino)
                names[place] = names.get(place, 0) + 1
                sizes[place] = (status.st_nlink, status.st_size)
    return sum(size for place, (links, size) in sizes.items() if names[place] >= links)
