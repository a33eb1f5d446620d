from __future__ import annotations

import numpy as np
import pytest

from vtrack_batch.detection.candidates import Candidates
from vtrack_batch.detection.lanes import learn_lanes
from vtrack_batch.detection.params import DetectionParams

PARAMS = DetectionParams()
SHAPE = (400, 700)
GSD = (0.3, 0.3)


def cars(places: list[tuple[float, float]], angle_deg: float, score: float = 0.95) -> Candidates:
    """Cars at *places* (column, row) px that lie at *angle_deg* from right to down."""
    at, turn, n = np.array(places, float).reshape(-1, 2), np.radians(angle_deg), len(places)
    nothing = np.zeros(n)
    return Candidates(
        col_px=at[:, 0], row_px=at[:, 1],
        lx_px=np.full(n, 7 * np.cos(turn)), ly_px=np.full(n, 7 * np.sin(turn)),
        wx_px=np.full(n, -3 * np.sin(turn)), wy_px=np.full(n, 3 * np.cos(turn)),
        area_px=nothing, red=nothing, green=nothing, blue=nothing, contrast=nothing,
        score=np.full(n, score), flags=np.zeros(n, np.int32),
    )  # fmt: skip


ROAD = [(80.0 + 25 * k, 200.0) for k in range(20)]


def tried(found: list[Candidates], place: tuple[float, float], pose: np.ndarray | None = None) -> set[int]:
    """Directions in degrees that are tried at *place* of a frame with *pose*."""
    lanes = learn_lanes(found, [np.eye(3)] * len(found), SHAPE, metres_per_px=GSD, params=PARAMS)
    at = np.eye(3) if pose is None else pose
    rows = lanes.tried_in(at)(np.array([place]))[0]
    return {round(180 / PARAMS.directions * d) for d in np.flatnonzero(rows)}


def test_along_a_road_only_its_direction_is_tried() -> None:
    assert tried([cars(ROAD, 0.0)] * 4, (300.0, 205.0)) == {0, 15, 30, 150, 165}
    assert tried([cars(ROAD, 92.0)] * 4, (300.0, 205.0)) == {60, 75, 90, 105, 120}


def test_front_and_back_are_one() -> None:
    assert tried([cars(ROAD, 40.0)] * 4, (300.0, 205.0)) == tried([cars(ROAD, 220.0)] * 4, (300.0, 205.0))


def test_far_from_all_vehicles_every_direction_is_tried() -> None:
    assert len(tried([cars(ROAD, 0.0)] * 4, (300.0, 30.0))) == PARAMS.directions


@pytest.mark.parametrize("found", [[], [cars([], 0.0)], [cars(ROAD, 0.0, score=0.6)] * 9, [cars(ROAD[:1], 0.0)]])
def test_few_or_weak_boxes_tell_nothing(found: list[Candidates]) -> None:
    assert len(tried(found, (300.0, 205.0))) == PARAMS.directions


def test_a_box_aslant_changes_nothing_but_crossing_traffic_does() -> None:
    along = [cars(ROAD, 0.0)] * 4
    assert tried([*along, cars(ROAD[9:10], 70.0)], (300.0, 205.0)) == {0, 15, 30, 150, 165}
    crossing = tried([*along, *[cars(ROAD[7:12], 90.0)] * 4], (305.0, 205.0))
    assert {0, 15, 165, 75, 90, 105} <= crossing
    assert len(crossing) < PARAMS.directions


def test_where_vehicles_lie_in_all_directions_all_are_tried() -> None:
    everywhere = [cars(ROAD, 15.0 * k) for k in range(12)]
    assert len(tried(everywhere, (300.0, 205.0))) == PARAMS.directions


def test_order_of_frames_changes_nothing() -> None:
    frames = [cars(ROAD[k : k + 6], 10.0 * k) for k in range(12)]
    one, other = (
        learn_lanes(found, [np.eye(3)] * 12, SHAPE, metres_per_px=GSD, params=PARAMS).tried
        for found in (frames, frames[::-1])
    )
    np.testing.assert_array_equal(one, other)
    assert one.any(axis=2).all()


def test_directions_turn_with_the_frame() -> None:
    """A frame turned by 30 degrees shows the road of the reference turned back by as much."""
    turn = np.radians(30.0)
    pose = np.array([[np.cos(turn), -np.sin(turn), 250.0], [np.sin(turn), np.cos(turn), 60.0], [0, 0, 1.0]])
    place = np.linalg.solve(pose, np.array([300.0, 205.0, 1.0]))
    assert tried([cars(ROAD, 0.0)] * 4, (place[0], place[1]), pose) == {0, 120, 135, 150, 165}
