from __future__ import annotations

import numpy as np
import pytest

from vtrack_batch.background.faint import add_faint
from vtrack_batch.background.subtract import GROUND, OBJECT, UNSEEN, Difference, subtract

HEIGHT, WIDTH = 150, 240
BAND = np.zeros((3, 2))
BODY, WINDOW = (slice(60, 66), slice(100, 114)), (slice(60, 66), slice(104, 106))


def ground() -> np.ndarray:
    """Ground of many levels, so that its exposure can be told, and its tolerance."""
    levels = np.full((HEIGHT, WIDTH, 4), 2, np.uint8)
    levels[..., :3] = np.linspace(60, 150, WIDTH)[None, :, None]
    return levels


def shot(*, body: int = 0, noise: float = 2.0, seed: int = 3) -> np.ndarray:
    """A frame with a body that differs by *body* levels, and its window that differs much."""
    picture = ground()[..., :3].astype(float)
    if body:
        picture[BODY] += body
        picture[WINDOW] -= 60
    return np.clip(np.rint(picture + np.random.default_rng(seed).normal(0, noise, picture.shape)), 0, 255).astype(
        np.uint8
    )


def compared(frame: np.ndarray, levels: np.ndarray, *, faint: bool = True) -> Difference:
    found = subtract(frame, levels, np.eye(3), threshold=12.0, shadow_band=BAND, tile_px=72.0)
    if faint:
        add_faint(found, frame, threshold=9.0, reach_px=8.0)
    return found


@pytest.mark.parametrize("body", [10, -10])
def test_a_faint_body_beside_its_window_fills(body: int) -> None:
    frame = shot(body=body)
    before, after = compared(frame, ground(), faint=False), compared(frame, ground())
    inside = np.zeros((HEIGHT, WIDTH), bool)
    inside[61:65, 107:113] = True
    assert before.evidence[inside].mean() < 35
    assert 35 < after.evidence[inside].mean() <= 80
    assert after.evidence[inside].mean() > before.evidence[inside].mean() + 12
    assert (after.classes[inside & (after.evidence > 0)] == OBJECT).all()


def test_the_rest_of_the_frame_stays_as_it_was() -> None:
    frame = shot(body=10)
    before, after = compared(frame, ground(), faint=False), compared(frame, ground())
    far = np.ones((HEIGHT, WIDTH), bool)
    far[40:86, 80:134] = False
    np.testing.assert_array_equal(after.evidence[far], before.evidence[far])
    assert (after.evidence >= before.evidence).all()
    # no edge grows: what lies a pixel beside the body is ground
    beside = np.r_[after.evidence[59, 100:114], after.evidence[66, 100:114]]
    assert beside.mean() < 6


def test_nothing_is_raised_without_something_sure() -> None:
    frame = shot(body=0)
    frame[60:66, 100:114] += 9
    after = compared(frame, ground())
    assert (after.evidence == compared(frame, ground(), faint=False).evidence).all()
    assert after.evidence.max() < 50


def test_ground_that_differs_everywhere_hides_the_faint() -> None:
    """Where the frame does not fit the ground, ten levels say nothing."""
    stripes = np.zeros((HEIGHT, WIDTH, 3))
    stripes[:, (np.arange(WIDTH) // 6) % 2 == 0] = 8
    frame = np.clip(shot(body=10) + stripes - 4, 0, 255).astype(np.uint8)
    before, after = compared(frame, ground(), faint=False), compared(frame, ground())
    gained = after.evidence[61:65, 107:113].astype(int) - before.evidence[61:65, 107:113]
    assert gained.mean() < 5


def test_ground_that_is_not_known_stays_unseen() -> None:
    levels = ground()
    levels[:, 107:, 3] = 255
    after = compared(shot(body=10), levels)
    assert (after.classes[:, 107:] == UNSEEN).all()
    assert after.evidence[:, 107:].max() == 0
    assert after.classes[10, 10] == GROUND


@pytest.mark.parametrize("size", [(1, 1), (2, 7), (3, 3)])
def test_tiny_frames_are_left_alone(size: tuple[int, int]) -> None:
    frame = np.full((*size, 3), 104, np.uint8)
    found = Difference(
        np.zeros(size, np.uint8), np.zeros(size, np.uint8), compared(shot(), ground()).exposure, ground(), np.eye(3)
    )
    add_faint(found, frame, threshold=9.0, reach_px=8.0)
    assert found.evidence.max() == 0
