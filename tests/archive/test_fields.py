"""Interlaced frames: told by their comb, and only they; one field of two is left."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vtrack_batch.archive.decode import decode
from vtrack_batch.archive.fields import are_interlaced, turns, upper_field


def scene(shift_px: int, *, vehicles: int = 30) -> np.ndarray:
    """An oblong street scene (210, 400, 3) of soft ground, stripes both ways and vehicles *shift_px* farther right."""
    rng = np.random.default_rng(3)
    coarse = rng.integers(60, 180, (22, 41, 3)).astype(np.uint8)
    ground = cv2.resize(coarse, (400, 210), interpolation=cv2.INTER_CUBIC)
    ground[40:44], ground[:, 350:353] = 230, 230
    for row, col in rng.integers((0, 0), (200, 340), (vehicles, 2)):
        cv2.rectangle(
            ground, (int(col) + shift_px, int(row)), (int(col) + shift_px + 12, int(row) + 6), (20, 20, 20), -1
        )
    noise = rng.normal(0, 2, ground.shape)
    return np.clip(ground + noise, 0, 255).astype(np.uint8)


def woven(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    frame = first.copy()
    frame[1::2] = second[1::2]
    return frame


def through_jpeg(frame: np.ndarray, quality: int) -> np.ndarray:
    data = cv2.imencode(".jpg", frame[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    return decode(data, max_pixels=10**6).pixels


@pytest.mark.parametrize("quality", [75, 95])
def test_vehicles_that_moved_between_two_fields_are_told_from_those_of_one(quality: int) -> None:
    first, second = scene(0), scene(3)
    assert are_interlaced([turns(through_jpeg(woven(first, second), quality))])
    assert not are_interlaced([turns(through_jpeg(first, quality)), turns(through_jpeg(second, quality))])


def test_stripes_and_noise_are_no_comb_and_neither_is_a_frame_on_its_side() -> None:
    rng = np.random.default_rng(4)
    stripes = np.full((90, 160, 3), 40, np.uint8)
    stripes[::6], stripes[1::6], stripes[2::6] = 220, 220, 220
    rough = rng.integers(0, 256, (300, 170, 3)).astype(np.uint8)
    on_its_side = np.ascontiguousarray(woven(scene(0), scene(3)).transpose(1, 0, 2))
    for frame in (stripes, rough, on_its_side):
        assert not are_interlaced([turns(frame)])


def test_frames_too_small_for_a_comb_and_no_frames_are_not_interlaced() -> None:
    assert not are_interlaced([])
    for shape in ((1, 1, 3), (2, 900, 3), (4, 5, 3)):
        assert not are_interlaced([turns(np.full(shape, 9, np.uint8))])


@pytest.mark.parametrize("height", [1, 2, 5, 6])
def test_what_is_left_is_the_first_field_and_the_mean_of_its_rows(height: int) -> None:
    first = np.repeat(
        (20 * np.arange(height, dtype=np.uint8))[:, None, None] + np.zeros((1, 7, 3), np.uint8), 1, axis=0
    )
    second = np.full_like(first, 255)
    left = upper_field(woven(first, second))
    expected = first.copy()
    if height % 2 == 0:
        expected[-1] = first[-2]
    assert np.array_equal(left, expected)
    assert np.array_equal(woven(first, second)[1::2], second[1::2]), "the frame that was given has changed"


@pytest.mark.real
@pytest.mark.parametrize("clip", ["MunichStreet02", "StuttgartAutobahn01", "MunichAutobahn01"])
def test_real_frames_taken_at_once_are_not_interlaced(shared_data, clip: str) -> None:
    frames = sorted((shared_data / "kit-ais" / clip / "frames").iterdir())[:9:4]
    assert not are_interlaced([turns(decode(path.read_bytes(), max_pixels=10**8).pixels) for path in frames])
