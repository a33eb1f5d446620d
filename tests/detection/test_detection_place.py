from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vtrack_batch.detection.candidates import Candidates
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.detection.place import Place, flag_outside, learn_place, select
from vtrack_batch.model.flags import DetectionFlag

PARAMS = DetectionParams()
GSD = (0.4, 0.25)


def candidates(rows: list[tuple[float, float, float, float]]) -> Candidates:
    """Make candidates from (x_m, y_m, angle_deg from right to down, score); colours go with the score."""
    x, y, angle, score = np.array(rows, float).reshape(-1, 4).T
    turn = np.radians(angle)
    flat = np.full(len(x), 120.0)
    return Candidates(
        col_px=x / GSD[0],
        row_px=y / GSD[1],
        lx_px=2.2 * np.cos(turn) / GSD[0],
        ly_px=2.2 * np.sin(turn) / GSD[1],
        wx_px=-0.9 * np.sin(turn) / GSD[0],
        wy_px=0.9 * np.cos(turn) / GSD[1],
        area_px=flat,
        red=flat,
        green=flat,
        blue=flat,
        contrast=flat,
        score=score,
        flags=np.zeros(len(x), np.int32),
    )


def archive(
    count: int = 8, interval_s: float = 1.0, roofs: int = 6
) -> tuple[list[Candidates], list[np.ndarray], np.ndarray]:
    """Cars at 12 m/s along y = 20 m and x = 90 m, one weak car on the road, roofs that drift, one weak thing beside."""
    frames = []
    for i in range(count):
        t = i * interval_s
        rows = [(10 + 12 * t + 30 * n, 20.0, 0.0, 0.9) for n in range(2)]
        rows += [(90.0, 10 + 12 * t + 35 * n, 90.0, 0.9) for n in range(2)]
        rows += [(60.0, 20.5, 2.0, 0.52), (30.0, 90.0, 0.0, 0.52)]
        rows += [(40 + 0.8 * t + 3 * n, 60.0 + 7 * n, 20.0 * n, 0.95) for n in range(roofs)]
        frames.append(candidates(rows))
    return frames, [np.eye(3)] * count, np.arange(count) * interval_s


def learn(frames: list[Candidates], poses: list[np.ndarray], times: np.ndarray) -> Place:
    return learn_place(frames, poses, times, metres_per_px=GSD, params=PARAMS)


def test_road_lies_where_cars_drive_fast() -> None:
    place = learn(*archive())
    assert place.learned
    on = place.on_road(np.array([[60.0, 20.0], [60, 22], [60, 35], [90, 60], [40, 60], [30, 90], [-500, 20]]))
    assert on.tolist() == [True, True, False, True, False, False, False]


def test_weak_ones_count_on_the_road_and_strong_ones_do_not_elsewhere() -> None:
    frames, poses, times = archive()
    place = learn(frames, poses, times)
    for i in (2, 5):
        kept = select(frames[i], poses[i], place, frame=i, params=PARAMS)
        assert kept.tolist() == [True] * 5 + [False] * 7


@pytest.mark.parametrize("lit", [0.5, 1.0])
def test_chains_over_roofs_are_told_by_the_hue_of_the_ground(lit: float) -> None:
    """Cars along x = 90 m drive over red tiles, for a quarter or for most of their way; the others over asphalt."""
    frames, poses, times = archive()
    for tiles_m, road in ((25.0, True), (100.0, False)):
        ground = np.full((480, 500, 4), (120, 122, 125, 9), np.uint8)
        ground[: round(tiles_m / GSD[1]), round(85 / GSD[0]) : round(95 / GSD[0])] = (190, 95, 70, 9)
        ground = (ground * lit).astype(np.uint8)
        place = learn_place(frames, poses, times, metres_per_px=GSD, params=PARAMS, ground=ground)
        assert place.on_road(np.array([[60.0, 20.0], [90.0, 60.0]])).tolist() == [True, road]
    plain = learn_place(frames, poses, times, metres_per_px=GSD, params=PARAMS, ground=np.full_like(ground, 90))
    assert (plain.road == learn(frames, poses, times).road).all()


@pytest.mark.parametrize("interval", [0.1, 0.5, 1.5])
def test_any_rate_of_frames(interval: float) -> None:
    frames, poses, times = archive(count=round(8 / interval), interval_s=interval)
    place = learn(frames, poses, times)
    assert place.learned
    assert place.on_road(np.array([[60.0, 20.0], [40.0, 60.0]])).tolist() == [True, False]


def test_order_in_which_frames_come_does_not_matter() -> None:
    frames, poses, times = archive()
    order = [3, 0, 7, 1, 6, 2, 5, 4]
    one = learn(frames, poses, times)
    other = learn([frames[i] for i in order], [poses[i] for i in order], times[order])
    assert (one.road == other.road).all()
    assert (one.origin_m == other.origin_m).all()
    assert all((one.chained[i] == other.chained[n]).all() for n, i in enumerate(order))


def test_few_strong_ones_off_the_road_are_believed() -> None:
    frames, poses, times = archive(roofs=2)
    place = learn(frames, poses, times)
    kept = select(frames[2], poses[2], place, frame=2, params=PARAMS)
    assert kept.tolist() == [True] * 5 + [False] + [True] * 2


def test_off_the_road_is_flagged_where_a_road_was_learned() -> None:
    frames, poses, times = archive(roofs=2)
    place = learn(frames, poses, times)
    flags = flag_outside(frames[2], poses[2], place).flags
    assert (flags & DetectionFlag.OUTSIDE_ROAD > 0).tolist() == [False] * 5 + [True] * 3
    assert (flags & ~DetectionFlag.OUTSIDE_ROAD).tolist() == frames[2].flags.tolist()
    unlearned = learn(frames[:1], poses[:1], times[:1])
    assert flag_outside(frames[0], poses[0], unlearned).flags.tolist() == frames[0].flags.tolist()


def test_poses_are_taken_out() -> None:
    frames, poses, times = archive()
    shaken = [np.array([[1.0, 0, 7.0 * i], [0, 1, -4.0 * i], [0, 0, 1]]) for i in range(len(frames))]
    moved = []
    for found, pose in zip(frames, shaken, strict=True):
        fields = {name: getattr(found, name) for name in found.__dataclass_fields__}
        moved.append(Candidates(**fields | {"col_px": found.col_px - pose[0, 2], "row_px": found.row_px - pose[1, 2]}))
    still, shaky = learn(frames, poses, times), learn(moved, shaken, times)
    assert (still.road == shaky.road).mean() > 0.99


def test_creeping_jam_teaches_the_road_too() -> None:
    frames = [candidates([(20 + 2.0 * t + 9 * n, 30.0, 0.0, 0.9) for n in range(5)]) for t in np.arange(12) * 0.5]
    place = learn(frames, [np.eye(3)] * 12, np.arange(12) * 0.5)
    assert place.learned
    assert place.on_road(np.array([[40.0, 30.0]])).all()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_frames_fall_back_to_strict_ones(count: int) -> None:
    frames, poses, times = archive(count)
    place = learn(frames, poses, times)
    assert not place.learned
    kept = select(frames[0], poses[0], place, frame=0, params=PARAMS)
    assert kept.tolist() == [True] * 4 + [False] * 2 + [True] * 6


def test_empty_frames_are_no_trouble() -> None:
    place = learn([candidates([])] * 6, [np.eye(3)] * 6, np.arange(6.0))
    assert not place.learned
    assert len(select(candidates([]), np.eye(3), place, frame=2, params=PARAMS)) == 0


def test_one_frame_shown_again_and_again_makes_no_chain() -> None:
    frame = candidates([(40.0, 40.0, 0.0, 0.9), (43.2, 40.0, 0.0, 0.9)])
    place = learn([frame] * 7, [np.eye(3)] * 7, np.arange(7.0))
    assert not place.learned
    assert all(len(rows) == 0 for rows in place.chained)


def test_chains_that_end_with_a_stop_teach_the_road_as_well() -> None:
    places = (40.0, 43.2, 46.4, 46.4)
    frames = [candidates([(x, 20.0 + 8.0 * n, 0.0, 0.9) for n in range(6)]) for x in places]
    place = learn(frames, [np.eye(3)] * 4, np.arange(4.0))
    assert place.learned
    assert place.on_road(np.array([[43.0, 36.0], [43.0, 90.0]])).tolist() == [True, False]


@pytest.mark.parametrize(
    ("half_m", "angle", "kept"), [(2.2, 0.0, True), (2.2, 90.0, True), (8.5, 0.0, True), (8.5, 60.0, False)]
)
def test_a_vehicle_lies_on_the_road_from_front_to_back(half_m: float, angle: float, kept: bool) -> None:
    place = learn(*archive())
    one = candidates([(60.0, 20.5, angle, 0.52)])
    longer = half_m / 2.2
    one = replace(one, lx_px=one.lx_px * longer, ly_px=one.ly_px * longer)
    assert select(
        one, np.eye(3), replace(place, chained=(np.zeros(0, np.int64),)), frame=0, params=PARAMS
    ).tolist() == [kept]


@pytest.mark.parametrize(
    ("half_m", "cut", "chained", "kept"),
    [(2.2, True, False, True), (8.5, True, False, False), (8.5, True, True, True), (8.5, False, False, True)],
)
def test_a_long_body_that_the_border_cuts_must_drive(half_m: float, cut: bool, chained: bool, kept: bool) -> None:
    """A car may wait at the border; a lorry that is cut there and never drives may be the corner of a roof."""
    one = candidates([(60.0, 20.5, 0.0, 0.9)])
    flags = np.full(1, int(DetectionFlag.TOUCHES_BORDER) * cut, np.int32)
    one = replace(one, lx_px=one.lx_px * half_m / 2.2, flags=flags)
    place = replace(learn(*archive()), chained=(np.arange(int(chained)),))
    assert select(one, np.eye(3), place, frame=0, params=PARAMS).tolist() == [kept]
