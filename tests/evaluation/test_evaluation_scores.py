"""A truth against itself is perfect; what is injected comes out, exactly; order of rows changes nothing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from evaluation_worlds import (
    FRAMES,
    GSD_M,
    START,
    STEP_S,
    frames_table,
    result_of,
    shuffled,
    table,
    trips,
    truth_of,
    world,
    written_and_read,
)

from vtrack_batch.errors import UnusableData
from vtrack_batch.evaluation.evaluate import evaluate
from vtrack_batch.evaluation.params import EvaluationParams


def value(numbers: dict, path: str) -> float | None:
    for name in path.split("."):
        numbers = numbers[name]
    return numbers["value"]


def numbers_of(seen: pd.DataFrame, **changes: object) -> dict:
    return evaluate(result_of(seen, **changes), truth_of(world())).numbers


PERFECT = {
    "detection.detections.precision": 1,
    "detection.detections.recall": 1,
    "detection.detections.f1": 1,
    "detection.tracked.f1": 1,
    "detection.detections.centroid_error_rms_px": 0,
    "detection.detections.strata.moving.recall": 1,
    "detection.detections.strata.standing.recall": 1,
    "detection.detections.strata.dark.recall": 1,
    "detection.detections.strata.grey.recall": 1,
    "links.precision": 1,
    "links.recall": 1,
    "links.label_rate": 1,
    "tracks.idf1": 1,
    "tracks.mota": 1,
    "tracks.hota": 1,
    "tracks.end_to_end": 1,
    "tracks.found_on_one_track": 1,
    "tracks.first_to_last": 1,
    "od.error": 0,
    "od.count_ratio": 1,
    "turns.count_error": 0,
    "turns.share_error": 0,
    "speeds.bias_kmh": 0,
    "speeds.rms_kmh": 0,
    "speeds.within_stated_95": 1,
}


@pytest.mark.parametrize("through_files", [False, True])
def test_truth_against_itself_is_perfect(through_files: bool, tmp_path: Path) -> None:
    result = result_of(world())
    evaluation = evaluate(written_and_read(result, tmp_path) if through_files else result, truth_of(world()))
    assert {name: value(evaluation.numbers, name) for name in PERFECT} == pytest.approx(PERFECT, abs=1e-12)
    assert evaluation.numbers["tracks"]["id_switches"] == 0
    assert evaluation.numbers["place_names"] == {}
    json.dumps(evaluation.numbers, allow_nan=False)


def test_the_page_names_every_section_and_every_score_has_its_interval() -> None:
    evaluation = evaluate(result_of(world()), truth_of(world()))
    text = evaluation.text()
    for title in ("Detection", "Links", "Tracks", "OD pairs", "Turns", "Speeds"):
        assert f"\n{title}" in text
    assert "100.0%  [100.0%, 100.0%]" in text
    assert "nan" not in text


def test_half_a_metre_of_shift_is_the_centroid_error_and_nothing_else() -> None:
    numbers = numbers_of(world().assign(col_px=lambda t: t["col_px"] + 0.5 / GSD_M))
    for name in ("centroid_error_median_px", "centroid_error_rms_px"):
        assert value(numbers, f"detection.detections.{name}") == pytest.approx(0.5 / GSD_M, abs=1e-9)
    assert value(numbers, "detection.detections.f1") == 1
    assert value(numbers, "tracks.idf1") == 1
    assert value(numbers, "tracks.hota") < 1  # HOTA looks at places, too


def test_ten_per_cent_dropped_are_ten_per_cent_missed() -> None:
    rows = world()
    dropped = rows.drop(index=np.random.default_rng(3).choice(len(rows), len(rows) // 10, replace=False))
    numbers = numbers_of(dropped)
    kept = len(dropped) / len(rows)
    assert value(numbers, "detection.detections.recall") == pytest.approx(kept, abs=1e-12)
    assert value(numbers, "detection.detections.precision") == 1
    assert value(numbers, "detection.detections.f1") == pytest.approx(2 * kept / (1 + kept), abs=1e-12)
    assert value(numbers, "tracks.mota") == pytest.approx(kept, abs=1e-12)
    assert value(numbers, "tracks.idf1") == pytest.approx(2 * kept / (1 + kept), abs=1e-12)
    assert value(numbers, "links.precision") == 1
    assert value(numbers, "links.recall") == 1  # of links whose both ends were found
    assert value(numbers, "tracks.found_on_one_track") == 1
    assert value(numbers, "tracks.end_to_end") < 0.3
    interval = numbers["detection"]["detections"]["recall"]
    assert interval["lo"] < kept < interval["hi"]
    assert 0.005 < interval["hi"] - interval["lo"] < 0.1


def test_three_identity_swaps_are_six_switches_and_six_wrong_links() -> None:
    rows = world()
    at = 20
    for a, b in (("car 00", "car 03"), ("car 06", "car 09"), ("car 12", "car 15")):
        names = {a: f"v-{b}", b: f"v-{a}"}
        late = rows["vehicle"].isin(names) & (rows["frame"] >= at)
        rows.loc[late, "track"] = rows.loc[late, "vehicle"].map(names)
    numbers = numbers_of(rows)
    assert numbers["tracks"]["id_switches"] == 6
    assert numbers["links"]["made"] - numbers["links"]["right"] == 6
    made = numbers["links"]["made"]
    assert value(numbers, "links.precision") == pytest.approx(1 - 6 / made, abs=1e-12)
    assert value(numbers, "links.recall") == pytest.approx(1 - 6 / made, abs=1e-12)
    assert value(numbers, "tracks.mota") == pytest.approx(1 - 6 / len(rows), abs=1e-12)
    assert value(numbers, "tracks.end_to_end") == pytest.approx(18 / 24, abs=1e-12)
    assert value(numbers, "tracks.first_to_last") == pytest.approx(18 / 24, abs=1e-12)
    assert value(numbers, "detection.detections.f1") == 1
    # one label wrong at each end of each wrong link, of all labels: both images of each pair of frames
    labels = sum((rows["frame"] < FRAMES - 1).to_numpy()) + sum((rows["frame"] > 0).to_numpy())
    assert value(numbers, "links.label_rate") == pytest.approx(1 - 12 / labels, abs=1e-12)


def test_a_track_in_two_parts_breaks_one_link_and_is_no_wrong_one() -> None:
    rows = world()
    rows.loc[(rows["vehicle"] == "car 03") & (rows["frame"] >= 20), "track"] = "v-late"
    numbers = numbers_of(rows)
    assert value(numbers, "links.precision") == 1
    assert numbers["links"]["could_be_made"] - numbers["links"]["could_be_made_and_were"] == 1
    assert numbers["tracks"]["id_switches"] == 1
    assert value(numbers, "tracks.end_to_end") == pytest.approx(23 / 24)


def test_counts_times_one_point_one_are_ten_per_cent_of_error() -> None:
    numbers = numbers_of(world(), factor=1.1)
    assert value(numbers, "od.error") == pytest.approx(0.1, abs=1e-12)
    assert value(numbers, "od.count_ratio") == pytest.approx(1.1, abs=1e-12)
    assert value(numbers, "turns.count_error") == pytest.approx(0.1, abs=1e-12)
    assert value(numbers, "turns.share_error") == pytest.approx(0, abs=1e-12)
    hours = 4 * 30 / 3600
    each = 24 / 6 / hours
    assert len(numbers["od"]["table"]) == 6
    assert numbers["od"]["table"][0] == {
        "origin": "east",
        "destination": "north",
        "true": 4.0,
        "found": pytest.approx(4.4),
        "geh": pytest.approx(np.sqrt(2 * (0.1 * each) ** 2 / (2.1 * each))),
    }
    geh = np.sqrt(2 * (0.1 * each) ** 2 / (2.1 * each))
    for part in ("od", "turns"):
        assert value(numbers, f"{part}.geh_median") == pytest.approx(geh, abs=1e-9)
        assert value(numbers, f"{part}.geh_below_2") == value(numbers, f"{part}.geh_below_5") == 1


def test_unknown_ends_are_a_share_of_their_own_and_not_an_error() -> None:
    ends = trips()
    ends.loc[ends["vehicle"].isin(["car 00", "car 01", "car 02"]), "origin"] = "unknown"
    od = numbers_of(world(), ends=ends)["od"]
    assert od["unknown_share_found"]["value"] == pytest.approx(3 / 24)
    assert od["unknown_share_true"]["value"] == 0
    assert od["error"]["value"] == pytest.approx(3 / 24)


def test_proposed_places_are_named_by_where_their_vehicles_really_start_and_end() -> None:
    proposed = {"north": "p1", "east": "p2", "south": "p3"}
    ends = trips().replace({"origin": proposed, "destination": proposed})
    evaluation = evaluate(result_of(world(), ends=ends), truth_of(world()))
    assert evaluation.numbers["place_names"] == {"p1": "north", "p2": "east", "p3": "south"}
    assert value(evaluation.numbers, "od.error") == 0
    assert value(evaluation.numbers, "turns.share_error") == 0
    assert "p1 = north" in evaluation.text()


def test_a_place_that_nobody_was_seen_at_stays_a_stranger() -> None:
    ends = trips()
    ends["origin"] = ends["origin"].replace("north", "p1")
    rows = world()
    rows.loc[rows["vehicle"].isin(ends.loc[ends["origin"] == "p1", "vehicle"]), "track"] = None
    numbers = numbers_of(rows, ends=ends)
    assert numbers["place_names"] == {}
    assert value(numbers, "od.error") == pytest.approx(16 / 24)  # 8 trips are missing where they were, and 8 are wrong


def test_speed_errors_come_out_in_kmh_over_moving_points_only() -> None:
    rows = world()
    rows["speed_mps"] = np.where(rows["speed_mps"] > 0, rows["speed_mps"] + 0.5 * (-1.0) ** rows["frame"] + 0.1, 9.0)
    numbers = numbers_of(rows)
    moving = int((world()["speed_mps"] > 1).sum())
    sign = ((-1.0) ** world().loc[world()["speed_mps"] > 1, "frame"]).mean()
    assert numbers["speeds"]["points"] == moving
    assert value(numbers, "speeds.bias_kmh") == pytest.approx(3.6 * (0.5 * sign + 0.1), abs=1e-9)
    assert value(numbers, "speeds.rms_kmh") == pytest.approx(3.6 * np.sqrt(0.26 + 0.1 * sign), abs=1e-9)
    # +0.6 m/s lies outside 1.96 · 0.25 m/s, -0.4 m/s inside
    assert value(numbers, "speeds.within_stated_95") == pytest.approx((1 - sign) / 2, abs=1e-9)


def test_false_alarms_cost_precision_except_on_parked_cars_ignored_boxes_and_the_border() -> None:
    rows = world()
    extra = rows[rows["frame"] == 7].iloc[:1]
    places = {"alone": (900.0, 650.0), "parked": (800.0, 655.0), "tram": (700.0, 660.0), "border": (600.0, 690.0)}
    added = [extra.assign(col_px=c, row_px=r, track=None, vehicle=name) for name, (c, r) in places.items()]
    truth = replace(
        truth_of(rows),
        parked=pd.DataFrame({"frame": [7], "col_px": [806.0], "row_px": [655.0]}),
        ignore=pd.DataFrame({"frame": [7], "left": [690.0], "top": [650.0], "width": [20.0], "height": [20.0]}),
    )
    scores = evaluate(result_of(pd.concat([rows, *added])), truth).numbers["detection"]["detections"]
    assert scores["false_alarms"] == 1
    assert scores["neutral"] == 3
    assert scores["precision"]["value"] == pytest.approx(len(rows) / (len(rows) + 1))
    assert scores["parked"] == {"true": 1, "recall": pytest.approx({"value": 1, "lo": 1, "hi": 1}, nan_ok=True)}


def test_a_second_sighting_of_a_vehicle_is_a_false_alarm() -> None:
    rows = world()
    double = rows[rows["frame"] == 5].assign(row_px=lambda t: t["row_px"] + 2, track=None)
    scores = numbers_of(pd.concat([rows, double]))["detection"]["detections"]
    assert scores["false_alarms"] == len(double)
    assert scores["recall"]["value"] == 1


@pytest.mark.parametrize("off_px", [4.999, 5.001])
def test_the_gate_is_closed_at_five_pixels(off_px: float) -> None:
    numbers = numbers_of(world().assign(row_px=lambda t: t["row_px"] + off_px))
    assert value(numbers, "detection.detections.recall") == (1 if off_px < 5 else 0)


def test_quarantined_frames_count_as_missed_and_frames_of_another_archive_do_not() -> None:
    rows = world()
    frames = frames_table()
    frames.loc[3, "status"] = "quarantined"
    seen = rows[rows["frame"] != 3]
    numbers = numbers_of(seen, frames=frames)
    assert numbers["frames"]["scored"] == FRAMES
    assert numbers["frames"]["not_used_by_the_run"] == 1
    assert numbers["detection"]["detections"]["missed"] == int((rows["frame"] == 3).sum())
    result = result_of(seen)
    without = replace(result, frames=result.frames.drop(index=3))
    numbers = evaluate(without, truth_of(rows)).numbers
    assert numbers["frames"]["scored"] == FRAMES - 1
    assert numbers["detection"]["detections"]["missed"] == 0
    assert "1 frames of the truth are not in the result's archive" in numbers["remarks"][0]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_order_of_rows_changes_nothing(seed: int) -> None:
    rows = world()
    rows["col_px"] += np.random.default_rng(0).normal(0, 3, len(rows))
    rows.loc[rows.sample(frac=0.1, random_state=0).index, "track"] = "v-car 01"
    rows = rows.drop_duplicates(["frame", "track"])
    result, truth = result_of(rows), truth_of(world())
    other = replace(truth, sightings=truth.sightings.sample(frac=1, random_state=seed).reset_index(drop=True))
    assert evaluate(shuffled(result, seed), other).numbers == evaluate(result, truth).numbers


def test_an_empty_result_finds_nothing_and_says_so() -> None:
    numbers = numbers_of(world().iloc[:0], ends=trips().iloc[:0])
    assert value(numbers, "detection.detections.recall") == 0
    assert value(numbers, "detection.detections.precision") is None
    assert value(numbers, "tracks.mota") == 0
    assert value(numbers, "tracks.hota") == 0
    assert value(numbers, "od.error") == 1
    assert numbers["speeds"]["points"] == 0
    json.dumps(numbers, allow_nan=False)


def test_an_empty_truth_makes_everything_found_a_false_alarm() -> None:
    evaluation = evaluate(result_of(world()), truth_of(world().iloc[:0]))
    assert value(evaluation.numbers, "detection.detections.precision") == 0
    assert value(evaluation.numbers, "detection.detections.recall") is None
    json.dumps(evaluation.numbers, allow_nan=False)
    assert evaluation.text()


def test_result_and_truth_of_different_archives_are_refused() -> None:
    later = frames_table()
    later["t_utc"] += pd.Timedelta(days=1)
    with pytest.raises(UnusableData, match="no frame in common"):
        evaluate(result_of(world(), frames=later), truth_of(world()))


def test_a_second_camera_is_left_out_and_named() -> None:
    result = result_of(world())
    second = result.frames.assign(frame_id="b" + result.frames["frame_id"], path="qass/x" + result.frames["path"])
    both = replace(result, frames=pd.concat([second, result.frames], ignore_index=True))
    evaluation = evaluate(both, truth_of(world()))
    assert value(evaluation.numbers, "detection.detections.f1") == 1
    assert "40 frames of the result share their time" in evaluation.text()


def test_intervals_are_drawn_over_blocks_of_time_and_repeat() -> None:
    rows = world()
    seen = rows[~((rows["frame"] < 10) & (rows["vehicle"] > "car 11"))]  # all misses are in the first 15 s
    first, second = numbers_of(seen), numbers_of(seen)
    assert first == second
    blocky = first["detection"]["detections"]["recall"]
    assert blocky["lo"] < 0.85
    assert blocky["hi"] == 1
    wide = evaluate(result_of(seen), truth_of(rows), params=EvaluationParams(block_s=1.5)).numbers
    narrow = wide["detection"]["detections"]["recall"]
    assert narrow["hi"] - narrow["lo"] < blocky["hi"] - blocky["lo"]
    assert first["frames"]["block_s"] == pytest.approx(FRAMES * STEP_S / 5)


def test_link_to_a_parked_car_is_wrong_and_links_between_parked_cars_are_not_judged() -> None:
    rows = world()
    parked = pd.DataFrame({"frame": range(FRAMES), "col_px": 1000.0, "row_px": 660.0})
    still = parked.assign(vehicle="p", speed_mps=0.0, track="v-still", standing_s=0.0, luminance=0.0, t_utc=START)
    strays = still.assign(track=lambda t: t["track"].where(t["frame"] != 39, "v-car 00"))
    truth = replace(truth_of(rows), parked=parked)
    seen = rows[~((rows["vehicle"] == "car 00") & (rows["frame"] == 39))]
    calm = evaluate(result_of(pd.concat([seen, still])), truth).numbers["links"]
    assert calm["precision"]["value"] == 1
    stray = evaluate(result_of(pd.concat([seen, strays])), truth).numbers["links"]
    assert stray["made"] - stray["right"] == 1
    assert stray["precision_between_vehicles"]["value"] == 1


def test_frames_known_from_the_quarantine_only_count_as_missed_by_number(tmp_path: Path) -> None:
    rows = world()
    result = result_of(rows[rows["frame"] != 3])
    result = replace(
        result,
        frames=result.frames.drop(index=3),
        quarantine=table("quarantine", 1, path=["pass/f0003.jpg"], reason="unreadable"),
    )
    truth = replace(truth_of(rows), layout="rendered")
    numbers = evaluate(written_and_read(result, tmp_path), truth).numbers
    assert numbers["frames"] == {"scored": 40, "not_used_by_the_run": 1, "blocks": 5, "block_s": 12.0}
    assert numbers["detection"]["detections"]["missed"] == int((rows["frame"] == 3).sum())
