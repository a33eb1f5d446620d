"""Every declared table is written with its schema and read back by the tools that planners use."""

from __future__ import annotations

from pathlib import Path

import duckdb
import geopandas
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import shapely

from vtrack_batch.model.tables import TABLES, Column, Table
from vtrack_batch.storage.parquet import BrokenTable, arrow_schema, empty_frame, read_table, to_arrow, write_table

ROWS = 3


def values(column: Column, table: Table) -> list[object]:
    unique = column.name in table.key
    made: dict[str, list[object]] = {
        "text": [f"{column.name}-{i}" if unique else "same" for i in range(ROWS)],
        "category": [f"c{i}" for i in range(ROWS)],
        "int32": list(range(ROWS)),
        "int64": list(range(ROWS)),
        "float64": [0.5 + i for i in range(ROWS)],
        "bool": [True, False, True],
        "time": [pd.Timestamp("2026-05-17T06:00:00.250Z") + pd.Timedelta(seconds=i) for i in range(ROWS)],
        "geometry": [shapely.to_wkb(shapely.LineString([(0, 0), (3 + i, 1)])) for i in range(ROWS)],
    }
    chosen = made[column.type]
    if column.nullable and column.name not in table.key:
        chosen[1] = None
    return chosen


def example(table: Table) -> pd.DataFrame:
    columns = {c.name: values(c, table) for c in table.columns}
    frame = pd.DataFrame({name: pd.Series(v, dtype=object) for name, v in columns.items()})
    for c in table.columns:
        if c.type == "time":
            frame[c.name] = pd.to_datetime(frame[c.name], utc=True)
        elif c.type == "float64":
            frame[c.name] = frame[c.name].astype(float)
    return frame


@pytest.fixture(params=list(TABLES), ids=list(TABLES))
def table(request: pytest.FixtureRequest) -> Table:
    return TABLES[request.param]


def place_of(table: Table, folder: Path) -> Path:
    where = folder / table.name / "date=2026-05-17" if table.partitioned else folder / table.name
    where.mkdir(parents=True)
    return where / "a.parquet"


def test_each_table_is_read_by_all_readers(table: Table, tmp_path: Path) -> None:
    path = place_of(table, tmp_path)
    assert write_table(path, table, example(table), "EPSG:32654") == ROWS
    folder = tmp_path / table.name
    names = list(table.column_names)
    pandas_rows = pd.read_parquet(folder)
    assert list(pandas_rows.columns)[: len(names)] == names
    assert len(pandas_rows) == ROWS
    assert pl.read_parquet(folder / "**/*.parquet").height == ROWS
    assert duckdb.sql(f"select count(*) from '{folder}/**/*.parquet'").fetchall() == [(ROWS,)]
    assert len(duckdb.sql(f"select {', '.join(names)} from '{folder}/**/*.parquet'").df()) == ROWS
    assert pq.read_table(folder).num_rows == ROWS
    if any(c.type == "geometry" for c in table.columns):
        shapes = geopandas.read_parquet(path)
        assert shapes.crs.to_epsg() == 32654
        assert shapes.geometry.iloc[0].length == pytest.approx(np.hypot(3, 1))


def test_units_and_meanings_travel_with_the_file(table: Table, tmp_path: Path) -> None:
    path = place_of(table, tmp_path)
    write_table(path, table, example(table))
    schema = pq.read_schema(path)
    assert schema.metadata[b"vtrack.schema"] == f"{table.name}/{table.version}".encode()
    for column in table.columns:
        assert schema.field(column.name).metadata[b"unit"] == column.unit.encode()
        assert schema.field(column.name).nullable == column.nullable


def test_the_order_of_rows_given_does_not_show(table: Table, tmp_path: Path) -> None:
    rows = example(table)
    write_table(tmp_path / "a.parquet", table, rows)
    write_table(tmp_path / "b.parquet", table, rows.iloc[::-1].reset_index(drop=True))
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()


def test_an_empty_table_keeps_its_schema(table: Table, tmp_path: Path) -> None:
    write_table(tmp_path / "a.parquet", table, empty_frame(table))
    assert pq.read_schema(tmp_path / "a.parquet").equals(arrow_schema(table))
    assert list(read_table([tmp_path / "a.parquet"], table).columns) == list(table.column_names)
    assert list(read_table([], table).columns) == list(table.column_names)


def test_nulls_where_none_may_be_are_refused(table: Table) -> None:
    rows = example(table)
    column = next(c for c in table.columns if not c.nullable)
    rows[column.name] = rows[column.name].astype(object)
    rows.loc[0, column.name] = None
    with pytest.raises(BrokenTable, match=column.name):
        to_arrow(table, rows)


def test_doubled_keys_are_refused(table: Table) -> None:
    with pytest.raises(BrokenTable, match="not unique"):
        to_arrow(table, pd.concat([example(table), example(table)], ignore_index=True))


def test_infinities_and_missing_columns_are_refused() -> None:
    table = TABLES["detections"]
    with pytest.raises(BrokenTable, match="infinite"):
        to_arrow(table, example(table).assign(x_m=np.inf))
    with pytest.raises(BrokenTable, match="x_m"):
        to_arrow(table, example(table).drop(columns="x_m"))


def test_nan_in_a_nullable_column_becomes_null() -> None:
    table = TABLES["speeds"]
    made = to_arrow(table, example(table).assign(p15_mps=np.nan))
    assert made["p15_mps"].null_count == ROWS
    assert made["p15_mps"].type == pa.float64()
