"""Truths of others are read in their own layouts, and tables of others as results; each against itself is perfect."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from evaluation_worlds import START, STEP_S, result_of, table, trips, world, write_result

from vtrack_batch.cli.evaluate import command
from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.evaluation.evaluate import evaluate
from vtrack_batch.evaluation.load import load_result, load_truth


def value(numbers: dict, path: str) -> float | None:
    for name in path.split("."):
        numbers = numbers[name]
    return numbers["value"]


def boxes(rows: pd.DataFrame, first_frame: int, first_pixel: int) -> pd.DataFrame:
    """The world as boxes of 14 x 6 px: frame, id, left, top, width, height."""
    number = pd.factorize(rows["vehicle"], sort=True)[0]
    corner = {"left": rows["col_px"] + 0.5 - 7 + first_pixel, "top": rows["row_px"] + 0.5 - 3 + first_pixel}
    return pd.DataFrame({"frame": rows["frame"] + first_frame, "id": number, **corner, "width": 14.0, "height": 6.0})


def test_mot_challenge_counts_frames_and_pixels_from_one_and_flags_what_to_ignore(tmp_path: Path) -> None:
    rows = boxes(world(), 1, 1).assign(flag=1, kind=1, visibility=1.0)
    stray = rows.iloc[:1].assign(id=99, left=500.0, top=650.0, flag=0)
    (tmp_path / "gt").mkdir()
    pd.concat([rows, stray]).to_csv(tmp_path / "gt" / "gt.txt", header=False, index=False)
    truth = load_truth(tmp_path)
    assert truth.layout == "mot"
    again, was = (rows.sort_values(["frame", "row_px"])["col_px"].to_numpy() for rows in (truth.sightings, world()))
    assert again == pytest.approx(was)
    assert set(truth.sightings["length_px"]) == {14.0}
    assert truth.ignore.to_numpy().tolist() == [[1, 499.0, 649.0, 14.0, 6.0]]
    result = result_of(world().assign(frame=world()["frame"]))
    numbered = replace(result, frames=result.frames.assign(path=[f"img1/{n + 1:06d}.jpg" for n in range(40)]))
    numbers = evaluate(numbered, truth).numbers
    assert value(numbers, "detection.detections.f1") == value(numbers, "tracks.hota") == 1
    assert value(numbers, "detection.detections.centroid_error_rms_px") == pytest.approx(0, abs=1e-9)
    assert numbers["speeds"] is numbers["od"] is None


def test_boxes_without_a_head_line_count_from_nought_and_a_tracker_may_write_them_too(tmp_path: Path) -> None:
    rows = boxes(world(), 0, 0)
    rows.assign(a=1, b=1, c=1, d=-1).to_csv(tmp_path / "tracks.csv", header=False, index=False)
    dropped = rows.drop(index=rows.sample(71, random_state=2).index)
    dropped.sample(frac=1, random_state=3).to_csv(tmp_path / "mine.txt", header=False, index=False)
    numbers = evaluate(load_result(tmp_path / "mine.txt"), load_truth(tmp_path / "tracks.csv")).numbers
    kept = len(dropped) / len(rows)
    assert numbers["layout"] == "boxes"
    assert value(numbers, "detection.detections.recall") == pytest.approx(kept, abs=1e-12)
    assert value(numbers, "tracks.mota") == pytest.approx(kept, abs=1e-12)
    assert value(numbers, "tracks.idf1") == pytest.approx(2 * kept / (1 + kept), abs=1e-12)


def geotrax(rows: pd.DataFrame) -> pd.DataFrame:
    local = (rows["t_utc"].dt.tz_convert("Asia/Seoul")).dt.tz_localize(None)
    return pd.DataFrame(
        {
            "Vehicle_ID": pd.factorize(rows["vehicle"], sort=True)[0] + 1,
            "Timestamp": local.dt.strftime("%Y-%m-%d %H:%M:%S.%f"),
            "Frame_Number": rows["frame"],
            "Local_X": 170_000 + rows["x_m"],
            "Local_Y": 532_000 + rows["y_m"],
            "Vehicle_Length": np.where(rows["frame"] > 5, 4.6, np.nan),
            "Vehicle_Speed": 3.6 * rows["speed_mps"],
            "Visibility": np.where(rows["frame"] == 30, 0, 1),
        }
    )


def on_the_ground(folder: Path, rows: pd.DataFrame) -> Path:
    """Tables of ``track`` with the detections they were made of: ids, times and metres, no pixels."""
    result = result_of(rows)
    moved = {"x_m": lambda t: t["x_m"] + 170_000, "y_m": lambda t: t["y_m"] + 532_000}
    folder.mkdir(exist_ok=True)
    seen = result.detections[["detection_id", "t_utc", "x_m", "y_m"]].assign(**moved)
    seen.to_parquet(folder / "detections.parquet", index=False)
    result.track_points.assign(**moved).to_parquet(folder / "track_points.parquet", index=False)
    return folder


def test_geotrax_is_compared_on_the_ground_by_times_of_the_zone_that_is_given(tmp_path: Path) -> None:
    geotrax(world()).to_csv(tmp_path / "songdo.csv", index=False)
    result = load_result(on_the_ground(tmp_path / "tracked", world().assign(x_m=lambda t: t["x_m"] + 0.5)))
    result = replace(result, detections=result.detections.assign(x_m=result.detections["x_m"] + 0.5))
    numbers = evaluate(result, load_truth(tmp_path / "songdo.csv", time_zone="Asia/Seoul")).numbers
    scores = numbers["detection"]["detections"]
    assert scores["f1"]["value"] == 1
    assert scores["missed"] == 0
    assert scores["neutral"] == int((world()["frame"] == 30).sum())  # cut by the border there
    assert scores["centroid_error_median_m"]["value"] == pytest.approx(0.5, abs=1e-6)
    assert scores["strata"]["moving"]["recall"]["value"] == 1
    assert value(numbers, "tracks.idf1") == 1
    assert value(numbers, "speeds.rms_kmh") == pytest.approx(0, abs=1e-9)
    off = replace(result, detections=result.detections.assign(x_m=result.detections["x_m"] + 1.81))
    far = evaluate(off, load_truth(tmp_path / "songdo.csv", time_zone="Asia/Seoul")).numbers
    assert value(far, "detection.detections.recall") == 0  # 2.31 m: beyond half of 4.6 m


def test_local_times_without_a_zone_are_not_guessed(tmp_path: Path) -> None:
    geotrax(world()).to_csv(tmp_path / "songdo.csv", index=False)
    result = load_result(on_the_ground(tmp_path / "tracked", world()))
    with pytest.raises(UnusableData, match="--time-zone"):
        evaluate(result, load_truth(tmp_path / "songdo.csv"))


def labelled(rows: pd.DataFrame, folder: Path) -> Path:
    """A table of detections that names the true vehicles, with ids as numbers, and a false alarm in each frame."""
    alarms = rows.drop_duplicates("frame").assign(vehicle=None, x_m=lambda t: t["x_m"] + 40)
    both = pd.concat([rows, alarms], ignore_index=True).rename(columns={"vehicle": "truth_vehicle"})
    both["detection_id"] = np.random.default_rng(1).permutation(len(both))
    path = folder / "labelled.parquet"
    both[["detection_id", "t_utc", "x_m", "y_m", "truth_vehicle", "track", "frame"]].to_parquet(path, index=False)
    return path


def test_tracks_made_of_the_truths_own_detections_are_joined_by_id(tmp_path: Path) -> None:
    path = labelled(world(), tmp_path)
    rows = pd.read_parquet(path)
    points = rows.assign(vehicle_id=rows["track"]).drop(columns=["track", "truth_vehicle", "frame"])
    points["detection_id"] = points["detection_id"].astype("Int64")
    real = rows["truth_vehicle"].notna()
    points[real].to_parquet(tmp_path / "track_points.parquet", index=False)
    numbers = evaluate(load_result(tmp_path), load_truth(path)).numbers
    assert value(numbers, "tracks.mota") == value(numbers, "tracks.hota") == value(numbers, "links.label_rate") == 1
    assert "detections" not in numbers["detection"]
    points.to_parquet(tmp_path / "track_points.parquet", index=False)  # now the false alarms are on tracks, too
    points = points.assign(vehicle_id=points["vehicle_id"].where(real, "stray"))
    points.to_parquet(tmp_path / "track_points.parquet", index=False)
    numbers = evaluate(load_result(tmp_path), load_truth(path)).numbers
    assert numbers["detection"]["tracked"]["false_alarms"] == 40
    assert value(numbers, "tracks.mota") == pytest.approx(1 - 40 / real.sum(), abs=1e-12)


def test_a_truth_with_repeated_ids_is_refused(tmp_path: Path) -> None:
    path = labelled(world(), tmp_path)
    rows = pd.read_parquet(path)
    rows.assign(vehicle_id=rows["track"]).to_parquet(tmp_path / "track_points.parquet", index=False)
    pd.concat([rows, rows.assign(t_utc=rows["t_utc"] + pd.Timedelta(hours=1))]).to_parquet(path, index=False)
    with pytest.raises(UnusableData, match="ids repeat"):
        evaluate(load_result(tmp_path / "track_points.parquet"), load_truth(path))


def test_a_published_result_is_a_truth_and_perfect_against_itself(tmp_path: Path) -> None:
    out = write_result(result_of(world()), tmp_path / "out")
    numbers = evaluate(load_result(out), load_truth(out)).numbers
    assert value(numbers, "detection.detections.f1") == value(numbers, "tracks.idf1") == 1
    assert value(numbers, "od.error") == value(numbers, "turns.share_error") == value(numbers, "speeds.rms_kmh") == 0


def test_parquet_of_others_that_lacks_what_is_needed_is_named(tmp_path: Path) -> None:
    out = on_the_ground(tmp_path / "tracked", world())
    pd.read_parquet(out / "detections.parquet").drop(columns="x_m").to_parquet(out / "detections.parquet")
    with pytest.raises(UnusableData, match=r"detections\.parquet: columns missing: x_m"):
        load_result(out)
    (tmp_path / "gt.txt").write_text("1,2,3\n")
    with pytest.raises(UnusableData, match=r"not boxes; expected numbers: frame, id"):
        load_truth(tmp_path / "gt.txt")
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "notes.csv").write_text("what,ever\n1,2\n")
    with pytest.raises(ConfigError, match="no truth found here"):
        load_truth(tmp_path / "empty" / "notes.csv")


def test_the_command_ends_with_what_matters_and_writes_one_json_and_one_page(tmp_path: Path) -> None:
    out = write_result(result_of(world(), ends=trips()), tmp_path / "out")
    done = CliRunner().invoke(command, [str(out), str(out), "--out", str(tmp_path / "scores")])
    assert done.exit_code == 0, done.output
    last = done.output.rstrip().split("\n\n")[-1].splitlines()
    assert last[0] == "In short"
    assert any("detection F1" in line and "100.0%" in line for line in last)
    numbers = json.loads((tmp_path / "scores" / "evaluation.json").read_text())
    assert numbers["tracks"]["idf1"]["value"] == 1
    text = (tmp_path / "scores" / "evaluation.md").read_text()
    assert text.index("## In short") < text.index("## Detection") < text.index("## Speeds")
    assert sorted(p.name for p in (tmp_path / "scores").iterdir()) == ["evaluation.json", "evaluation.md"]


@pytest.mark.real
def test_skysat_and_songdo_against_themselves(shared_data: Path, tmp_path: Path) -> None:
    skysat = shared_data / "skysat" / "tracks.csv"
    every = pd.read_csv(skysat, header=None)
    every[every[0] % 30 == 0].to_csv(tmp_path / "mine.txt", header=False, index=False)
    numbers = evaluate(load_result(tmp_path / "mine.txt"), load_truth(skysat)).numbers
    assert numbers["frames"]["scored"] == 24
    assert value(numbers, "tracks.hota") == value(numbers, "detection.detections.f1") == 1

    songdo = load_truth(shared_data / "songdo" / "tracks.csv", time_zone="Asia/Seoul")
    assert songdo.frames["t_utc"].iloc[0] == pd.Timestamp("2022-10-07T08:52:13.5Z")
    seen = songdo.sightings.merge(songdo.frames, on="frame")
    seen["detection_id"] = np.arange(len(seen)).astype(str)
    seen[["detection_id", "t_utc", "x_m", "y_m"]].to_parquet(tmp_path / "detections.parquet", index=False)
    points = seen.rename(columns={"vehicle": "vehicle_id"})
    points[["vehicle_id", "detection_id", "t_utc", "x_m", "y_m", "speed_mps"]].to_parquet(
        tmp_path / "track_points.parquet", index=False
    )
    numbers = evaluate(load_result(tmp_path), songdo).numbers
    rows = pd.read_csv(shared_data / "songdo" / "tracks.csv")
    assert numbers["tracks"]["vehicles"] == rows.loc[rows["Visibility"] > 0, "Vehicle_ID"].nunique() < 144
    assert value(numbers, "tracks.hota") == value(numbers, "tracks.mota") == 1
    assert value(numbers, "speeds.rms_kmh") == 0


def simulated(folder: Path) -> Path:
    """A truth as ``simulate`` writes it, with what its detector saw beside: a miss, a merged pair, a false alarm."""
    rows = world()
    rows["id"] = [f"t{n:04d}" for n in range(len(rows))]
    (folder / "truth").mkdir(parents=True)
    seen = table("detections", len(rows), **{name: rows[name] for name in ("t_utc", "col_px", "row_px", "x_m", "y_m")})
    seen = seen.assign(detection_id=rows["id"], vehicle_id=rows["vehicle"], visible_share=1.0)
    seen.loc[rows["frame"] == 7, "visible_share"] = 0.4
    points = table("track_points", len(rows), vehicle_id=rows["vehicle"], t_utc=rows["t_utc"], detection_id=rows["id"])
    seen.to_parquet(folder / "truth" / "detections.parquet", index=False)
    points.assign(speed_mps=rows["speed_mps"]).to_parquet(folder / "truth" / "track_points.parquet", index=False)
    at = START + pd.to_timedelta([4 * STEP_S], unit="s")
    tram = pd.DataFrame({"kind": "tram", "t_utc": at.as_unit("us"), "col_px": 900.0, "row_px": 650.0, "length_m": 9.9})
    walker = tram.assign(kind="pedestrian", col_px=300.0, row_px=668.0)
    pd.concat([tram, walker]).to_parquet(folder / "truth" / "others.parquet", index=False)
    merged = (rows["frame"] == 3) & rows["vehicle"].isin(["car 05", "car 06"])
    missed = (rows["frame"] == 9) & (rows["vehicle"] == "car 08")
    found = rows[~missed].assign(found_id=lambda t: "d" + t["id"])
    found.loc[merged, "found_id"] = found.loc[merged, "found_id"].iloc[0]
    keys = found[["found_id", "vehicle"]].set_axis(["detection_id", "vehicle_id"], axis=1)
    keys = pd.concat([keys, pd.DataFrame({"detection_id": ["d-false"], "vehicle_id": [None]})])
    keys.sample(frac=1, random_state=1).to_parquet(folder / "truth" / "detection_keys.parquet", index=False)
    false = found.iloc[:1].assign(found_id="d-false", x_m=999.0)
    made = pd.concat([found.drop_duplicates("found_id"), false]).sample(frac=1, random_state=2)
    names = ("t_utc", "col_px", "row_px", "x_m", "y_m")
    columns = {name: made[name].array for name in names}
    made_table = table("detections", len(made), **columns).assign(detection_id=made["found_id"].array)
    made_table.to_parquet(folder / "detections.parquet", index=False)
    made.to_parquet(folder / "made.parquet")
    return folder


def test_tracks_of_simulated_detections_are_known_by_their_keys(tmp_path: Path) -> None:
    made = pd.read_parquet(simulated(tmp_path / "sim") / "made.parquet")
    points = made.rename(columns={"track": "vehicle_id", "found_id": "detection_id"})
    points = points[["vehicle_id", "detection_id", "t_utc", "x_m", "y_m"]]
    points.loc[points["detection_id"] == "d-false", "vehicle_id"] = "stray"
    points.to_parquet(tmp_path / "track_points.parquet", index=False)
    numbers = evaluate(load_result(tmp_path), load_truth(tmp_path / "sim")).numbers
    hidden = int((world()["frame"] == 7).sum())
    tracked = numbers["detection"]["tracked"]
    assert tracked["true"] == len(world()) - 1 - hidden  # what was missed, or is hidden, is not the tracker's to find
    assert (tracked["false_alarms"], tracked["missed"], tracked["neutral"]) == (1, 1, hidden)
    assert value(numbers, "links.precision_between_vehicles") == 1
    assert numbers["od"] is numbers["turns"] is None
    assert "centroid_error_median_m" not in tracked


def test_a_tram_is_neither_right_nor_wrong_and_a_pedestrian_is_a_false_alarm(tmp_path: Path) -> None:
    truth = load_truth(simulated(tmp_path / "sim"))
    rows = world()
    extra = rows[rows["frame"] == 4].iloc[:2].assign(track=None, vehicle=["tram", "walker"])
    extra = extra.assign(col_px=[907.0, 300.0], row_px=[655.0, 668.0])
    scores = evaluate(result_of(pd.concat([rows, extra])), truth).numbers["detection"]["detections"]
    assert scores["false_alarms"] == 1
    assert scores["neutral"] == 1 + int((rows["frame"] == 7).sum())
    assert scores["recall"]["value"] == 1
