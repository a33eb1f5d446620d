from __future__ import annotations

import cv2
import numpy as np
import pytest

from vtrack_batch.background.learn import Background, Sample, learn_background
from vtrack_batch.background.params import BackgroundParams
from vtrack_batch.detection.candidates import Candidates, find_candidates
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.model.flags import DetectionFlag

HEIGHT, WIDTH = 180, 310
PARAMS = DetectionParams()
GSD = (0.33, 0.33)


def land() -> np.ndarray:
    rng = np.random.default_rng(4)
    coarse = cv2.resize(rng.normal(0, 6, (18, 31, 3)), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return np.array([108.0, 112.0, 104.0]) + coarse + rng.normal(0, 1.5, (HEIGHT, WIDTH, 1))


def paint(
    picture: np.ndarray,
    centre: tuple[float, float],
    size_m: tuple[float, float],
    angle_deg: float,
    colour: tuple[int, int, int],
    gsd: tuple[float, float] = GSD,
    shade: float | None = None,
) -> None:
    """Draw a vehicle, *angle_deg* from right to down, anti-aliased; *shade* = ratio of its shadow (down, right)."""
    for offset, ratio in (((1.2, 1.2), shade), ((0.0, 0.0), None)):
        if ratio is None and offset[0] > 0:
            continue
        fine = 8
        rows, columns = _fine_grid(centre, fine)
        x = (columns - centre[0]) * gsd[0] - offset[0]
        y = (rows - centre[1]) * gsd[1] - offset[1]
        turn = np.radians(angle_deg)
        along, across = x * np.cos(turn) + y * np.sin(turn), -x * np.sin(turn) + y * np.cos(turn)
        inside = (np.abs(along) <= size_m[0] / 2) & (np.abs(across) <= size_m[1] / 2)
        reach = inside.shape[0] // fine
        share = inside.reshape(reach, fine, reach, fine).mean(axis=(1, 3))[:, :, None]
        top, left = round(centre[1]) - reach // 2, round(centre[0]) - reach // 2
        r0, c0, r1, c1 = max(0, top), max(0, left), min(HEIGHT, top + reach), min(WIDTH, left + reach)
        share = share[r0 - top : r1 - top, c0 - left : c1 - left]
        part = picture[r0:r1, c0:c1]
        part[:] = (1 - share) * part + share * (np.array(colour, float) if ratio is None else part * ratio)


def _fine_grid(centre: tuple[float, float], fine: int, reach: int = 80) -> tuple[np.ndarray, np.ndarray]:
    step = (np.arange(reach * fine) + 0.5) / fine - 0.5 - reach // 2
    return np.meshgrid(step + round(centre[1]), step + round(centre[0]), indexing="ij")


def shot(picture: np.ndarray, seed: int) -> np.ndarray:
    return np.clip(picture + np.random.default_rng(seed).normal(0, 1.5, picture.shape), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def background() -> Background:
    samples = [Sample(shot(land(), 50 + i), np.eye(3)) for i in range(5)]
    return learn_background(samples, params=BackgroundParams())


def look(picture: np.ndarray, background: Background, pose: np.ndarray | None = None) -> Candidates:
    found = find_candidates(
        shot(picture, 7), np.eye(3) if pose is None else pose, background, metres_per_px=GSD, params=PARAMS
    )
    return found.take(found.score >= PARAMS.strict_score)


def axis_deg(found: Candidates) -> np.ndarray:
    return np.degrees(np.arctan2(found.ly_px, found.lx_px)) % 180


def test_empty_road_gives_nothing(background: Background) -> None:
    found = look(land(), background)
    assert len(found) == 0
    assert found.flags.dtype == np.int32


@pytest.mark.parametrize("angle", [0, 30, 75, 90, 135])
@pytest.mark.parametrize("colour", [(235, 235, 230), (25, 25, 30), (160, 30, 30)])
def test_one_car_is_found_where_it_is(background: Background, angle: int, colour: tuple[int, int, int]) -> None:
    picture = land()
    paint(picture, (201.3, 64.6), (4.4, 1.8), angle, colour)
    found = look(picture, background)
    assert len(found) == 1
    assert np.hypot(found.col_px[0] - 201.3, found.row_px[0] - 64.6) < 0.8
    assert abs((axis_deg(found)[0] - angle + 90) % 180 - 90) <= 8
    assert 3.7 < 2 * np.hypot(found.lx_px[0], found.ly_px[0]) * 0.33 < 5.7
    assert np.abs(np.array([found.red[0], found.green[0], found.blue[0]]) - colour).max() < 14
    assert 0.6 < found.area_px[0] * 0.33**2 / (4.4 * 1.8) < 1.5
    assert found.flags[0] == 0


@pytest.mark.parametrize("size", [(8.4, 2.5), (12.0, 2.5), (16.8, 2.6)])
def test_lorry_is_one_box(background: Background, size: tuple[float, float]) -> None:
    picture = land()
    paint(picture, (150.0, 90.4), size, 15, (200, 205, 210))
    found = look(picture, background)
    assert len(found) == 1
    assert np.hypot(found.col_px[0] - 150, found.row_px[0] - 90.4) < 3
    assert 0.8 < 2 * np.hypot(found.lx_px[0], found.ly_px[0]) * 0.33 / size[0] < 1.25


def test_queue_is_split_into_its_cars(background: Background) -> None:
    picture = land()
    places = [(60 + 19.5 * i, 80.0 + 9.5 * lane) for i in range(8) for lane in range(2)]
    colours = [(240, 240, 240), (30, 30, 30), (170, 20, 20), (30, 50, 150), (190, 190, 185)]
    for i, place in enumerate(places):
        paint(picture, place, (4.4, 1.8), 0, colours[i % 5])
    found = look(picture, background)
    assert len(found) == len(places)
    distance = np.hypot(found.col_px[:, None] - np.array(places)[:, 0], found.row_px[:, None] - np.array(places)[:, 1])
    assert distance.min(axis=0).max() < 2


def test_windscreen_does_not_cut_a_car(background: Background) -> None:
    picture = land()
    paint(picture, (120.0, 60.0), (4.6, 1.8), 90, (230, 230, 230))
    paint(picture, (120.0, 57.0), (0.8, 1.5), 90, (40, 45, 50))
    found = look(picture, background)
    assert len(found) == 1
    assert found.red[0] > 200


def shaded_background(places: list[tuple[int, int]]) -> Background:
    """Twelve samples with vehicles at *places*, further on in each, that cast shadows."""
    samples = []
    for i in range(12):
        picture = land()
        for n, (column, row) in enumerate(places):
            colour = (225, 228, 225) if n % 2 else (150, 30, 40)
            paint(picture, ((column + 26 * i) % 290 + 5, row), (4.4, 1.8), 0, colour, shade=0.48)
        samples.append(Sample(shot(picture, i), np.eye(3)))
    return learn_background(samples, params=BackgroundParams())


def test_shadow_is_not_a_vehicle() -> None:
    places = [(30 + 45 * i, 25 + 32 * lane) for i in range(6) for lane in range(5)]
    background = shaded_background(places)
    picture = land()
    for column, row in places:
        paint(picture, (column, row), (4.4, 1.8), 0, (225, 228, 225), shade=0.48)
    found = look(picture, background)
    assert background.shadows.ratio is not None
    assert len(found) == len(places)
    offset = np.array([found.col_px - np.round((found.col_px - 30) / 45) * 45 - 30])
    assert np.abs(offset).max() < 2


@pytest.mark.parametrize("angle", [0, 35, 90])
def test_paint_as_dark_as_shadow_is_a_vehicle_and_the_shadow_of_another_is_not(angle: int) -> None:
    """Nothing casts what lies there alone; beside a white car the same darkness is its shadow."""
    background = shaded_background([(30 + 45 * i, 25 + 32 * lane) for i in range(6) for lane in range(5)])
    assert background.shadows.ratio is not None
    scene = land()
    dark = tuple((np.array([108.0, 112.0, 104.0]) * background.shadows.ratio).tolist())
    paint(scene, (90, 90), (4.5, 1.8), angle, dark, shade=0.48)
    paint(scene, (220, 90), (4.5, 1.8), angle, (225, 225, 225), shade=0.48)
    found = look(scene, background)
    places_px = np.stack([found.col_px, found.row_px], axis=1)
    assert np.hypot(*(places_px - [[90, 90], [220, 90]]).T).max() < 2.5
    assert len(found) == 2


def test_frame_is_read_through_its_pose(background: Background) -> None:
    picture = land()
    paint(picture, (180.0, 90.0), (4.4, 1.8), 0, (235, 235, 230))
    turn = np.radians(20)
    to_reference = np.array([[np.cos(turn), -np.sin(turn), 40], [np.sin(turn), np.cos(turn), -35], [0, 0, 1.0]])
    moved = cv2.warpPerspective(
        picture, to_reference, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderValue=(0, 0, 0)
    )
    found = look(moved, background, to_reference)
    wanted = np.linalg.solve(to_reference, [180.0, 90.0, 1.0])
    assert len(found) == 1
    assert np.hypot(found.col_px[0] - wanted[0], found.row_px[0] - wanted[1]) < 1
    assert abs((axis_deg(found)[0] + 20 + 90) % 180 - 90) <= 8


def test_unequal_scales_along_columns_and_rows() -> None:
    gsd = (0.5, 0.25)
    samples = [Sample(shot(land(), 50 + i), np.eye(3)) for i in range(5)]
    background = learn_background(samples, params=BackgroundParams())
    picture = land()
    paint(picture, (140.0, 95.0), (5.0, 2.0), 90, (235, 235, 230), gsd)
    paint(picture, (200.0, 95.0), (5.0, 2.0), 0, (235, 235, 230), gsd)
    found = find_candidates(shot(picture, 7), np.eye(3), background, metres_per_px=gsd, params=PARAMS)
    found = found.take(found.score >= PARAMS.strict_score)
    assert len(found) == 2
    upright, level = np.argsort(found.col_px)
    assert 15 < 2 * abs(found.ly_px[upright]) < 25
    assert 8 < 2 * abs(found.lx_px[level]) < 13


def test_fine_frames_are_reduced_and_places_kept() -> None:
    samples = [Sample(shot(land(), 50 + i), np.eye(3)) for i in range(5)]
    background = learn_background(samples, params=BackgroundParams())
    picture = land()
    gsd = (0.12, 0.12)
    paint(picture, (141.0, 95.0), (4.4, 1.8), 0, (235, 235, 230), gsd)
    found = find_candidates(shot(picture, 7), np.eye(3), background, metres_per_px=gsd, params=PARAMS)
    found = found.take(found.score >= PARAMS.strict_score)
    assert len(found) == 1
    assert np.hypot(found.col_px[0] - 141, found.row_px[0] - 95) < 2


def test_car_at_the_border_is_flagged(background: Background) -> None:
    picture = land()
    paint(picture, (3.0, 90.0), (4.4, 1.8), 0, (235, 235, 230))
    found = look(picture, background)
    assert len(found) == 1
    assert found.flags[0] & DetectionFlag.TOUCHES_BORDER


def test_same_picture_gives_same_bytes(background: Background) -> None:
    picture = land()
    for i in range(6):
        paint(picture, (40.0 + 41 * i, 90.0), (4.4, 1.8), 20 * i, (235, 235, 230))
    one, other = look(picture, background), look(picture, background)
    assert one.col_px.tobytes() == other.col_px.tobytes()
    assert one.score.tobytes() == other.score.tobytes()
    assert (np.diff(one.row_px) >= 0).all()
