"""Reading and writing the tables of a part."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import StorageError
from vtrack_batch.model.homography import Array
from vtrack_batch.model.tables import TABLES
from vtrack_batch.pipeline.hand import Hand
from vtrack_batch.pipeline.plan import FrameRef, Piece
from vtrack_batch.storage.output import Output, Part
from vtrack_batch.storage.parquet import read_table, write_table


@dataclass(frozen=True)
class Context:
    """What every step of a run shares."""

    survey: Survey
    archive: Path
    out: Path
    zones_text: str | None
    hand: Hand | None = None
    """Of a worker that may die: what it has in hand."""

    @cached_property
    def output(self) -> Output:
        """The result folder."""
        return Output(self.out)

    def part(self, piece: Piece) -> Part:
        """Return the finished part of *piece*."""
        part = self.output.part(piece.step, piece.key)
        if part is None:
            raise StorageError(f"{piece.step} {piece.name}: its result vanished during the run; run again")
        return part

    @contextmanager
    def new_part(self, piece: Piece, about: dict[str, Any]) -> Iterator[Path]:
        """Give an empty folder to fill; on leaving it becomes the part of *piece*, and *about* what is known of it."""
        about |= {"name": piece.name, "made_of": dict(piece.ingredients), "needs": [need.key for need in piece.needs]}
        with self.output.new_part(piece.step, piece.key, about) as folder:
            yield folder

    def take(self, ref: FrameRef) -> None:
        """Note that a frame is about to be read: should it be the end of this worker, it is known which it was."""
        if self.hand is not None:
            self.hand.take(ref.path)


def read(parts: Iterable[Part], name: str, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """Return the rows of the table *name* over *parts*, all columns unless some are named."""
    return read_table([part.file(f"{name}.parquet") for part in parts], TABLES[name], columns)


def write(folder: Path, tables: Mapping[str, pd.DataFrame], crs: str | None = None) -> None:
    """Write *tables* into the folder of a part, checked against their declarations."""
    for name, rows in tables.items():
        write_table(folder / f"{name}.parquet", TABLES[name], rows, crs)


def matrix_columns(letter: str, matrices: Array) -> dict[str, Array]:
    """Return the columns h11…h33 of matrices (n, 3, 3)."""
    flat = np.asarray(matrices, float).reshape(-1, 9)
    return {f"{letter}{i + 1}{j + 1}": flat[:, 3 * i + j] for i in range(3) for j in range(3)}


def matrices_of(letter: str, rows: pd.DataFrame) -> Array:
    """Return the matrices (n, 3, 3) kept in the columns h11…h33."""
    names = [f"{letter}{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]
    return rows[names].to_numpy(float).reshape(-1, 3, 3)
