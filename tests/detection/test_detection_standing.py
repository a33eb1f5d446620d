"""Vehicles that stand in the background: found by what moving ones look like, where they are, and nowhere else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest

from vtrack_batch.background.learn import Background
from vtrack_batch.background.shadow import Shadows
from vtrack_batch.detection.appearance import CHANNELS, LONG, WIDE, describe, learn_appearance
from vtrack_batch.detection.candidates import Candidates
from vtrack_batch.detection.examples import Examples
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.detection.place import Place
from vtrack_batch.detection.plausible import Driven, plausible
from vtrack_batch.detection.standing import Standing, find_standing, moving_boxes, with_standing
from vtrack_batch.model.flags import DetectionFlag

HEIGHT, WIDTH, GSD_M = 240, 420, 0.3
SCALE = (GSD_M, GSD_M)
PARAMS = DetectionParams()
PAINTS = ((230, 230, 225), (35, 36, 40), (150, 30, 30), (40, 60, 150), (185, 188, 190), (70, 75, 70))
PARKED = ((60.0, 92.0, 0.0), (150.0, 150.0, 0.0), (240.0, 92.0, 8.0), (330.0, 150.0, 0.0))


def land() -> np.ndarray:
    """Grass, a grey road along the rows 85..155 with markings, arrows and a zebra crossing."""
    rng = np.random.default_rng(3)
    image = np.empty((HEIGHT, WIDTH, 3))
    image[:] = (95, 120, 70)
    image[85:156] = (112, 113, 116)
    image[120:122, (np.arange(WIDTH) // 20) % 2 == 0] = 215
    image[104:106, 280:296] = image[100:110, 290:292] = 215
    for row in range(86, 155, 6):
        image[row : row + 3, 380:392] = 220
    image += cv2.GaussianBlur(rng.normal(0, 14, (HEIGHT, WIDTH, 1)).astype(np.float32), (0, 0), 1.2)[:, :, None]
    return np.clip(image, 0, 255).astype(np.uint8)


def draw(image: np.ndarray, col: float, row: float, deg: float, paint: tuple[int, int, int]) -> None:
    """A car of 4.5 x 1.8 m with its two dark windows, edges one pixel soft."""
    c, s = np.cos(np.radians(deg)), np.sin(np.radians(deg))
    mask = np.zeros(image.shape[:2], np.uint8)
    for first, last, half, colour in (
        (-2.25, 2.25, 0.9, paint),
        (0.4, 1.1, 0.75, (30, 32, 36)),
        (-1.7, -1.2, 0.75, (30, 32, 36)),
    ):
        corners = np.array([[first, -half], [last, -half], [last, half], [first, half]]) / GSD_M
        at = corners @ np.array([[c, s], [-s, c]]) + (col, row)
        mask[:] = 0
        cv2.fillConvexPoly(mask, np.rint(at * 16).astype(np.int32), 255, shift=4, lineType=cv2.LINE_AA)
        share = mask[:, :, None] / 255.0
        image[:] = (image * (1 - share) + np.array(colour) * share).astype(np.uint8)


def candidates(places: list[tuple[float, float, float]], score: float = 0.9) -> Candidates:
    at = np.array(places, float).reshape(-1, 3)
    turn = np.radians(at[:, 2])
    along, across = 2.25 / GSD_M, 0.9 / GSD_M
    zeros = np.zeros(len(at))
    return Candidates(
        at[:, 0], at[:, 1], along * np.cos(turn), along * np.sin(turn), -across * np.sin(turn), across * np.cos(turn),
        zeros + 90, zeros + 100, zeros + 100, zeros + 100, zeros + 60, zeros + score, zeros.astype(np.int32),
    )  # fmt: skip


def block(
    parked: tuple[tuple[float, float, float], ...], paved: slice = slice(0)
) -> tuple[Background, Examples, Place]:
    """A background with *parked* cars and 24 frames with three moving cars each, which are the place's chains.

    Some rows may be *paved* beside the road.
    """
    empty = land()
    empty[paved, 160:280] = (112, 113, 116)
    for k, place in enumerate(parked):
        draw(empty, *place, PAINTS[k % len(PAINTS)])
    examples, chained = Examples.of(24), []
    for i in range(24):
        frame = empty.copy()
        cars = [(20.0 + 15 * i, 110.0, 0.0), (400.0 - 15 * i, 132.0, 180.0), (30.0 + 13 * i, 132.5, 0.0)]
        cars = [cars[0], cars[1]] if abs(cars[1][0] - cars[2][0]) < 40 else cars
        for k, car in enumerate(cars):
            draw(frame, *car, PAINTS[(i // 3 + 2 * k) % len(PAINTS)])
        examples.add(i, frame, candidates(cars), SCALE, PARAMS)
        chained.append(np.arange(len(cars)))
    road = np.zeros((int(HEIGHT * GSD_M * 2), int(WIDTH * GSD_M * 2)), bool)
    road[int(98 * GSD_M * 2) : int(144 * GSD_M * 2)] = True
    levels = np.dstack([empty, np.full(empty.shape[:2], 4, np.uint8)])
    background = Background(levels, Shadows(None), 31, 0.35)
    return background, examples, Place(road, np.zeros(2), SCALE, True, False, tuple(chained))


@pytest.fixture(scope="module")
def street() -> tuple[Background, Examples, Place]:
    return block(PARKED)


def look(street: tuple[Background, Examples, Place], driven: Sequence[Driven] = (), **changes: object) -> Standing:
    params = PARAMS.model_copy(update=changes)
    return find_standing(*street, driven, metres_per_px=SCALE, params=params)


def test_parked_cars_are_found_where_they_stand(street: tuple[Background, Examples, Place]) -> None:
    found = look(street)
    away = np.linalg.norm(found.boxes[:, None, :2] - np.array(PARKED)[None, :, :2], axis=2) * GSD_M
    assert (away.min(axis=0) < 1.0).all()
    assert len(found.score) == len(PARKED)
    length = 2 * GSD_M * np.linalg.norm(found.boxes[:, 2:4], axis=1)
    assert ((length > 4.2) & (length < 4.8)).all()


def test_an_empty_road_with_paint_on_it_holds_none() -> None:
    assert len(look(block(())).score) == 0


@pytest.mark.parametrize(("until_row", "more"), [(81, 0), (90, 1)])
def test_grey_ground_counts_where_it_leads_to_the_road(until_row: int, more: int) -> None:
    found = look(block((*PARKED[:2], (215.0, 73.0, 0.0)), slice(50, until_row)))
    assert len(found.score) == 2 + more


@pytest.mark.parametrize(("beside_m", "frames", "left"), [(0, 2, 1), (0, 1, 0), (3.0, 9, 0)])
def test_nothing_stands_where_others_drive(
    street: tuple[Background, Examples, Place], beside_m: float, frames: int, left: int
) -> None:
    shift = np.array([[1.0, 0.0, 7.0], [0.0, 1.0, -2.0], [0.0, 0.0, 1.0]])
    col_px, row_px, heading = PARKED[0]
    passing = candidates([(col_px - 7 + 2, row_px + 2 + beside_m / GSD_M, heading)])
    place = replace(street[2], chained=(np.arange(1),) * frames)
    driven = moving_boxes([passing] * frames, [shift] * frames, place)
    assert len(look(street, driven).score) == len(PARKED) - left


def test_nothing_is_looked_for_without_road_or_examples(street: tuple[Background, Examples, Place]) -> None:
    background, examples, place = street
    assert len(look(street, standing=False).score) == 0
    assert len(look((background, Examples.of(24), place)).score) == 0
    assert len(look((background, examples, replace(place, learned=False))).score) == 0


def test_a_standing_vehicle_is_there_until_its_hole_is_seen(street: tuple[Background, Examples, Place]) -> None:
    standing = look(street)
    pose = np.array([[1.0, 0.0, 5.0], [0.0, 1.0, -3.0], [0.0, 0.0, 1.0]])
    gone = (standing.boxes[0, 0] - 5, standing.boxes[0, 1] + 3, 0.0)
    other = (200.0, 120.0, 0.0)
    found = candidates([gone, other])
    size = (WIDTH, HEIGHT)
    out = with_standing(found, np.array([False, True]), standing, pose, size, SCALE)
    marked = (out.flags & DetectionFlag.IN_BACKGROUND) > 0
    assert marked.sum() == len(PARKED) - 1
    assert (~marked).sum() == 1
    assert np.all(np.diff(out.row_px) >= 0)
    places = np.stack([out.col_px, out.row_px], axis=1)[marked] + (5, -3)
    assert np.linalg.norm(places[:, None] - standing.boxes[None, 1:, :2], axis=2).min(axis=1).max() < 1e-6


def test_what_lies_outside_the_frame_is_not_there(street: tuple[Background, Examples, Place]) -> None:
    standing = look(street)
    pose = np.array([[1.0, 0.0, 10.0 * WIDTH], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    out = with_standing(candidates([]), np.zeros(0, bool), standing, pose, (WIDTH, HEIGHT), SCALE)
    assert len(out) == 0


def test_windows_look_the_same_however_the_picture_is_turned() -> None:
    image = land()
    draw(image, 200.0, 115.0, 0.0, PAINTS[0])
    turned = np.ascontiguousarray(np.rot90(image, -1))
    one = describe(image, np.array([[200.0, 115.0]]), np.array([[1.0, 0.0]]), (1 / GSD_M, 1 / GSD_M))
    other = describe(turned, np.array([[HEIGHT - 1 - 115.0, 200.0]]), np.array([[0.0, 1.0]]), (1 / GSD_M, 1 / GSD_M))
    assert one.shape == (1, CHANNELS, WIDE, LONG)
    assert np.abs(one - other).mean() < 0.02 * one.mean()


def test_the_score_is_one_on_vehicles_and_minus_one_elsewhere() -> None:
    rng = np.random.default_rng(2)
    others = rng.normal(0, 1, (300, CHANNELS, WIDE, LONG)).astype(np.float32)
    vehicles = rng.normal(0, 1, (60, CHANNELS, WIDE, LONG)).astype(np.float32)
    vehicles[:, :, 3:6, 4:12] += 1.5
    looks = learn_appearance(vehicles, others)
    assert looks.score(vehicles).mean() == pytest.approx(1, abs=0.1)
    assert looks.score(others).mean() == pytest.approx(-1, abs=0.1)


def seen(boxes: list[tuple[float, float, float]], moving: int) -> Driven:
    """What a frame shows in reference px; the first so many move."""
    found = candidates(boxes)
    axes = (found.col_px, found.row_px, found.lx_px, found.ly_px, found.wx_px, found.wy_px)
    return Driven(np.stack(axes, axis=1), np.arange(moving))


@pytest.mark.parametrize(("there", "left"), [(range(4, 9), 0), ((0, 1, 4, 5, 6), 1), ((0, 4, 5, 6), 0)])
def test_others_may_drive_there_before_it_came_and_after_it_left(
    street: tuple[Background, Examples, Place], there: Sequence[int], left: int
) -> None:
    """Of twelve frames some show the vehicle, and in all the others somebody drives over its place."""
    col_px, row_px, _ = PARKED[0]
    frames = [seen([] if i in there else [(col_px + 2, row_px, 0.0)], moving=1 - (i in there)) for i in range(12)]
    assert len(look(street, frames).score) == len(PARKED) - left


@pytest.mark.parametrize(("ahead_m", "turn", "left"), [(4.0, 90.0, 1), (4.0, 0.0, 0), (8.0, 90.0, 0)])
def test_nothing_stands_across_the_way_of_others(
    street: tuple[Background, Examples, Place], ahead_m: float, turn: float, left: int
) -> None:
    col_px, row_px, _ = PARKED[0]
    away = ahead_m / GSD_M * np.array([np.cos(np.radians(turn)), -np.sin(np.radians(turn))])
    passing = (col_px + away[0], row_px + away[1], turn)
    frames = [seen([passing] if i in (3, 6) else [], moving=int(i in (3, 6))) for i in range(9)]
    assert len(look(street, frames).score) == len(PARKED) - left


def may_be(street: tuple[Background, Examples, Place], image: np.ndarray, score: float = 1.0) -> bool:
    """Whether a box of a car's size at PARKED[1] may be a vehicle in the picture *image*."""
    boxes = np.array([[*PARKED[1][:2], 2.2 / GSD_M, 0.0, 0.0, 0.9 / GSD_M]])
    return bool(plausible(street[0], image, street[2], boxes, np.array([score]), (1 / GSD_M, 1 / GSD_M))[0])


@pytest.mark.parametrize(("paint", "kept"), [((60, 84, 42), False), ((88, 66, 72), True)])
@pytest.mark.parametrize("aside_m", [0.0, 2.0, -2.0])
def test_a_crown_is_green_beyond_the_size_of_a_vehicle(
    street: tuple[Background, Examples, Place], aside_m: float, paint: tuple[int, int, int], kept: bool
) -> None:
    """A blotchy disc of 6 m, in the middle of the box or to one side: leaves, or the paint of something large."""
    image = land()
    image[156:] = (112, 113, 116)
    disc = np.hypot(*(np.indices((HEIGHT, WIDTH)) - np.array([150.0 + aside_m / GSD_M, 150.0])[:, None, None])) < 10
    blotches = np.random.default_rng(5).integers(-15, 16, (HEIGHT, WIDTH, 1))
    image[disc] = (np.array(paint) + blotches)[disc]
    assert may_be(street, image) == kept


@pytest.mark.parametrize("paint", [(60, 84, 42), (40, 90, 50), (90, 92, 40)])
def test_green_paint_ends_where_the_vehicle_does_though_a_lawn_is_beside_it(
    street: tuple[Background, Examples, Place], paint: tuple[int, int, int]
) -> None:
    image = land()
    draw(image, *PARKED[1], paint)
    assert may_be(street, image)


@pytest.mark.parametrize(("score", "windows", "kept"), [(0.5, False, False), (0.5, True, True), (0.8, False, True)])
def test_what_has_no_windows_must_surely_look_like_a_vehicle(
    street: tuple[Background, Examples, Place], score: float, windows: bool, kept: bool
) -> None:
    image = land()
    column, row, _ = PARKED[1]
    if windows:
        draw(image, *PARKED[1], PAINTS[2])
    else:
        image[round(row) - 3 : round(row) + 4, round(column) - 8 : round(column) + 9] = PAINTS[2]
    assert may_be(street, image, score) == kept


@pytest.mark.parametrize(("column", "found"), [(1.0, 0), (6.0, 1)])
def test_a_vehicle_is_found_where_most_of_it_is_in_the_picture(column: float, found: int) -> None:
    """A car is 15 px long: of the first 57 % can be seen, of the other 90 %."""
    at = look(block(((column, 92.0, 0.0), *PARKED[1:3]))).boxes
    assert len(at) == 2 + found


def test_a_gap_between_vehicles_is_no_vehicle(street: tuple[Background, Examples, Place]) -> None:
    image = land()
    for col_px in (135.0, 165.0):
        draw(image, col_px, 110.0, 0.0, PAINTS[2])
    boxes = np.array([[col_px, 110.0, 2.2 / GSD_M, 0.0, 0.0, 0.9 / GSD_M] for col_px in (135.0, 150.0)])
    boxes[1, 2] = 1.0 / GSD_M
    may = plausible(street[0], image, street[2], boxes, np.ones(2), (1 / GSD_M, 1 / GSD_M))
    assert may.tolist() == [True, False]
