"""Tables in parts, larger than a row group: written sorted, byte for byte as if they had been whole."""

import numpy as np
import pandas as pd
import pytest

from vtrack_batch.model.tables import TABLES
from vtrack_batch.storage import spill
from vtrack_batch.storage.parquet import BrokenTable, write_table
from vtrack_batch.storage.spill import Spill, row_groups

POINTS = TABLES["track_points"]


def points(count, seed=0):
    rng = np.random.default_rng(seed)
    numbers = rng.normal(0, 1, (count, 8))
    table = pd.DataFrame(
        numbers, columns=["x_m", "y_m", "vx_mps", "vy_mps", "speed_mps", "speed_sigma_mps", "accel_mps2", "heading_deg"]
    )
    frame = np.arange(count) % 50
    table["vehicle_id"] = [f"v-{n}" for n in rng.permutation(count // 50 + 1)[np.arange(count) // 50]]
    table["t_utc"] = pd.Timestamp("2026-05-17T00:00:00Z") + pd.to_timedelta(frame * 1.5, unit="s")
    table["detection_id"] = pd.array(np.where(rng.random(count) < 0.1, None, np.arange(count).astype(str)), "string")
    table["state"] = rng.choice(["moving", "stopped", "parked"], count)
    return table


@pytest.mark.parametrize(("count", "parts"), [(0, 1), (1, 1), (700, 1), (5000, 7)])
def test_parts_are_written_as_the_whole(tmp_path, monkeypatch, count, parts):
    monkeypatch.setattr(spill, "ROW_GROUP_ROWS", 512)
    monkeypatch.setattr("vtrack_batch.storage.parquet.ROW_GROUP_ROWS", 512)
    monkeypatch.setattr(spill, "MERGED_ROWS", 700)
    monkeypatch.setattr(spill, "SAMPLE", 16)
    table = points(count)
    write_table(tmp_path / "whole.parquet", POINTS, table)
    made = Spill(POINTS, tmp_path / "parts")
    for part in np.array_split(np.random.default_rng(1).permutation(count), parts):
        made.add(table.iloc[part])
    assert made.write(tmp_path / "again.parquet") == count
    assert (tmp_path / "again.parquet").read_bytes() == (tmp_path / "whole.parquet").read_bytes()


def test_a_key_that_comes_in_two_parts_is_refused(tmp_path):
    made = Spill(POINTS, tmp_path / "parts")
    made.add(points(20))
    made.add(points(20))
    with pytest.raises(BrokenTable, match="not unique"):
        made.write(tmp_path / "made.parquet")


def test_row_groups_are_read_one_by_one(tmp_path):
    table = pd.DataFrame({"x_m": np.arange(25.0)})
    table.to_parquet(tmp_path / "a.parquet", row_group_size=10)
    groups = [read() for read in row_groups(tmp_path / "a.parquet")]
    assert [len(group) for group in groups] == [10, 10, 5]
    pd.testing.assert_frame_equal(pd.concat(groups, ignore_index=True), table)
    table.head(0).to_parquet(tmp_path / "none.parquet")
    assert [len(read()) for read in row_groups(tmp_path / "none.parquet")] == [0]
