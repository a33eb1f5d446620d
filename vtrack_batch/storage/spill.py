"""Tables larger than memory: read in row groups, collected in parts, written sorted as if they had been whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from vtrack_batch.model.tables import Table
from vtrack_batch.storage.parquet import (
    AS_FILE,
    ROW_GROUP_ROWS,
    BrokenTable,
    arrow_schema,
    categories,
    empty_frame,
    encoded,
    in_order,
    order_of,
    to_plain,
)

PART_GROUP_ROWS = 16_384
MERGED_ROWS = 2 * ROW_GROUP_ROWS  # about so many rows are sorted at once
SAMPLE = 512  # of so many rows one tells how keys are spread


def row_groups(path: Path) -> list[Callable[[], pd.DataFrame]]:
    """Return for every row group of a Parquet file, anybody's, what reads it."""

    def reader(number: int) -> Callable[[], pd.DataFrame]:
        return lambda: pd.DataFrame(pq.ParquetFile(path).read_row_group(number).to_pandas())

    count = pq.ParquetFile(path).num_row_groups
    return [reader(number) for number in range(count)] or [lambda: pd.DataFrame(pq.read_table(path).to_pandas())]


class Spill:
    """Rows of a declared table that come in parts, in any order; each part is written to *folder* at once."""

    def __init__(self, table: Table, folder: Path) -> None:
        self._table, self._folder = table, folder
        self._rows: list[int] = []
        self._keys: list[pa.Array] = []
        self._first: dict[str, dict[str, tuple[object, ...]]] = {name: {} for name in categories(table)}
        folder.mkdir(parents=True)

    def add(self, rows: pd.DataFrame) -> None:
        """Take *rows*; what is no such table raises ``BrokenTable``."""
        made = to_plain(self._table, rows)
        if not made.num_rows and self._rows:
            return
        order = order_of(self._table)
        self._keys.append(made[order[0]].combine_chunks().take(pa.array(np.arange(0, made.num_rows, SAMPLE))))
        for name, first in self._first.items():
            values = made[name].combine_chunks()
            for value in values.unique().drop_null().to_pylist():
                at = pc.index(values, value).as_py()
                key = tuple(made[column][at].as_py() for column in order)
                first[value] = min(key, first.get(value, key))
        path = self._folder / f"{len(self._rows):06}.parquet"
        pq.write_table(made, path, row_group_size=PART_GROUP_ROWS, compression="zstd", compression_level=1)
        self._rows.append(made.num_rows)

    def write(self, path: Path, crs: str | None = None) -> int:
        """Write all rows to *path*, sorted, the bytes that ``write_table`` makes of them; returns their number."""
        if not self._rows:
            self.add(empty_frame(self._table))
        values = {
            name: pa.array(sorted(first, key=first.__getitem__), pa.string()) for name, first in self._first.items()
        }
        total = 0
        with pq.ParquetWriter(path, arrow_schema(self._table, crs), **AS_FILE) as writer:
            for rows in _regrouped(self._merged()):
                writer.write_table(encoded(self._table, rows, values, crs), row_group_size=ROW_GROUP_ROWS)
                total += rows.num_rows
        return total

    def _merged(self) -> Iterator[pa.Table]:
        """Yield all rows in order of the first column that sorts them: every time those between two of its values."""
        lead, last = order_of(self._table)[0], None
        parts = [self._folder / f"{number:06}.parquet" for number in range(len(self._rows))]
        for below in [*self._cuts(), None]:
            limits = [(lead, ">=", last)] if last is not None else []
            limits += [(lead, "<", below)] if below is not None else []
            rows = pa.concat_tables([pq.read_table(part, filters=limits or None) for part in parts])
            rows = in_order(self._table, rows)
            if rows.num_rows > 1 and rows.group_by(list(self._table.key)).aggregate([]).num_rows != rows.num_rows:
                raise BrokenTable(f"{self._table.name}: the key {self._table.key} is not unique")
            yield rows
            last = below

    def _cuts(self) -> list[object]:
        """Return values of the first sorting column that part the rows into lots of about ``MERGED_ROWS``."""
        lots = -(-sum(self._rows) // MERGED_ROWS)
        if lots < 2:
            return []
        keys = pa.concat_arrays(self._keys)
        keys = keys.take(pc.sort_indices(keys))
        at = np.arange(1, lots) * len(keys) // lots
        return list(keys.take(pa.array(at)).unique().to_pylist())


def _regrouped(parts: Iterator[pa.Table]) -> Iterator[pa.Table]:
    """Yield the same rows in whole row groups; the last may be short, and there is always one."""
    held: pa.Table | None = None
    for part in parts:
        held = part if held is None else pa.concat_tables([held, part]).combine_chunks()
        while held.num_rows > ROW_GROUP_ROWS:
            yield held.slice(0, ROW_GROUP_ROWS).combine_chunks()
            held = held.slice(ROW_GROUP_ROWS)
    if held is not None:
        yield held.combine_chunks()
