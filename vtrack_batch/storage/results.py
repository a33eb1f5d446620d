"""Open a published snapshot for readers."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from vtrack_batch.errors import ConfigError, NoArchive
from vtrack_batch.model.tables import TABLES
from vtrack_batch.storage.parquet import read_table


class Results(Mapping[str, pd.DataFrame]):
    """The tables of one whole snapshot, read when asked for: ``results["od_pairs"]`` is a DataFrame."""

    def __init__(self, snapshot: Path) -> None:
        self.snapshot = snapshot
        self.manifest: dict[str, Any] = json.loads((snapshot / "manifest.json").read_bytes())

    def __getitem__(self, name: str) -> pd.DataFrame:
        if name not in TABLES:
            raise KeyError(name)
        return read_table(self.files(name), TABLES[name])

    def __iter__(self) -> Iterator[str]:
        return iter(TABLES)

    def __len__(self) -> int:
        return len(TABLES)

    def files(self, name: str) -> list[Path]:
        """Return the Parquet files of the table *name*, in order of date."""
        return sorted((self.snapshot / name).rglob("*.parquet"))


def open_results(out: str | Path) -> Results:
    """Open the newest published snapshot of the result folder *out*; it stays whole while a later one is published.

    Raises ``NoArchive`` when nothing is published there.
    """
    out = Path(out)
    snapshot = (out / "current").resolve()
    if not (snapshot / "manifest.json").is_file():
        raise NoArchive(f"{out}: no published results here; `vtrack-batch run SURVEY.yaml` makes them")
    return Results(snapshot)


def only_table(name: str) -> None:
    """Raise ``ConfigError`` with suggestions unless *name* is a declared table."""
    if name not in TABLES:
        raise ConfigError(f"no table {name!r}; there are: {', '.join(TABLES)}")
