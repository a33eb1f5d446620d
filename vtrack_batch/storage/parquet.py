"""Declared tables to Parquet and back: one schema, checked before anything is written."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from vtrack_batch.model.tables import Column, Table

ROW_GROUP_ROWS = 262_144
AS_FILE: dict[str, Any] = {"compression": "zstd", "compression_level": 3, "write_page_checksum": True}

_ARROW: dict[str, pa.DataType] = {
    "text": pa.string(),
    "category": pa.dictionary(pa.int32(), pa.string()),
    "int32": pa.int32(),
    "int64": pa.int64(),
    "float64": pa.float64(),
    "bool": pa.bool_(),
    "time": pa.timestamp("us", "UTC"),
    "geometry": pa.binary(),
}


class BrokenTable(ValueError):
    """A chapter broke the promise of a declared table: a bug, never a user's mistake."""


def arrow_schema(table: Table, crs: str | None = None) -> pa.Schema:
    """Return the Arrow schema of *table*: units and meanings as field metadata; GeoParquet 1.1 if it has geometry."""
    fields = [
        pa.field(c.name, _ARROW[c.type], c.nullable, {"unit": c.unit, "description": c.meaning}) for c in table.columns
    ]
    metadata = {"vtrack.schema": f"{table.name}/{table.version}", "vtrack.crs": crs or ""}
    geometry = [c.name for c in table.columns if c.type == "geometry"]
    if geometry:
        metadata["geo"] = _geo_metadata(geometry[0], crs)
    return pa.schema(fields, metadata)


def to_arrow(table: Table, rows: pd.DataFrame, crs: str | None = None) -> pa.Table:
    """Return *rows* as an Arrow table of the declared schema, sorted, checked.

    Raises ``BrokenTable`` for missing columns, nulls or infinities where none may be, and doubled keys.
    """
    made = to_plain(table, rows)
    # encoded after sorting, so that the dictionaries' order does not tell in which order rows were given
    coded = {name: made[name].combine_chunks().dictionary_encode().dictionary for name in categories(table)}
    return encoded(table, made, coded, crs)


def to_plain(table: Table, rows: pd.DataFrame) -> pa.Table:
    """Return *rows* sorted and checked as ``to_arrow`` does, categories as text."""
    missing = set(table.column_names) - set(rows.columns)
    if missing:
        raise BrokenTable(f"{table.name}: columns missing: {sorted(missing)}")
    made = pa.table([_array(table, column, rows[column.name]) for column in table.columns], names=table.column_names)
    made = in_order(table, made)
    _refuse_doubles(table, made)
    return made


def in_order(table: Table, made: pa.Table) -> pa.Table:
    """Return rows of *table* sorted by its key, by time first where the key has none."""
    return made.take(pc.sort_indices(made, [(name, "ascending") for name in order_of(table)])).combine_chunks()


def categories(table: Table) -> list[str]:
    """Return the names of the columns that are kept as codes."""
    return [column.name for column in table.columns if column.type == "category"]


def encoded(table: Table, made: pa.Table, values: Mapping[str, pa.Array], crs: str | None = None) -> pa.Table:
    """Return sorted rows in the declared schema; *values* holds for every category its values in order of codes."""

    def coded(name: str) -> pa.Array:
        codes = pc.index_in(made[name].combine_chunks(), value_set=values[name])
        return pa.DictionaryArray.from_arrays(codes, values[name])

    columns = [coded(c.name) if c.type == "category" else made[c.name] for c in table.columns]
    return pa.table(columns, schema=arrow_schema(table, crs)).combine_chunks()


def write_table(path: Path, table: Table, rows: pd.DataFrame | pa.Table, crs: str | None = None) -> int:
    """Write *rows* to *path* as the declared table; returns the number of rows. Same rows give the same bytes."""
    made = rows if isinstance(rows, pa.Table) else to_arrow(table, rows, crs)
    pq.write_table(made, path, row_group_size=ROW_GROUP_ROWS, **AS_FILE)
    return int(made.num_rows)


def read_table(paths: Sequence[Path], table: Table, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """Read files of one declared table into one DataFrame; no file gives an empty one with all columns."""
    names = list(columns or table.column_names)
    parts = [pq.ParquetFile(path, page_checksum_verification=True).read(names) for path in paths]
    if not parts:
        return empty_frame(table)[names]
    whole = pa.concat_tables([part.replace_schema_metadata(None) for part in parts], promote_options="permissive")
    return pd.DataFrame(whole.to_pandas())


def empty_frame(table: Table) -> pd.DataFrame:
    """Return the table without rows."""
    return pd.DataFrame(arrow_schema(table).empty_table().to_pandas())


def order_of(table: Table) -> list[str]:
    """Return the columns by which rows are sorted: the key, led by the first time column unless the key has one."""
    times = [column.name for column in table.columns if column.type == "time"]
    lead = times[:1] if times and not set(times) & set(table.key) else []
    return [*lead, *table.key]


def _array(table: Table, column: Column, values: pd.Series) -> pa.Array:
    plain = pa.string() if column.type == "category" else _ARROW[column.type]
    if column.type == "category" and isinstance(values.dtype, pd.CategoricalDtype):
        values = values.astype(object)
    array = pa.Array.from_pandas(values, type=plain)
    if isinstance(array, pa.ChunkedArray):
        array = array.combine_chunks()
    if array.null_count and not column.nullable:
        raise BrokenTable(f"{table.name}.{column.name}: {array.null_count} nulls in a column that has none")
    if column.type == "float64" and not np.isfinite(array.drop_null().to_numpy(zero_copy_only=False)).all():
        raise BrokenTable(f"{table.name}.{column.name}: holds an infinite value")
    return array


def _refuse_doubles(table: Table, made: pa.Table) -> None:
    if made.num_rows > 1 and made.group_by(list(table.key)).aggregate([]).num_rows != made.num_rows:
        raise BrokenTable(f"{table.name}: the key {table.key} is not unique")


def _geo_metadata(column: str, crs: str | None) -> str:
    described: dict[str, Any] = {"encoding": "WKB", "geometry_types": ["LineString"], "crs": None}
    if crs:
        from pyproj import CRS

        described["crs"] = CRS.from_user_input(crs).to_json_dict()
    geo = {"version": "1.1.0", "primary_column": column, "columns": {column: described}}
    return json.dumps(geo, sort_keys=True)
