"""``track_file`` reads part by part and writes what ``track`` finds in memory, byte for byte, however rows lie."""

import numpy as np
import pandas as pd
import pytest

from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.model.tables import TABLES
from vtrack_batch.pipeline import stream
from vtrack_batch.pipeline.tables import track_file
from vtrack_batch.storage.parquet import write_table
from vtrack_batch.tracking import track as tracking
from vtrack_batch.tracking.params import TrackingParams, WindowParams

SMALL = TrackingParams(windows=WindowParams(window_sightings=1000, context_frames=12))


def drive(frames=140, vehicles=24, seed=0):
    """Vehicles one behind another on two lanes of an oblong place, 10 % missed, at times that are no round seconds."""
    rng = np.random.default_rng(seed)
    vehicle, frame = (grid.ravel() for grid in np.meshgrid(np.arange(vehicles), np.arange(frames)))
    start, speed = rng.uniform(0, 900, vehicles), rng.uniform(8, 14, vehicles)
    t_s = np.cumsum(rng.choice([1.4, 1.5, 1.6], frames)).round(6)[frame]
    table = pd.DataFrame(
        {"x_m": (start[vehicle] + speed[vehicle] * t_s) % 1000, "y_m": 3.5 * (vehicle % 2) + 0.0 * t_s}
    )
    table[["x_m", "y_m"]] += rng.normal(0, 0.3, (len(table), 2))
    table[["red", "green", "blue"]] = np.clip(rng.uniform(20, 235, (vehicles, 3))[vehicle], 0, 255)
    table["t_utc"] = pd.Timestamp("2026-05-17T06:00:00.25Z") + pd.to_timedelta(t_s, unit="s")
    table["sequence"] = np.where(frame < 90, "morning", "evening")
    table = table[rng.random(len(table)) > 0.1].reset_index(drop=True)
    return table.assign(detection_id=rng.permutation(len(table)))


@pytest.fixture
def little_windows(monkeypatch):
    monkeypatch.setattr(stream, "RUN_SIGHTINGS", 150)
    monkeypatch.setattr("vtrack_batch.pipeline.tables.TrackingParams", lambda: SMALL)


@pytest.mark.parametrize("rows", ["in order of time", "shuffled"])
def test_the_bytes_are_those_of_the_whole(tmp_path, little_windows, rows):
    table = drive().sort_values("t_utc")
    table = table if rows == "in order of time" else table.sample(frac=1, random_state=3)
    table.to_parquet(tmp_path / "detections.parquet", row_group_size=400, index=False)
    made = track_file(tmp_path / "detections.parquet", tmp_path / "out", method="nearest")
    texts = table.assign(detection_id=table["detection_id"].astype("string"))
    whole = tracking.track(texts, method="nearest", params=SMALL)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(f"{name}.parquet" for name in made)
    for name, count in made.items():
        write_table(tmp_path / "whole.parquet", TABLES[name], getattr(whole, name))
        assert count == len(getattr(whole, name)) > 20
        assert (tmp_path / "out" / f"{name}.parquet").read_bytes() == (tmp_path / "whole.parquet").read_bytes()


def test_csv_and_parquet_give_the_same_tracks(tmp_path):
    table = drive(frames=12, vehicles=8).assign(detection_id=lambda t: "d" + t["detection_id"].astype(str))
    table.to_csv(tmp_path / "a.csv", index=False)
    pd.read_csv(tmp_path / "a.csv", parse_dates=["t_utc"]).to_parquet(tmp_path / "a.parquet", row_group_size=20)
    for kind in ("csv", "parquet"):
        track_file(tmp_path / f"a.{kind}", tmp_path / kind, method="nearest")
    for name in ("trajectories", "matches", "track_points"):
        one, two = ((tmp_path / kind / f"{name}.parquet").read_bytes() for kind in ("csv", "parquet"))
        assert one == two


def test_no_detections_give_empty_tables(tmp_path):
    drive().head(0).to_parquet(tmp_path / "none.parquet")
    assert set(track_file(tmp_path / "none.parquet", tmp_path / "out").values()) == {0}


def test_an_id_that_comes_again_in_another_part_is_told(tmp_path):
    table = drive(frames=20, vehicles=10)
    table.loc[len(table) - 1, "detection_id"] = table["detection_id"].iloc[0]
    table.to_parquet(tmp_path / "twice.parquet", row_group_size=50)
    with pytest.raises(UnusableData, match="detection_id is repeated in 1 rows"):
        track_file(tmp_path / "twice.parquet", tmp_path / "out")


def test_what_cannot_be_read_is_told(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        track_file(tmp_path / "nothing.parquet", tmp_path / "out")
    (tmp_path / "text.parquet").write_text("no table")
    with pytest.raises(UnusableData, match="not a Parquet table"):
        track_file(tmp_path / "text.parquet", tmp_path / "out")
    drive(frames=3).to_parquet(tmp_path / "good.parquet")
    with pytest.raises(ConfigError, match="unknown"):
        track_file(tmp_path / "good.parquet", tmp_path / "out", method="magic")
