"""The layout of a result folder: the only file that knows it.

::

    OUT/current -> snapshots/000042        one atomic pointer
    OUT/snapshots/NNNNNN/<table>/date=YYYY-MM-DD/*.parquet, manifest.json, report/, ground/
    OUT/data/<step>/<key>/                 finished parts, never modified; part.json lists what is in them
    OUT/state/                             lock, staging, remembered hashes, logs of runs

A *part* is the result of one step on one piece of work, named by the hash of all that went into it. Its folder is
filled under ``state/staging`` and renamed into ``data`` when it is whole: a part that exists is complete.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from vtrack_batch.errors import CannotCreate, StorageError
from vtrack_batch.storage.durable import (
    fsync,
    fsync_folders,
    link,
    make_durable_folder,
    remove_tree,
    write_durable,
)
from vtrack_batch.storage.lock import locked

MARK = "VTRACK_OUTPUT"


@dataclass(frozen=True)
class Part:
    """A finished part on disk."""

    folder: Path
    about: Mapping[str, Any]

    def file(self, name: str) -> Path:
        """Return the path of the file *name* of this part."""
        return self.folder / name

    @property
    def files(self) -> Mapping[str, Mapping[str, Any]]:
        """Name → {sha256, bytes, rows} of every file of the part."""
        files: Mapping[str, Mapping[str, Any]] = self.about["files"]
        return files


class Output:
    """A result folder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.data = root / "data"
        self.snapshots = root / "snapshots"
        self.state = root / "state"
        self.staging = self.state / "staging"
        self.current = root / "current"

    def create(self) -> None:
        """Make the folders; raises ``CannotCreate`` where that is impossible."""
        try:
            for folder in (self.data, self.snapshots, self.staging):
                make_durable_folder(folder)
            if len({folder.stat().st_dev for folder in (self.data, self.snapshots, self.staging, self.root)}) > 1:
                raise OSError(errno.EXDEV, "data, snapshots and state must be on its own file system")
            # beside the staging area, which the holder of the lock may just be clearing
            probe = self.state / f"probe-{secrets.token_hex(4)}"
            probe.write_bytes(b"")
            probe.unlink()
            mark = self.root / MARK
            if not mark.exists():
                mark.write_text("This folder is written by vtrack-batch; `current` leads to the newest results.\n")
        except OSError as problem:
            raise CannotCreate(
                f"{self.root}: the output folder cannot be written ({problem.strerror}); "
                "choose another with output.root or --out, or mend its permissions"
            ) from None

    @contextmanager
    def locked(self, wait_s: float = 0.0) -> Iterator[None]:
        """Hold the output against other runs and sweep up after killed ones; raises ``Busy`` that names the holder."""
        with locked(self.state, what=str(self.root), wait_s=wait_s):
            try:
                self._sweep()
            except OSError as problem:
                raise StorageError(
                    f"{self.staging}: cannot be cleared ({problem}); may this user delete there?"
                ) from None
            yield

    def _sweep(self) -> None:
        """Remove what is half written; a worker that outlived its run can no longer finish any of it."""
        remove_tree(self.staging)
        self.staging.mkdir(0o700)  # nobody else can lay a link where a file is about to be written
        for folder in (*self.state.glob(".removed-*"), *self.snapshots.glob(".removed-*")):
            shutil.rmtree(folder, ignore_errors=True)
        for rest in (*self.root.glob(".current-*"), *self.state.glob("probe-*"), *self.state.glob(".*.tmp")):
            rest.unlink(missing_ok=True)

    # parts ---------------------------------------------------------------------------------------------------------

    def keys(self, step: str) -> frozenset[str]:
        """Return the keys of all finished parts of *step*."""
        try:
            return frozenset(os.listdir(self.data / step))  # noqa: PTH208 # names only, for there are many
        except (FileNotFoundError, NotADirectoryError):
            return frozenset()

    def part(self, step: str, key: str) -> Part | None:
        """Return the finished part, or None."""
        folder = self.data.joinpath(step, key)  # at once: snapshots ask for thousands
        try:
            with open(f"{folder}/part.json", "rb") as stream:  # noqa: PTH123 # likewise
                about = json.loads(stream.read())
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError) as problem:
            raise StorageError(
                f"{folder}: the part cannot be read ({problem}); `vtrack-batch repair` drops it"
            ) from None
        return Part(folder, about)

    @contextmanager
    def new_part(self, step: str, key: str, about: Mapping[str, Any]) -> Iterator[Path]:
        """Give an empty folder to fill; on leaving without an error it becomes the part, whole and durable."""
        draft = self.staging / f"{step}-{key[:16]}-{secrets.token_hex(4)}"
        try:
            draft.mkdir(parents=True)
            yield draft
            _seal(draft, about)
            target = self.data / step / key
            make_durable_folder(target.parent)
            try:
                draft.rename(target)
            except OSError:
                # made meanwhile by another worker: the same key is the same content
                if not (target / "part.json").is_file():
                    raise
            fsync(target.parent)
        except OSError as problem:
            raise StorageError(_not_written(draft.name, problem)) from None
        finally:
            shutil.rmtree(draft, ignore_errors=True)

    def drop_part(self, step: str, key: str) -> None:
        """Forget a part, so that it is computed again; it goes at once, so that none is ever seen half."""
        folder = self.data / step / key
        if folder.exists():
            doomed = self.staging / f"dropped-{secrets.token_hex(8)}"
            folder.rename(doomed)
            fsync(folder.parent)
            shutil.rmtree(doomed, ignore_errors=True)

    # snapshots -----------------------------------------------------------------------------------------------------

    def current_manifest(self) -> dict[str, Any] | None:
        """Return the manifest of the published snapshot, or None before the first."""
        path = self.current.resolve() / "manifest.json"
        try:
            status = path.stat()
            return dict(_manifest(path, status.st_ino, status.st_size, status.st_mtime_ns))
        except (OSError, ValueError):
            return None

    def publish(
        self, links: Mapping[str, str | Path], written: Mapping[str, str | bytes], manifest: Mapping[str, Any]
    ) -> Path:
        """Publish a snapshot: *links* (place in the snapshot → file of a part), *written* (place → content), manifest.

        Readers see the former snapshot or this one, whole.
        """
        number = 1 + max((int(path.name) for path in self.snapshots.iterdir() if path.name.isdigit()), default=0)
        draft = self.staging / f"snapshot-{number:06d}"
        target = self.snapshots / f"{number:06d}"
        try:
            _fill(draft, links, {**written, "manifest.json": _json({"snapshot": number, **manifest})})
            draft.rename(target)
            fsync(self.snapshots)
            self.lead_to(target.name)
            (self.state / "distrust").unlink(missing_ok=True)
        except OSError as problem:
            shutil.rmtree(draft, ignore_errors=True)
            raise StorageError(_not_written(f"{self.root}: the snapshot", problem)) from None
        return target

    def distrust(self) -> None:
        """Have the next run publish, even what seems to be published already."""
        (self.state / "distrust").touch()

    def is_distrusted(self) -> bool:
        """Return whether the published snapshot was found damaged."""
        return (self.state / "distrust").exists()

    def lead_to(self, snapshot: str) -> None:
        """Let `current` lead to *snapshot*, in one step."""
        pointer = self.root / f".current-{secrets.token_hex(4)}"
        pointer.symlink_to(Path("snapshots") / snapshot)
        pointer.replace(self.current)
        fsync(self.root)


@lru_cache(maxsize=1)
def _manifest(path: Path, *_: int) -> dict[str, Any]:
    """Return a manifest; that of ten years takes a while to read, and a run asks for it several times."""
    return dict(json.loads(path.read_bytes()))


def make_folder(folder: Path) -> None:
    """Make *folder* and what leads to it; raises ``CannotCreate`` where that is impossible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise CannotCreate(f"{folder}: cannot be created ({problem.strerror}); choose another folder") from None


def digest(*parts: Any) -> str:
    """Return the hash (32 hex digits) of *parts* written as canonical JSON: the key of what follows from them."""
    text = json.dumps(parts, sort_keys=True, ensure_ascii=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode("ascii")).hexdigest()[:32]


def described(path: Path) -> dict[str, Any]:
    """Return {sha256, bytes, rows} of a file; only tables have rows."""
    with path.open("rb") as stream:
        sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
    about: dict[str, Any] = {"sha256": sha256, "bytes": path.stat().st_size}
    if path.suffix == ".parquet":
        import pyarrow.parquet as pq

        about["rows"] = pq.read_metadata(path).num_rows
    return about


def _seal(draft: Path, about: Mapping[str, Any]) -> None:
    """Read back what was written, list it in part.json, and flush files and folders to the disk."""
    files = {str(path.relative_to(draft)): described(path) for path in sorted(draft.rglob("*")) if path.is_file()}
    write_durable(draft / "part.json", _json({**about, "files": files}))
    for name in files:
        fsync(draft / name)
    fsync_folders({str(path) for path in (draft, *((draft / name).parent for name in files))})


def _fill(draft: Path, links: Mapping[str, str | Path], written: Mapping[str, str | bytes]) -> None:
    """Lay out a snapshot: a name for every file, and a durable folder for every name."""
    folders = {"": str(draft)}  # as texts: a path object costs more than the folder or the link
    draft.mkdir()

    def made(folder: str) -> str:
        if folder not in folders:
            above, _, name = folder.rpartition("/")
            folders[folder] = f"{made(above)}/{name}"
            os.mkdir(folders[folder])  # noqa: PTH102
        return folders[folder]

    for place, source in links.items():
        folder, _, name = place.rpartition("/")
        link(source, f"{made(folder)}/{name}")
    for place, content in written.items():
        folder, _, name = place.rpartition("/")
        write_durable(Path(made(folder), name), content)
    fsync_folders(list(folders.values()))


def _json(value: Mapping[str, Any]) -> str:
    """Return *value* as JSON with one line an entry: fit to be compared, and written in one go, for there are many."""
    return json.dumps(value, sort_keys=True, ensure_ascii=False, separators=(",\n", ": ")) + "\n"


def _not_written(what: str, problem: OSError) -> str:
    return f"{what} cannot be written ({problem}); what was published before is intact, and a new run goes on from here"
