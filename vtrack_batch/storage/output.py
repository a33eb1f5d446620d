"""The layout of a result folder: the only file that knows it.

::

    OUT/current -> snapshots/000042        one atomic pointer
    OUT/snapshots/NNNNNN/<table>/date=YYYY-MM-DD/*.parquet, manifest.json, report/, ground/
    OUT/data/<step>/<key>/                 finished parts, never modified; part.json lists what is in them
    OUT/state/                             lock, staging, remembered hashes, what parts were made of

A *part* is the result of one step on one piece of work, named by the hash of all that went into it. Its folder is
filled under ``state/staging`` and renamed into ``data`` when it is whole: a part that exists is complete.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vtrack_batch.errors import Busy, CannotCreate, StorageError

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
        return dict(self.about["files"])


class Output:
    """A result folder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.data = root / "data"
        self.snapshots = root / "snapshots"
        self.state = root / "state"
        self.current = root / "current"

    def create(self) -> None:
        """Make the folders; raises ``CannotCreate`` where that is impossible."""
        try:
            for folder in (self.data, self.snapshots, self.state / "staging"):
                folder.mkdir(parents=True, exist_ok=True)
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
        """Hold the output against other runs; raises ``Busy`` that names the holder."""
        from filelock import FileLock, Timeout

        note = self.state / "holder.json"
        lock = FileLock(self.state / "lock")
        try:
            lock.acquire(timeout=wait_s)
        except Timeout:
            raise Busy(f"{self.root}: another run holds it ({_holder(note)}); wait with --wait SECONDS") from None
        try:
            note.write_text(json.dumps({"pid": os.getpid(), "host": os.uname().nodename}) + "\n")
            shutil.rmtree(self.state / "staging", ignore_errors=True)
            (self.state / "staging").mkdir(exist_ok=True)
            yield
        finally:
            note.unlink(missing_ok=True)
            lock.release()

    # parts ---------------------------------------------------------------------------------------------------------

    def part(self, step: str, key: str) -> Part | None:
        """Return the finished part, or None."""
        folder = self.data / step / key
        try:
            about = json.loads((folder / "part.json").read_bytes())
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError) as problem:
            raise StorageError(
                f"{folder}: the part cannot be read ({problem}); delete this folder and run again"
            ) from None
        return Part(folder, about)

    @contextmanager
    def new_part(self, step: str, key: str, about: Mapping[str, Any]) -> Iterator[Path]:
        """Give an empty folder to fill; on leaving without an error it becomes the part, whole and durable."""
        draft = self.state / "staging" / f"{step}-{key[:16]}-{secrets.token_hex(4)}"
        try:
            draft.mkdir(parents=True)
            yield draft
            files = {
                str(path.relative_to(draft)): described(path) for path in sorted(draft.rglob("*")) if path.is_file()
            }
            _write_durable(draft / "part.json", json.dumps({**about, "files": files}, sort_keys=True, indent=1) + "\n")
            for path in draft.rglob("*"):
                _fsync(path)
            target = self.data / step / key
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.exists():
                shutil.rmtree(draft)
            else:
                draft.rename(target)
            _fsync(target.parent)
        except OSError as problem:
            raise StorageError(f"{draft.name}: cannot be written ({problem}); the earlier results are intact") from None
        finally:
            shutil.rmtree(draft, ignore_errors=True)

    def drop_part(self, step: str, key: str) -> None:
        """Forget a part, so that it is computed again; it goes at once, so that none is ever seen half."""
        draft = self.state / "staging" / f"dropped-{secrets.token_hex(8)}"
        with suppress(FileNotFoundError):
            (self.data / step / key).rename(draft)
        shutil.rmtree(draft, ignore_errors=True)

    # snapshots -----------------------------------------------------------------------------------------------------

    def current_manifest(self) -> dict[str, Any] | None:
        """Return the manifest of the published snapshot, or None before the first."""
        try:
            return dict(json.loads((self.current.resolve() / "manifest.json").read_bytes()))
        except (OSError, ValueError):
            return None

    def publish(
        self, links: Mapping[str, Path], written: Mapping[str, str | bytes], manifest: Mapping[str, Any]
    ) -> Path:
        """Publish a snapshot: *links* (place in the snapshot → file of a part), *written* (place → content), manifest.

        Readers see the former snapshot or this one, whole.
        """
        number = 1 + max((int(path.name) for path in self.snapshots.iterdir() if path.name.isdigit()), default=0)
        draft = self.state / "staging" / f"snapshot-{number:06d}"
        target = self.snapshots / f"{number:06d}"
        try:
            shutil.rmtree(draft, ignore_errors=True)
            folders = {draft, *((draft / place).parent for place in (*links, *written))}
            for folder in sorted(folders):
                folder.mkdir(parents=True, exist_ok=True)
            for place, source in links.items():
                _link(source, draft / place)
            for place, content in written.items():
                _write_durable(draft / place, content)
            body = json.dumps({"snapshot": number, **manifest}, sort_keys=True, indent=1, ensure_ascii=False)
            _write_durable(draft / "manifest.json", body + "\n")
            for folder in sorted(folders):
                _fsync(folder)
            draft.rename(target)
            _fsync(self.snapshots)
            pointer = self.root / f".current-{secrets.token_hex(4)}"
            pointer.symlink_to(Path("snapshots") / target.name)
            pointer.replace(self.current)
            _fsync(self.root)
        except OSError as problem:
            raise StorageError(f"{self.root}: cannot publish ({problem}); the earlier results are intact") from None
        return target


def make_folder(folder: Path) -> None:
    """Make *folder* and what leads to it; raises ``CannotCreate`` where that is impossible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise CannotCreate(f"{folder}: cannot be created ({problem.strerror})") from None


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


def _holder(note: Path) -> str:
    try:
        about = json.loads(note.read_bytes())
        return f"process {about['pid']} on {about['host']}"
    except (OSError, ValueError, KeyError):
        return "holder unknown"


def _link(source: Path, place: Path) -> None:
    try:
        os.link(source, place)
    except OSError:
        with suppress(FileNotFoundError):
            place.unlink()
        shutil.copyfile(source, place)


def _write_durable(path: Path, content: str | bytes) -> None:
    data = content.encode() if isinstance(content, str) else content
    with path.open("wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())


def _fsync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
