"""What the last complete run had before it: enough to tell in a moment, looking into no file, that nothing is new.

The record is a short cut, never a truth: lost, or of another version, the archive is indexed and planned as ever. This
module loads nothing slow.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from vtrack_batch import __version__
from vtrack_batch.storage.durable import replace_durable
from vtrack_batch.storage.output import Output

_NAME = "record.json"


@dataclass(frozen=True)
class Record:
    """A complete run's inputs, as fingerprints, and its outcome."""

    settings: str
    """Of the survey's parameters and of the files that they name."""
    listing: str | None
    """Of the names, sizes and times of the archive's files; None where one was too young to be trusted."""
    snapshot: str
    frames: int
    set_aside: int
    parts: Mapping[str, list[str]]
    """Step → keys of its parts."""
    archive: str
    settle_s: float
    named_files: Mapping[str, str | None]
    """Path → hash of the files that the survey names."""
    survey_file: str | None
    """Hash of the survey file itself, by which `status` knows it without reading what it says."""
    version: str = __version__

    def results_stand(self, output: Output) -> bool:
        """Return whether *output* still holds all parts, and publishes what was published."""
        snapshot = output.current.resolve()
        if snapshot.name != self.snapshot or not (snapshot / "manifest.json").is_file():
            return False
        return all(output.keys(step).issuperset(keys) for step, keys in self.parts.items())


def read_record(output: Output) -> Record | None:
    """Return the record of the last complete run, None if there is none that this version can read."""
    try:
        about = json.loads((output.state / _NAME).read_bytes())
        return Record(**about) if about["version"] == __version__ else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_record(output: Output, record: Record) -> None:
    """Replace the record."""
    replace_durable(output.state / _NAME, json.dumps(asdict(record), sort_keys=True) + "\n")


def drop_record(output: Output) -> None:
    """Forget the last complete run, so that the next one looks at everything."""
    (output.state / _NAME).unlink(missing_ok=True)


def file_hash(path: Path) -> str | None:
    """Return the hash of a small file, None if it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None
