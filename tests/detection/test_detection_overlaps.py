"""Of boxes that lie on each other the best remains; neighbours in a queue and in the next lane are left alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from vtrack_batch.detection.overlaps import stand_alone

PX_PER_M = (3.0, 2.5)


def box(x_m: float, y_m: float, length_m: float, width_m: float, turn_deg: float = 0.0) -> list[float]:
    """Return column, row and half axes in px of a box in metres."""
    turn = np.radians(turn_deg)
    along = np.array([np.cos(turn), np.sin(turn)]) * length_m / 2
    across = np.array([-np.sin(turn), np.cos(turn)]) * width_m / 2
    return [float(v * s) for part in ((x_m, y_m), along, across) for v, s in zip(part, PX_PER_M, strict=True)]


def alone(*boxes: list[float], score: list[float]) -> NDArray[np.bool_]:
    return stand_alone(np.array(boxes), np.array(score), PX_PER_M)


def test_queue_and_next_lane_remain() -> None:
    queue = [box(5.0 * i, 2.1 * lane, 4.5, 1.9) for i in range(4) for lane in range(3)]
    assert alone(*queue, score=list(np.linspace(0.5, 1.2, 12))).all()


@pytest.mark.parametrize("turn_deg", [0.0, 40.0, 90.0])
def test_what_lies_on_a_better_lorry_goes(turn_deg: float) -> None:
    lorry, cab = box(20.0, 20.0, 12.0, 2.5, 30.0), box(24.0, 22.0, 4.4, 1.8, 30.0 + turn_deg)
    assert alone(lorry, cab, score=[0.9, 0.6]).tolist() == [True, False]
    assert alone(cab, lorry, score=[0.6, 0.9]).tolist() == [False, True]


def test_a_long_vehicle_takes_what_a_car_may_share() -> None:
    """A tenth lies on the other: bumpers of cars in a dense queue may, the last metre of a lorry may not."""
    car, lorry, behind = box(0.0, 0.0, 4.4, 1.8), box(-3.8, 0.0, 12.0, 2.5), box(3.96, 0.0, 4.4, 1.8)
    assert alone(car, behind, score=[0.9, 0.6]).tolist() == [True, True]
    assert alone(lorry, box(3.96, 0.0, 4.4, 1.8), score=[0.9, 0.6]).tolist() == [True, False]


def test_order_of_boxes_does_not_matter() -> None:
    rng = np.random.default_rng(4)
    boxes = np.array(
        [box(*rng.uniform(0, 30, 2), *((12.0, 2.5) if i % 3 else (4.4, 1.8)), 17.0 * i) for i in range(40)]
    )
    score, order = rng.uniform(0.5, 1.2, 40), rng.permutation(40)
    kept = stand_alone(boxes, score, PX_PER_M)
    assert 5 < kept.sum() < 30
    np.testing.assert_array_equal(stand_alone(boxes[order], score[order], PX_PER_M), kept[order])


def test_none_and_one() -> None:
    assert stand_alone(np.zeros((0, 6)), np.zeros(0), PX_PER_M).shape == (0,)
    assert alone(box(0, 0, 4, 2), score=[0.5]).tolist() == [True]
