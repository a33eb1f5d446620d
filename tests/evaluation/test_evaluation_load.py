"""Results and truths are found by their files, read whole, and refused in words."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from evaluation_worlds import START, result_of, table, trips, truth_of, world, write_result

from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.evaluation.evaluate import evaluate
from vtrack_batch.evaluation.load import load_result, load_truth


def write_tables_truth(folder: Path) -> Path:
    """The world as ``simulate`` writes its truth."""
    rows, truth = world(), truth_of(world())
    folder.mkdir(parents=True)
    columns = ("t_utc", "col_px", "row_px", "x_m", "y_m", "standing_s")
    seen = table("detections", len(rows), **{name: rows[name] for name in columns})
    seen = seen.assign(vehicle_id=rows["vehicle"], luminance=rows["luminance"])
    points = table("track_points", len(rows), vehicle_id=rows["vehicle"], t_utc=rows["t_utc"])
    points["speed_mps"] = rows["speed_mps"]
    for name, part in {"detections": seen, "track_points": points}.items():
        part.to_parquet(folder / f"{name}.parquet", index=False)
    for name in ("trajectories", "od_pairs", "turns"):
        getattr(truth, name).to_parquet(folder / f"{name}.parquet", index=False)
    return folder


def test_tables_of_a_simulation_are_a_truth_wherever_they_lie(tmp_path: Path) -> None:
    write_tables_truth(tmp_path / "demo" / "truth")
    expected = evaluate(result_of(world()), truth_of(world())).numbers
    for place in (tmp_path / "demo", tmp_path / "demo" / "truth", tmp_path / "demo" / "truth" / "detections.parquet"):
        assert evaluate(result_of(world()), load_truth(place)).numbers == expected


def test_parked_cars_lie_where_the_pose_of_each_frame_puts_them(tmp_path: Path) -> None:
    (tmp_path / "truth.csv").write_text(
        "frame,vehicle,col_px,row_px,speed_mps,standing_s,luminance\n0,7,50,60,3,0,90\n"
    )
    (tmp_path / "parked.csv").write_text("ref_col_px,ref_row_px\n100,40\n")
    names = ",".join(f"h{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
    (tmp_path / "poses.csv").write_text(f"frame,{names}\n0,1,0,0,0,1,0,0,0,1\n1,0,-2,200,2,0,10,0,0,1\n")
    truth = load_truth(tmp_path)
    assert truth.layout == "rendered"
    assert truth.parked.to_numpy().tolist() == [[0, 100, 40], [1, 120, 210]]
    assert truth.frames["frame"].tolist() == [0, 1]
    assert truth.frames["t_utc"].isna().all()


def test_boxes_become_centres_and_ignored_boxes_one_row_a_frame(tmp_path: Path) -> None:
    (tmp_path / "tracks.csv").write_text("frame,id,left,top,width,height,class\n1,4,10,20,8,30,car\n")
    (tmp_path / "vehicles.csv").write_text("id,frames,net_shift_px,motion\n4,1,90,mover\n")
    (tmp_path / "ignore.csv").write_text("frame_from,frame_to,left,top,width,height,what\n2,4,1,2,3,4,tram\n")
    (tmp_path / "times.csv").write_text("file,time\n001.png,2026-05-17T08:00:00.000Z\n")
    truth = load_truth(tmp_path)
    assert truth.layout == "kit"
    assert truth.sightings[["col_px", "row_px", "length_px"]].to_numpy().tolist() == [[13.5, 34.5, 30]]
    assert truth.ignore["frame"].tolist() == [2, 3, 4]
    assert truth.frames["t_utc"].tolist() == [START]


def test_a_folder_without_truth_is_refused_with_all_that_was_looked_for(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"detections\.parquet.*truth\.csv.*tracks\.csv"):
        load_truth(tmp_path)


def test_a_folder_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"not a result folder; looked for .*current"):
        load_result(tmp_path)


def test_a_snapshot_is_read_whole_and_by_itself(tmp_path: Path) -> None:
    result = result_of(world())
    out = write_result(result, tmp_path / "out")
    for place in (out, out / "snapshots" / "000001"):
        read = load_result(place)
        for name in ("frames", "detections", "track_points", "od_pairs"):
            whole, columns = getattr(result, name), list(getattr(read, name).columns)
            key = [c for c in ("vehicle_id", "detection_id", "frame_id", "origin", "bin_start_utc") if c in columns]
            again = getattr(read, name).sort_values(key).reset_index(drop=True)
            np.testing.assert_array_equal(
                again[key].to_numpy(), whole.sort_values(key)[key].reset_index(drop=True).to_numpy()
            )


def test_missing_optional_tables_are_empty(tmp_path: Path) -> None:
    out = write_result(result_of(world(), ends=trips().iloc[:0]), tmp_path / "out")
    for name in ("od_pairs", "turns", "quarantine", "trajectories"):
        shutil.rmtree(out / "current" / name)
    assert evaluate(load_result(out), truth_of(world())).numbers["od"]["error"]["value"] == 1


def test_a_broken_file_and_a_missing_column_are_named(tmp_path: Path) -> None:
    out = write_result(result_of(world()), tmp_path / "out")
    part = out / "current" / "detections" / "date=2026-05-17" / "part.parquet"
    pd.read_parquet(part).drop(columns="col_px").to_parquet(part)
    with pytest.raises(UnusableData, match=r"part\.parquet: columns missing: col_px"):
        load_result(out)
    part.write_bytes(b"PAR1 is not enough")
    with pytest.raises(UnusableData, match=r"part\.parquet: cannot be read"):
        load_result(out)
    (tmp_path / "truth").mkdir()
    for name in ("truth", "parked", "poses"):
        (tmp_path / "truth" / f"{name}.csv").write_text("frame,vehicle\n")
    with pytest.raises(UnusableData, match=r"truth\.csv: columns missing: col_px"):
        load_truth(tmp_path)


def test_an_unknown_vehicle_in_the_boxes_is_named(tmp_path: Path) -> None:
    (tmp_path / "tracks.csv").write_text("frame,id,left,top,width,height,class\n1,4,10,20,8,30,car\n")
    (tmp_path / "vehicles.csv").write_text("id,motion\n5,mover\n")
    with pytest.raises(UnusableData, match="no motion is given for id 4"):
        load_truth(tmp_path)
