"""Classes of tracks are compared vehicle by vehicle: what was confused comes out, with its share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from evaluation_worlds import result_of, truth_of, world

from vtrack_batch.evaluation.evaluate import Evaluation, evaluate

KINDS = np.array(["car", "lorry", "van", "car"])


def judged(seen: pd.DataFrame, taken_for: dict[str, str]) -> Evaluation:
    """Evaluate tracks whose classes are the true ones but for those of the vehicles *taken_for* another class."""
    vehicles = sorted(world()["vehicle"].unique())
    of_true = dict(zip(vehicles, KINDS[np.arange(len(vehicles)) % 4].tolist(), strict=True))
    result, truth = result_of(seen), truth_of(world())
    of = of_true | taken_for
    known = truth.trajectories.assign(vehicle_class=truth.trajectories["vehicle_id"].map(of_true))
    named = result.trajectories.assign(
        vehicle_class=result.trajectories["vehicle_id"].str.removeprefix("v-").map(of).astype(object)
    )
    return evaluate(replace(result, trajectories=named), replace(truth, trajectories=known))


def test_all_classes_right_and_shares_of_each_add_up() -> None:
    classes = judged(world(), {}).numbers["tracks"]["classes"]
    assert classes["tracks"] == 24
    assert classes["right_class"]["value"] == 1
    assert classes["true"] == {
        "car": {"tracks": 12, "taken_for_car": 1.0},
        "van": {"tracks": 6, "taken_for_van": 1.0},
        "lorry": {"tracks": 6, "taken_for_lorry": 1.0},
    }


def test_what_was_confused_comes_out_and_is_told_on_the_page() -> None:
    confused = judged(world(), {"car 01": "van", "car 05": "van", "car 02": "bus"})
    classes = confused.numbers["tracks"]["classes"]
    assert classes["right_class"]["value"] == pytest.approx(21 / 24)
    assert classes["true"]["lorry"] == {
        "tracks": 6, "taken_for_van": pytest.approx(2 / 6), "taken_for_lorry": pytest.approx(4 / 6)
    }  # fmt: skip
    assert classes["true"]["van"]["taken_for_bus"] == pytest.approx(1 / 6)
    assert "taken for van" in confused.text()


def test_a_track_that_follows_two_vehicles_alike_is_nobodys_and_one_that_strays_is_the_others() -> None:
    seen = world()
    half = seen.assign(track=seen["track"].mask(seen["vehicle"].isin(["car 03", "car 06"]), "v-car 03"))
    left = judged(half[(half["frame"] >= 3) & (half["frame"] < 36)], {}).numbers["tracks"]["classes"]
    assert left["tracks"] == 22
    strays = seen.assign(track=seen["track"].mask((seen["vehicle"] == "car 03") & (seen["frame"] < 10), "v-car 06"))
    assert judged(strays, {}).numbers["tracks"]["classes"]["tracks"] == 24


def test_no_classes_in_the_truth_no_answer() -> None:
    numbers = evaluate(result_of(world()), truth_of(world())).numbers
    assert numbers["tracks"]["classes"] is None
