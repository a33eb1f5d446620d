"""IDF1, MOTA and HOTA are the field's own: the case below was scored by TrackEval 1.3.0 and motmetrics 1.4.0."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vtrack_batch.evaluation.blocks import Blocks, draw_blocks, time_blocks
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.tracked import Tracked
from vtrack_batch.evaluation.tracks import identity_scores

TRACKEVAL = {
    "hota": 0.3907555813076458,
    "deta": 0.5349531637624942,
    "assa": 0.2941404870540209,
    "mota": 0.4375,
    "idf1": 0.5,
}


def hand_made() -> Tracked:
    """Three vehicles, four tracks, six frames: two swap, the third has a rival; misses, and near misses."""
    vehicles = [(f, v) for f in range(6) for v in range(3) if not (v == 2 and f < 2)]
    points = [(f, k) for f in range(6) for k in range(4) if not (k == 3 and f < 3) and not (k == 1 and f == 2)]
    pairs = []
    for f in range(6):
        first, second = (0, 1) if f < 3 else (1, 0)
        pairs += [(f, 0, first, 0.9 - 0.05 * f), (f, 1, second, 0.6 + 0.05 * f)]
        pairs += [(f, 2, 2, 0.75)] if f in (2, 3, 5) else []
        pairs += [(f, 2, 3, 0.55), (f, 1, 3, 0.3)] if f >= 3 else []
        pairs += [(f, 0, 2, 0.52)] if f == 1 else []
    pairs = sorted(p for p in pairs if (p[0], p[2]) in points)
    return Tracked(
        vehicle=np.array([v for _, v in vehicles]),
        frame=np.array([f for f, _ in vehicles]),
        track=np.array([k for _, k in points]),
        track_frame=np.array([f for f, _ in points]),
        i=np.array([vehicles.index((f, v)) for f, v, _, _ in pairs]),
        j=np.array([points.index((f, k)) for f, _, k, _ in pairs]),
        similarity=np.array([s for *_, s in pairs]),
    )


def test_scores_are_those_of_trackeval() -> None:
    blocks = time_blocks(np.arange(6.0), EvaluationParams(resamples=100))
    scores = identity_scores(hand_made(), blocks)
    assert {name: scores[name]["value"] for name in TRACKEVAL} == pytest.approx(TRACKEVAL, abs=1e-12)
    assert scores["id_switches"] == 3


def test_a_draw_of_every_block_once_is_the_score_itself() -> None:
    blocks = time_blocks(np.arange(6.0), EvaluationParams(resamples=100))
    same = Blocks(blocks.of_frame, np.ones((3, blocks.draws.shape[1])), blocks.length_s)
    for name, value in TRACKEVAL.items():
        assert identity_scores(hand_made(), same)[name] == pytest.approx({"value": value, "lo": value, "hi": value})


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=30), st.integers(0, 5))
def test_quantile_of_the_data_is_the_median_and_of_a_draw_the_median_of_the_repeated_data(
    values: list[float], seed: int
) -> None:
    frame = np.arange(len(values)) % 4
    params = EvaluationParams(resamples=100, seed=seed)
    draws = draw_blocks(4, params)
    blocks = Blocks(np.arange(4), draws, 1.0)
    assert blocks.quantile(frame, np.array(values))["value"] == pytest.approx(np.median(values))
    for draw in draws[1:10]:
        alone = Blocks(np.arange(4), draw[None, :], 1.0)
        repeated = np.repeat(values, draw[frame].astype(int))
        found = alone.quantile(frame, np.array(values))["value"]
        assert found == (pytest.approx(np.median(repeated)) if len(repeated) else None)


@pytest.mark.parametrize(("span_s", "step_s", "count", "length_s"), [(598.5, 1.5, 30, 20.0), (9.5, 0.5, 5, 2.0)])
def test_long_archives_have_blocks_of_the_set_length_and_short_ones_at_least_five(
    span_s: float, step_s: float, count: int, length_s: float
) -> None:
    blocks = time_blocks(np.arange(0, span_s + step_s / 2, step_s), EvaluationParams())
    assert blocks.draws.shape[1] == count
    assert blocks.length_s == pytest.approx(length_s)
    assert (np.diff(blocks.of_frame) >= 0).all()


def test_a_single_frame_has_scores_without_interval() -> None:
    blocks = time_blocks(np.zeros(1), EvaluationParams())
    one = blocks.totals(np.array([0]))
    assert blocks.ratio(one, 2 * one) == {"value": 0.5, "lo": None, "hi": None}


def test_intervals_cover_the_true_share_about_as_often_as_they_say() -> None:
    rng = np.random.default_rng(0)
    params = EvaluationParams(resamples=200, block_s=1.0)
    blocks = time_blocks(np.arange(30.0), params)
    frame = np.repeat(np.arange(30), 50)
    covered = 0
    for _ in range(200):
        share = np.repeat(rng.beta(8, 2, 30), 50)  # vehicles of a block stand and fall together
        found = blocks.ratio(blocks.totals(frame, rng.random(1500) < share), blocks.totals(frame))
        covered += found["lo"] <= 0.8 <= found["hi"]
    assert 0.88 <= covered / 200 <= 0.99


def test_two_readings_of_clear_differ_where_a_second_track_is_near_after_a_gap() -> None:
    # the vehicle is on track 0, unseen in frame 1, then both tracks lie on it and track 1 is nearer
    tracked = Tracked(
        vehicle=np.zeros(4, int),
        frame=np.arange(4),
        track=np.array([0, 1, 0, 1, 0]),
        track_frame=np.array([0, 1, 2, 2, 3]),
        i=np.array([0, 2, 2, 3]),
        j=np.array([0, 2, 3, 4]),
        similarity=np.array([0.9, 0.6, 0.8, 0.9]),
    )
    scores = identity_scores(tracked, time_blocks(np.arange(4.0), EvaluationParams(resamples=100)))
    assert scores["id_switches"] == 2  # to track 1 and back: what TrackEval says
    assert scores["id_switches_carried"] == 0  # what motmetrics says
    assert scores["mota"]["value"] == pytest.approx((4 - 1 - 2 - 2) / 4)
    assert scores["mota_carried"]["value"] == pytest.approx((4 - 1 - 2) / 4)
    assert scores["idf1"]["value"] == pytest.approx(2 * 3 / (4 + 5))


def test_two_readings_of_clear_differ_where_fewer_but_nearer_pairs_add_up_to_more() -> None:
    # three vehicles on three tracks at 0.5 each, or two of them at 1.0: TrackEval takes two, motmetrics three
    tracked = Tracked(
        vehicle=np.arange(3),
        frame=np.zeros(3, int),
        track=np.arange(3),
        track_frame=np.zeros(3, int),
        i=np.array([0, 1, 1, 2, 2]),
        j=np.array([0, 0, 1, 1, 2]),
        similarity=np.array([0.5, 1.0, 0.5, 1.0, 0.5]),
    )
    scores = identity_scores(tracked, time_blocks(np.zeros(1), EvaluationParams(resamples=100)))
    assert scores["mota"]["value"] == pytest.approx(1 / 3)
    assert scores["mota_carried"]["value"] == 1
