"""What the benchmarks count with: label rates, track scores, pages."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks import jobs
from benchmarks.noise import Noise, seen
from benchmarks.page import markdown_table, write_section
from benchmarks.tuning import joined, pair_scores
from benchmarks.work import identity, label_rates, links_of, movement_scores, step_rates


@pytest.fixture(scope="module")
def score_pairs(shared_data):
    """The scorer that others wrote."""
    path = shared_data.parent / "checks" / "score_pairs.py"
    spec = importlib.util.spec_from_file_location("score_pairs", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["score_pairs"] = module
    spec.loader.exec_module(module)
    return module


def test_label_rate_by_hand():
    # 7 went away and 9 came; 8 is linked right, 7 with 9 is wrong on both sides, 6 is left alone though it is there
    image_1, image_2, pooled = label_rates(
        np.array([7, 8, 6]), np.array([6, 9, 8, 5]), np.array([0, 1]), np.array([1, 2])
    )
    assert image_1 == pytest.approx(1 / 3)  # 8
    assert image_2 == pytest.approx(2 / 4)  # 8 and 5
    assert pooled == pytest.approx(3 / 7)


@pytest.mark.real
@pytest.mark.parametrize("seed", range(5))
def test_label_rate_is_that_of_the_scorer(score_pairs, seed):
    rng = np.random.default_rng(seed)
    truth = [rng.permutation(30)[: 30 - 4 * image] for image in (1, 2)]
    count = 18
    i, k = rng.permutation(len(truth[0]))[:count], rng.permutation(len(truth[1]))[:count]
    known = {v: row for row, v in enumerate(truth[1])}
    k = np.array([known.get(truth[0][row], column) if row % 2 else column for row, column in zip(i, k, strict=True)])
    # several links into one row only in this test of odd rows: each row of image 2 once
    _, first = np.unique(k, return_index=True)
    i, k = i[first], k[first]
    ids = [rng.permutation(100)[: len(t)] for t in truth]
    images = [pd.DataFrame({"detection_id": d, "truth_vehicle": t}) for d, t in zip(ids, truth, strict=True)]
    matches = pd.DataFrame({"detection_id_from": ids[0][i], "detection_id_to": ids[1][k]})
    assert label_rates(*truth, i, k)[2] == pytest.approx(score_pairs.label_rate(*images, matches))


def test_noise_is_what_it_says_and_order_tells_nothing():
    n = 4000
    truth = pd.DataFrame(
        {"vehicle": np.arange(n), "x_m": 100.0, "y_m": -50.0, "red": 90.0, "green": 140.0, "blue": 60.0}
    )
    rows = seen(truth, Noise(position_m=0.5, missed=0.2, false_share=0.1), np.random.default_rng(2))
    true = rows[rows["vehicle"] >= 0]
    assert 0.78 < len(true) / n < 0.82
    assert 0.085 < (rows["vehicle"] < 0).sum() / len(true) < 0.115
    assert 0.48 < true["x_m"].std() < 0.52
    assert 99.9 < true["x_m"].mean() < 100.1
    # gain of 4 % of 140, a common and an own error of 3 levels, one in fifty in shadow
    assert 7 < true["green"].std() < 12
    assert abs(np.corrcoef(np.arange(len(true)), true["vehicle"])[0, 1]) < 0.05
    assert ((rows[["red", "green", "blue"]] % 1) == 0).all().all()


def world() -> pd.DataFrame:
    """Three vehicles, four frames, one sequence: 1 goes east, 2 goes west, 3 is seen in two frames only."""
    rows = [(f, -30 + 20 * f, 0, 1) for f in range(4)] + [(f, 30 - 20 * f, 5, 2) for f in range(4)]
    rows += [(f, 0, 25 - 40 * f, 3) for f in (0, 1)]
    table = pd.DataFrame(rows, columns=["frame", "x_m", "y_m", "truth"]).assign(sequence=4, interval_s=1.0)
    return table.sort_values("frame", kind="stable", ignore_index=True)


def test_truth_as_tracks_is_perfect():
    rows = world()
    assert identity(rows["truth"].to_numpy(), rows["truth"].to_numpy()) == {"idf1": 1.0, "whole": 1.0}
    assert step_rates(rows, rows["truth"].to_numpy())["rate"].tolist() == [1.0, 1.0, 1.0]
    scores = movement_scores(rows, rows["truth"].to_numpy(), 8.0)
    assert scores == {"od_error": 0.0, "turn_error": 0.0, "geh": 1.0}


def test_only_what_is_counted_counts():
    rows = world()
    track = rows["truth"].to_numpy().copy()
    track[rows["truth"] == 2] = -1
    assert step_rates(rows, track)["rate"].max() < 1
    counted = rows.assign(counted=rows["truth"] != 2)
    assert step_rates(counted, track)["rate"].tolist() == [1.0, 1.0, 1.0]


def test_one_swap_costs_what_it_costs():
    rows = world()
    late = (rows["frame"] >= 2).to_numpy()
    track = rows["truth"].to_numpy().copy()
    track[late] = 3 - track[late]  # 1 and 2 change places
    # four of ten sightings lie on a track of another vehicle
    assert identity(rows["truth"].to_numpy(), track)["idf1"] == pytest.approx(0.6)
    assert identity(rows["truth"].to_numpy(), track)["whole"] == 0.0
    # only the step from frame 1 to 2 is wrong, for 1 and 2 on both sides; 3 is left alone there, rightly
    assert step_rates(rows, track)["rate"].tolist() == pytest.approx([1.0, 1 / 5, 1.0])
    # east and west each become a vehicle that turned back, which no movement counts
    assert movement_scores(rows, track, 8.0)["od_error"] == pytest.approx(2 / 3)


def test_unlinked_rows_are_tracks_of_nobody():
    rows = world()
    nobody = np.full(len(rows), -1)
    assert identity(rows["truth"].to_numpy(), nobody) == {"idf1": 0.0, "whole": 0.0}
    # right only where a vehicle has no partner: 3 in frame 1
    assert step_rates(rows, nobody)["rate"].tolist() == pytest.approx([0.0, 1 / 5, 0.0])


def test_pairs_by_tracks_are_pairs_by_links():
    frame, track = np.array([0, 0, 0, 1, 1]), np.array([5, -1, 6, 6, -1])
    i, k = links_of(track, frame)
    assert (i.tolist(), k.tolist()) == ([2], [0])
    rows = pd.DataFrame({"sequence": 1, "frame": frame, "truth": [1, 2, 3, 3, 9]})
    twice = joined([rows, rows])
    scores = pair_scores(twice, np.tile(track, 2))
    assert scores["sequence"].tolist() == [1, 1_000_001]
    assert scores["pooled"].tolist() == [1.0 * 5 / 5, 1.0]
    assert scores[["links", "right", "true_links"]].to_numpy().tolist() == [[1, 1, 1]] * 2


def test_a_section_is_replaced_and_the_rest_is_left_alone(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# Title\n\nby hand\n")
    write_section(page, "one", "first")
    write_section(page, "two", "second")
    before = page.read_text()
    write_section(page, "one", "first")
    assert page.read_text() == before
    page.write_text(before + "\nby hand below\n")
    write_section(page, "one", "changed")
    text = page.read_text()
    assert text.startswith("# Title\n\nby hand\n")
    assert text.endswith("by hand below\n")
    assert "changed" in text
    assert "first" not in text
    assert text.count("second") == 1


def test_a_broken_section_is_refused(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("<!-- begin one -->\n")
    with pytest.raises(ValueError, match="no clear begin and end"):
        write_section(page, "one", "text")


def test_a_table_is_aligned():
    assert markdown_table(["a", "b"], [["x", "1"]]).splitlines() == ["| a | b |", "|---|---:|", "| x | 1 |"]


def test_a_job_is_not_done_again_by_the_same_code(tmp_path, monkeypatch):
    monkeypatch.setattr(jobs, "PROJECT", tmp_path)
    (tmp_path / "benchmarks").mkdir()
    source = tmp_path / "benchmarks" / "one.py"
    for text, number, met in (("1", 2, [2]), ("1", 2, [2]), ("1", 3, [2, 3]), ("2", 2, [2, 3, 2])):
        source.write_text(text)
        jobs.fingerprint.cache_clear()
        assert jobs.answer((_noted, (number, str(tmp_path / "met")))) == number * 10
        assert json.loads((tmp_path / "met").read_text()) == met
    jobs.fingerprint.cache_clear()


def _noted(number, place):
    place = Path(place)
    met = json.loads(place.read_text()) if place.exists() else []
    place.write_text(json.dumps([*met, number]))
    return number * 10
