"""Label rates and calibration say exactly what was put into the table of matches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from evaluation_worlds import FRAMES, STEP_S, result_of, table, truth_of, world

from vtrack_batch.evaluation.blocks import time_blocks
from vtrack_batch.evaluation.calibration import calibration
from vtrack_batch.evaluation.evaluate import evaluate
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.sides import Result


def with_matches(seen: pd.DataFrame, probability: float = 0.8) -> Result:
    """The result of *seen* with the true links, and the true ends, all stated at *probability*."""
    result = result_of(seen)
    ordered = seen.sort_values(["frame", "vehicle"]).reset_index(drop=True)
    ordered["id"] = result.detections["detection_id"].to_numpy()
    ordered = ordered.sort_values(["vehicle", "frame"])
    again = ordered.groupby("vehicle")["id"].shift(-1)
    first = ordered.drop_duplicates("vehicle")
    ends = pd.DataFrame(
        {
            "from": [*ordered["id"], *[None] * int((first["frame"] > 0).sum())],
            "to": [*again, *first.loc[first["frame"] > 0, "id"]],
        }
    ).astype(object)
    ends["to"] = ends["to"].where(ends["to"].notna(), None)
    last = ordered.loc[ordered["frame"] == FRAMES - 1, "id"]
    ends = ends[~(ends["to"].isna() & ends["from"].isin(last))]
    matches = table(
        "matches",
        len(ends),
        match_id=[f"{a}>{b}" for a, b in ends.itertuples(index=False)],
        detection_id_from=ends["from"].to_numpy(),
        detection_id_to=ends["to"].to_numpy(),
        probability=probability,
        method="default",
    )
    return replace(result, matches=matches)


def scores(result: Result, **changes: object) -> dict:
    return evaluate(result, truth_of(world()), **changes).numbers["matches"]


def test_true_matches_are_perfect_and_no_match_is_an_answer() -> None:
    numbers = scores(with_matches(world(), probability=1.0))
    for name in ("label_rate", "label_rate_earlier", "label_rate_later", "precision", "recall"):
        assert numbers[name]["value"] == 1
    for part in ("calibration_of_links", "calibration_between_vehicles", "calibration_of_ends"):
        assert numbers[part]["ece"]["value"] == 0
        assert numbers[part]["share_right"]["value"] == 1
    assert numbers["calibration_of_ends"]["events"] > 20


def test_links_left_out_are_wrong_labels_of_both_images() -> None:
    result = with_matches(world())
    links = result.matches["detection_id_from"].notna() & result.matches["detection_id_to"].notna()
    dropped = result.matches[links].sample(25, random_state=1).index
    numbers = scores(replace(result, matches=result.matches.drop(index=dropped)))
    rows = world()
    earlier, later = int((rows["frame"] < FRAMES - 1).sum()), int((rows["frame"] > 0).sum())
    assert numbers["label_rate_earlier"]["value"] == pytest.approx(1 - 25 / earlier, abs=1e-12)
    assert numbers["label_rate_later"]["value"] == pytest.approx(1 - 25 / later, abs=1e-12)
    assert numbers["label_rate"]["value"] == pytest.approx(1 - 50 / (earlier + later), abs=1e-12)
    assert numbers["recall"]["value"] == pytest.approx(1 - 25 / int(links.sum()), abs=1e-12)
    assert numbers["precision"]["value"] == 1


def test_probabilities_off_by_a_fifth_have_that_calibration_error() -> None:
    numbers = scores(with_matches(world(), probability=0.8))
    assert numbers["calibration_of_links"]["ece"]["value"] == pytest.approx(0.2, abs=1e-12)
    assert numbers["calibration_of_links"]["mean_stated"]["value"] == pytest.approx(0.8)
    (only,) = numbers["calibration_of_links"]["bins"]
    assert (only["above"], only["up_to"], only["share_right"]["value"]) == (0.7, 0.8, 1)


def test_swapped_links_are_wrong_and_count_in_calibration() -> None:
    result = with_matches(world(), probability=0.9)
    matches = result.matches
    step = matches["detection_id_from"].notna() & matches["detection_id_to"].notna()
    moment = result.frames["t_utc"].iloc[11]
    at = matches.index[
        step & (matches["detection_id_from"].map(result.detections.set_index("detection_id")["t_utc"]) == moment)
    ]
    i, j = at[:2]
    swapped = matches["detection_id_to"].copy()
    swapped[i], swapped[j] = swapped[j], swapped[i]
    numbers = scores(replace(result, matches=matches.assign(detection_id_to=swapped)))
    total = int(step.sum())
    assert numbers["precision"]["value"] == pytest.approx(1 - 2 / total, abs=1e-12)
    assert numbers["calibration_of_links"]["ece"]["value"] == pytest.approx(abs(0.9 - (1 - 2 / total)), abs=1e-9)


def test_a_link_over_a_miss_is_right_and_an_end_before_it_is_wrong() -> None:
    rows = world()
    gone = (rows["vehicle"] == "car 04") & (rows["frame"].isin([20, 21]))
    bridged = with_matches(rows[~gone], probability=0.7)
    assert scores(bridged)["precision"]["value"] == 1
    assert scores(bridged)["calibration_of_ends"]["share_right"]["value"] == 1
    ids = bridged.detections.set_index("detection_id")
    last = ids.index[
        (ids["row_px"] == 40.0 + 25 * 4) & (ids["t_utc"] == rows.loc[rows["frame"] == 19, "t_utc"].iloc[0])
    ][0]
    cut = bridged.matches["detection_id_from"] == last
    ended = bridged.matches.assign(detection_id_to=bridged.matches["detection_id_to"].where(~cut, None))
    # the longest link left spans one frame: within it, the end is no fault
    assert scores(replace(bridged, matches=ended))["calibration_of_ends"]["share_right"]["value"] == 1
    other = (rows["vehicle"] == "car 05") & (rows["frame"].isin([20, 21]))
    two = with_matches(rows[~(gone | other)], probability=0.7)
    ids = two.detections.set_index("detection_id")
    last = ids.index[
        (ids["row_px"] == 40.0 + 25 * 4) & (ids["t_utc"] == rows.loc[rows["frame"] == 19, "t_utc"].iloc[0])
    ][0]
    cut = two.matches["detection_id_from"] == last
    ended = two.matches.assign(detection_id_to=two.matches["detection_id_to"].where(~cut, None))
    # another link spans three frames: this matcher could have bridged it
    numbers = scores(replace(two, matches=ended))["calibration_of_ends"]
    assert numbers["share_right"]["value"] == pytest.approx(1 - 1 / numbers["events"], abs=1e-12)


@pytest.mark.parametrize("seed", [1, 2])
def test_order_of_matches_changes_nothing(seed: int) -> None:
    result = with_matches(world())
    rng = np.random.default_rng(0)
    noisy = result.matches.assign(probability=rng.uniform(0, 1, len(result.matches)).round(1))
    other = noisy.sample(frac=1, random_state=seed).reset_index(drop=True)
    assert scores(replace(result, matches=noisy)) == scores(replace(result, matches=other))


def test_true_probabilities_have_little_calibration_error_and_overconfident_ones_what_they_add() -> None:
    rng = np.random.default_rng(3)
    stated = rng.uniform(0.3, 0.9, 40_000)
    right = rng.random(len(stated)) < stated
    frame = rng.integers(0, 400, len(stated))
    blocks = time_blocks(STEP_S * np.arange(400.0), EvaluationParams(resamples=200))
    honest = calibration(frame, stated, right, blocks, least=0.02)
    boastful = calibration(frame, stated + 0.08, right, blocks, least=0.02)
    assert honest["ece"]["value"] < 0.012
    assert boastful["ece"]["value"] == pytest.approx(0.08, abs=0.006)
    assert boastful["ece"]["lo"] < 0.08 < boastful["ece"]["hi"]


def test_what_is_stated_as_hopeless_is_left_out_of_calibration() -> None:
    blocks = time_blocks(np.arange(4.0), EvaluationParams(resamples=100))
    stated = np.array([0.02, 0.021, 1.0, np.nan])
    found = calibration(np.arange(4), stated, np.array([True, False, True, True]), blocks, least=0.02)
    assert found["events"] == 2
    assert [(b["above"], b["up_to"], b["events"]) for b in found["bins"]] == [(0.02, 0.1, 1), (0.999, 1.0, 1)]
    assert calibration(np.arange(1), np.array([0.01]), np.array([True]), blocks, least=0.02) is None


def test_identity_probability_is_judged_by_tracks_that_hold_one_vehicle_only() -> None:
    rows = world()
    late = (rows["vehicle"] == "car 01") & (rows["frame"] > 20)
    rows = rows[~((rows["vehicle"] == "car 02") & (rows["frame"] > 20))]
    rows.loc[late, "track"] = "v-car 02"  # one track of 24 holds two vehicles
    result = result_of(rows)
    stated = replace(result, trajectories=result.trajectories.assign(identity_probability=0.97))
    numbers = evaluate(stated, truth_of(world())).numbers["tracks"]["identity_calibration"]
    assert numbers["events"] == 24
    assert numbers["share_right"]["value"] == pytest.approx(23 / 24)
    assert numbers["ece"]["value"] == pytest.approx(abs(0.97 - 23 / 24), abs=1e-12)
