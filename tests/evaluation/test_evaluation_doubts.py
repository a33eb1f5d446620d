"""What a result says of its own doubts is measured: sigma of speeds, intervals of counts. And who touches whom."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from evaluation_worlds import START, result_of, table, trips, truth_of, world
from hypothesis import given
from hypothesis import strategies as st
from shapely import affinity, box

from vtrack_batch.evaluation.bodies import nearest_gap
from vtrack_batch.evaluation.evaluate import evaluate
from vtrack_batch.evaluation.params import EvaluationParams


def speeds_with(sigma_mps: float, spread_mps: float = 0.5) -> dict:
    rows = world()
    rows["speed_mps"] += np.random.default_rng(9).normal(0, spread_mps, len(rows))
    result = result_of(rows)
    stated = replace(result, track_points=result.track_points.assign(speed_sigma_mps=sigma_mps))
    return evaluate(stated, truth_of(world())).numbers["speeds"]


def test_a_true_sigma_has_residuals_of_one_and_half_the_sigma_of_four() -> None:
    honest, halved = speeds_with(0.5), speeds_with(0.25)
    assert honest["residual_mean_square"]["value"] == pytest.approx(1, abs=0.15)
    assert halved["residual_mean_square"]["value"] == pytest.approx(4 * honest["residual_mean_square"]["value"])
    for share, half_covered in ((50, 0.264), (80, 0.478), (95, 0.673)):  # 2 Phi(z / 2) - 1
        assert honest[f"within_stated_{share}"]["value"] == pytest.approx(share / 100, abs=0.05)
        assert halved[f"within_stated_{share}"]["value"] == pytest.approx(half_covered, abs=0.06)


def test_points_without_sigma_are_not_asked() -> None:
    numbers = speeds_with(np.nan)
    assert numbers["points"] > 0
    assert numbers["points_with_sigma"] == 0
    assert numbers["within_stated_95"]["value"] is None


def stated(half_width: float | None, factor: float = 1.0) -> dict:
    result = result_of(world(), factor=factor)
    tables = {}
    for name in ("od_pairs", "turns"):
        rows = getattr(result, name)
        ends = {"count_lo": rows["count"] - half_width, "count_hi": rows["count"] + half_width} if half_width else {}
        tables[name] = rows.assign(**ends)
    return evaluate(replace(result, **tables), truth_of(world())).numbers["count_intervals"]


def test_intervals_that_hold_the_count_cover_and_others_do_not() -> None:
    for name in ("od_pairs", "turns"):
        assert stated(0.15, factor=1.1)[name]["coverage"]["value"] == 1
        narrow = stated(0.05, factor=1.1)[name]
        assert narrow["coverage"]["value"] == 0
        assert narrow["too_high"]["value"] == 1
        assert narrow["mean_width"]["value"] == pytest.approx(0.1)
        assert stated(0.05, factor=0.9)[name]["too_low"]["value"] == 1


def test_a_result_without_intervals_says_so() -> None:
    assert stated(None)["od_pairs"] == {"counts": 24, "with_interval": 0}
    assert "none stated" in evaluate(result_of(world()), truth_of(world())).text()


def test_a_cell_that_is_no_true_one_has_a_true_count_of_nothing() -> None:
    result = result_of(world(), ends=trips().iloc[:12])
    zero = result.od_pairs.assign(count=0.0, count_lo=0.0, count_hi=0.5, destination="nowhere")
    wide = result.od_pairs.assign(count_lo=0.0, count_hi=9.0)
    both = replace(result, od_pairs=pd.concat([wide, zero.drop_duplicates(["origin", "bin_start_utc"])]))
    numbers = evaluate(both, truth_of(world())).numbers["count_intervals"]["od_pairs"]
    assert numbers["counts"] > len(wide)
    assert numbers["coverage"]["value"] == 1


def test_flows_of_gates_are_compared_with_true_crossings() -> None:
    at = START + pd.to_timedelta([1, 5, 29, 31, 70], unit="s")
    crossings = table("crossings", 5, vehicle_id=list("abcde"), gate="g", t_utc=at, direction="forward")
    bins = START + pd.to_timedelta([0, 30, 60], unit="s")
    flows = table("flows", 3, place="g", vehicle_class="all", bin_start_utc=bins, bin_s=30, observed_s=30.0)
    flows = flows.assign(status="observed", count=[3.0, 1.0, 2.0], count_lo=[2.0, 0.5, 1.5], count_hi=[4.0, 1.5, 2.5])
    numbers = evaluate(
        replace(result_of(world()), flows=flows), replace(truth_of(world()), crossings=crossings)
    ).numbers["count_intervals"]["flows"]
    assert numbers["counts"] == numbers["with_interval"] == 3
    assert numbers["coverage"]["value"] == pytest.approx(2 / 3)
    assert numbers["too_high"]["value"] == pytest.approx(1 / 3)


def test_one_bin_is_cut_into_blocks_by_the_times_of_trips() -> None:
    def one_bin(rows: pd.DataFrame) -> pd.DataFrame:
        return rows.assign(bin_start_utc=START, bin_s=120)

    starts = START + pd.to_timedelta(np.arange(24) * 2.5, unit="s")
    result, truth = result_of(world()), truth_of(world())
    result = replace(
        result,
        od_pairs=one_bin(result.od_pairs[result.od_pairs["origin"] != "north"]),
        trajectories=result.trajectories.assign(t_start_utc=starts)[result.trajectories["origin"] != "north"],
    )
    truth = replace(truth, od_pairs=one_bin(truth.od_pairs), trajectories=truth.trajectories.assign(t_start_utc=starts))
    od = evaluate(result, truth).numbers["od"]
    assert od["error"]["value"] == pytest.approx(8 / 24)
    assert 0.2 < od["error"]["lo"] <= od["error"]["value"] <= od["error"]["hi"] < 0.5
    assert od["error"]["hi"] > od["error"]["lo"]


@given(
    st.lists(
        st.tuples(st.floats(0, 30), st.floats(0, 20), st.floats(2, 9), st.floats(1, 3), st.floats(0, 360)),
        min_size=2,
        max_size=7,
    )
)
def test_gaps_are_distances_of_rectangles(bodies: list[tuple[float, ...]]) -> None:
    shapes = [
        affinity.translate(affinity.rotate(box(-n / 2, -w / 2, n / 2, w / 2), turn, origin=(0, 0)), x, y)
        for x, y, n, w, turn in bodies
    ]
    expected = [min(a.distance(b) for b in shapes if b is not a) for a in shapes]
    parts = np.array(bodies)
    gap = nearest_gap(np.zeros(len(bodies), int), parts[:, :2], parts[:, 2:4], parts[:, 4], reach=50.0)
    for ours, theirs in zip(gap, expected, strict=True):
        # bodies that cross without a corner inside each other are no gap either way
        assert ours == pytest.approx(theirs, abs=1e-6) or (theirs == 0 and ours < 5)


def test_vehicles_of_other_frames_and_far_ones_do_not_touch() -> None:
    place = np.array([[0.0, 0], [0, 3], [0, 3], [40, 0]])
    size = np.tile([4.5, 1.8], (4, 1))
    gap = nearest_gap(np.array([0, 0, 1, 0]), place, size, np.zeros(4), reach=5.0)
    assert gap.tolist() == [pytest.approx(1.2), pytest.approx(1.2), np.inf, np.inf]


def test_touching_and_shadowed_vehicles_are_scored_apart() -> None:
    rows, truth = world(), truth_of(world())
    close, dark = rows["vehicle"] == "car 03", rows["vehicle"].isin(["car 03", "car 04"])
    told = truth.sightings.assign(gap_m=np.where(close, 2.1, 2.3), shadowed=dark.astype(float))
    numbers = evaluate(result_of(rows[~close]), replace(truth, sightings=told)).numbers
    strata = numbers["detection"]["detections"]["strata"]
    assert strata["touching"]["true"] == int(close.sum())
    assert strata["touching"]["recall"]["value"] == 0
    assert strata["shadowed"]["recall"]["value"] == pytest.approx(1 - close.sum() / dark.sum())
    pixels = told.assign(gap_m=np.nan, gap_px=np.where(close, 6.0, 7.0))  # 0.33 m a pixel: 1.98 m and 2.31 m
    numbers = evaluate(result_of(rows), replace(truth, sightings=pixels), params=EvaluationParams()).numbers
    assert numbers["detection"]["detections"]["strata"]["touching"]["true"] == int(close.sum())
