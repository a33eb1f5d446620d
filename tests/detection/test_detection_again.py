"""Looking again: what is due by the frames before and after counts, and nothing else does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from vtrack_batch.detection.again import seen_again
from vtrack_batch.detection.candidates import Candidates
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.detection.place import Place
from vtrack_batch.model.flags import DetectionFlag

PARAMS = DetectionParams()
GSD = (0.4, 0.25)
ROAD = Place(np.ones((80, 400), np.bool_), np.zeros(2), GSD, True, False, ())
WEAK = (PARAMS.again_score + PARAMS.weak_score) / 2
Boxes = Sequence[tuple[float, float, float]]


def candidates(boxes: Boxes, score: float = 0.9, paint: float = 120.0) -> Candidates:
    """Boxes of a car's size at (x_m, y_m), turned by degrees from right to down."""
    x, y, angle = np.array(boxes, float).reshape(-1, 3).T
    turn, same = np.radians(angle), np.full(len(x), paint)
    return Candidates(
        x / GSD[0], y / GSD[1], 2.2 * np.cos(turn) / GSD[0], 2.2 * np.sin(turn) / GSD[1],
        -0.9 * np.sin(turn) / GSD[0], 0.9 * np.cos(turn) / GSD[1], same, same, same, same, same,
        np.full(len(x), score), np.zeros(len(x), np.int32),
    )  # fmt: skip


def again(before: Boxes, now: Candidates, after: Boxes, *, place: Place = ROAD) -> list[bool]:
    """Which faint ones of *now* count, between two frames with vehicles."""
    taken, faint = [candidates(before), candidates([]), candidates(after)], [candidates([]), now, candidates([])]
    due = seen_again(taken, faint, [np.eye(3)] * 3, np.array([0.0, 1.5, 3.0]), place, params=PARAMS)
    return due[1].tolist()


@pytest.mark.parametrize("step_m", [0.0, 6.0, 18.0, -18.0])
def test_a_faint_body_on_the_way_of_one_vehicle_is_that_vehicle(step_m: float) -> None:
    now = candidates([(60.0, 20.0, 0.0), (60.0, 26.0, 0.0)], WEAK)
    assert again([(60.0 - step_m, 20.0, 0.0)], now, [(60.0 + step_m, 20.2, 0.0)]) == [True, False]


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ([], [(60.0, 20.0, 0.0)]),
        ([(60.0, 20.0, 0.0)], []),
        ([(60.0, 20.0, 0.0)], [(78.0, 20.0, 0.0)]),
        ([(60.0, 8.0, 0.0)], [(60.0, 32.0, 0.0)]),
        ([(48.0, 20.0, 90.0)], [(72.0, 20.0, 90.0)]),
    ],
)
def test_what_is_not_due_in_both_neighbours_is_noise(before: Boxes, after: Boxes) -> None:
    """Neighbours on one side alone, at an uneven pace, aside of their axes, or turned away from the box."""
    assert again(before, candidates([(60.0, 20.0, 0.0)], WEAK), after) == [False]


def test_another_paint_no_road_or_a_part_of_a_box_is_not_enough() -> None:
    one = [(60.0, 20.0, 0.0)]
    assert again(one, candidates(one, WEAK), one) == [True]
    assert again(one, candidates(one, WEAK, paint=120.0 + PARAMS.chain_colour + 1), one) == [False]
    cut = replace(candidates(one, WEAK), flags=np.full(1, int(DetectionFlag.TOUCHES_BORDER), np.int32))
    assert again(one, cut, one) == [False]
    nowhere = replace(ROAD, road=np.zeros((80, 400), np.bool_))
    assert again(one, candidates(one, WEAK), one, place=nowhere) == [False]
    assert again(one, candidates(one, WEAK), one, place=replace(ROAD, learned=False)) == [False]


def test_uneven_intervals_and_moving_platforms_are_reckoned_with() -> None:
    """At 8 m/s, seen after 0, 0.5 and 3 s; the platform drifts by 40 px a frame; frames come in any order."""
    times = np.array([0.0, 0.5, 3.0])
    poses = [np.array([[1.0, 0.0, 40.0 * i], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) for i in range(3)]
    cars = [candidates([(60.0 + 8 * t - 40 * i * GSD[0], 20.0, 0.0)]) for i, t in enumerate(times)]
    none = candidates([])
    for order in ([0, 1, 2], [2, 0, 1]):
        taken = [none if i == 1 else cars[i] for i in order]
        faint = [cars[i] if i == 1 else none for i in order]
        due = seen_again(taken, faint, [poses[i] for i in order], times[order], ROAD, params=PARAMS)
        assert [part.tolist() for part in due] == [[True] if i == 1 else [] for i in order]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_frames_stay_as_they_are(count: int) -> None:
    faint = [candidates([(60.0, 20.0, 0.0)], WEAK)] * count
    due = seen_again(faint, faint, [np.eye(3)] * count, np.arange(float(count)), ROAD, params=PARAMS)
    assert [part.tolist() for part in due] == [[False]] * count
