from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from vtrack_batch.background import learn
from vtrack_batch.background.learn import Background, Sample, learn_background
from vtrack_batch.background.params import BackgroundParams

HEIGHT, WIDTH = 150, 260
PARAMS = BackgroundParams()


def ground(seed: int = 0) -> np.ndarray:
    """Grass with a grey road along the rows 60..89, brighter to the right."""
    rng = np.random.default_rng(seed)
    land = np.empty((HEIGHT, WIDTH, 3))
    land[:] = (95, 120, 70)
    land[60:90] = (110, 112, 115)
    land += np.linspace(-15, 15, WIDTH)[None, :, None] + rng.normal(0, 2, (HEIGHT, WIDTH, 1))
    return land


def shot(land: np.ndarray, seed: int, gain: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(1000 + seed)
    return np.clip(land * gain + rng.normal(0, 2, land.shape), 0, 255).astype(np.uint8)


def passing(count: int = 12, gain: float = 0.0) -> list[Sample]:
    """A white car that drives on; the exposure changes by *gain* from first to last."""
    samples = []
    for i in range(count):
        land = ground()
        land[66:72, 15 * i + 20 : 15 * i + 34] = (240, 240, 235)
        samples.append(Sample(shot(land, i, 1 + gain * i / count), np.eye(3)))
    return samples


def error(background: Background) -> float:
    return float(np.abs(background.pixels.astype(float) - ground())[background.seen].mean())


def test_moving_car_leaves_no_trace() -> None:
    background = learn_background(passing(), params=PARAMS)
    assert background.seen.all()
    assert background.pixels.shape == (HEIGHT, WIDTH, 3)
    assert np.abs(background.pixels.astype(float) - ground()).max() < 14
    assert 0.1 < error(background) < 2.0


def test_exposure_drift_is_taken_out() -> None:
    background = learn_background(passing(gain=0.35), params=PARAMS)
    assert error(background) < 3.0
    assert np.median(background.tolerance) < 12


def test_order_of_samples_does_not_matter() -> None:
    samples = [replace(sample, taken_s=1.5 * i) for i, sample in enumerate(passing(gain=0.1))]
    shuffled = [samples[i] for i in (0, 7, 3, 11, 1, 2, 10, 4, 9, 5, 8, 6)]
    one, other = (learn_background(order, params=PARAMS) for order in (samples, shuffled))
    assert one.levels.tobytes() == other.levels.tobytes()


@pytest.mark.parametrize("count", [1, 2, 3, 16])
def test_few_samples_give_a_background(count: int) -> None:
    background = learn_background(passing(count), params=PARAMS)
    assert background.seen.all()
    limit = {1: 5.0, 2: 4.0}.get(count, 2.2)
    assert error(background) < limit


def test_road_is_found_under_a_queue_that_stands_most_of_the_time() -> None:
    colours = [(240, 240, 240), (30, 30, 35), (150, 20, 20), (20, 40, 140), (200, 200, 205), (60, 62, 60)]
    samples = []
    for i in range(20):
        land = ground()
        land[66:72, 8 * i % 200 : 8 * i % 200 + 14] = colours[i % 6]
        if i >= 7:
            land[78:84, 120:134] = colours[0 if i < 15 else 1]
        samples.append(Sample(shot(land, i), np.eye(3)))
    background = learn_background(samples, params=PARAMS)
    found = background.pixels[78:84, 120:134].reshape(-1, 3).mean(axis=0)
    assert np.abs(found - ground()[78:84, 120:134].reshape(-1, 3).mean(axis=0)).max() < 8


def test_car_that_stands_nearly_all_the_time_is_not_ground() -> None:
    samples = []
    for i in range(20):
        land = ground()
        land[66:72, 8 * i % 200 : 8 * i % 200 + 14] = (240, 240, 240)
        if 1 <= i < 18:
            land[78:84, 120:134] = (20, 40, 140)
        samples.append(Sample(shot(land, i), np.eye(3), 1.5 * i))
    found = learn_background(samples, params=PARAMS).pixels[78:84, 120:134].reshape(-1, 3).astype(float)
    road = ground()[78:84, 120:134].reshape(-1, 3)
    assert np.abs(found.mean(axis=0) - road.mean(axis=0)).max() < 4


def test_ground_that_cars_leave_between_them_keeps_its_paint() -> None:
    samples = []
    for i in range(20):
        land = ground()
        land[70:76, 100:160] = (150, 60, 50)
        if i % 3 == 1:
            land[70:76, 118:134] = (240, 240, 235) if i % 2 else (40, 42, 45)
        samples.append(Sample(shot(land, i), np.eye(3), 1.5 * i))
    found = learn_background(samples, params=PARAMS).pixels[71:75, 120:132].reshape(-1, 3).astype(float)
    assert np.abs(found.mean(axis=0) - (150, 60, 50)).max() < 6


@pytest.mark.parametrize(("first", "last"), [(4, 7), (9, 13)])
def test_shadow_that_hides_a_hedge_is_not_ground(first: int, last: int) -> None:
    samples = []
    for i in range(20):
        land = ground()
        land[56:60] = (38, 48, 40)
        if first <= i <= last:
            land[60:74, 90:190] = (36, 46, 50)
        land[78:84, 8 * i % 200 : 8 * i % 200 + 14] = (240, 240, 240)
        samples.append(Sample(shot(land, i), np.eye(3), 1.5 * i))
    off = learn_background(samples, params=PARAMS).pixels[62:72, 100:180].astype(float) - ground()[62:72, 100:180]
    assert np.abs(off.reshape(-1, 3).mean(axis=0)).max() < 4
    assert np.abs(off).max() < 20


def grey_queue() -> Background:
    """Two cars nearly as grey as the road stand one after the other, for 14 of 20 samples; then leaves that sway."""
    rng = np.random.default_rng(5)
    samples = []
    for i in range(20):
        land = ground()
        land[66:72, 8 * i % 200 : 8 * i % 200 + 14] = (240, 240, 240)
        if i >= 6:
            land[78:84, 120:134] += 18 if i < 13 else -18
            land[78:84, 123:126] = 40
            land[84:86, 120:134] *= 0.5
        land[20:40, 60:80] += rng.uniform(-45, 45)
        samples.append(Sample(shot(land, i), np.eye(3)))
    return learn_background(samples, params=PARAMS)


def test_grey_cars_that_stand_most_of_the_time_are_not_taken_for_road() -> None:
    off = grey_queue().pixels[79:83, 121:133].astype(float) - ground()[79:83, 121:133]
    assert np.abs(off.reshape(-1, 3).mean(axis=0)).max() < 4
    assert np.abs(off).max() < 14


def test_tolerance_is_that_of_the_road_under_a_queue_and_wide_under_leaves() -> None:
    tolerance = grey_queue().tolerance.astype(float)
    free = tolerance[78:84, 200:240].mean()
    assert abs(tolerance[79:83, 121:133].mean() - free) < 4
    assert tolerance[22:38, 62:78].mean() > free + 8


def test_strips_leave_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = grey_queue()
    monkeypatch.setattr(learn, "STRIP_ROWS", 17)
    strips = grey_queue()
    apart = np.abs(whole.levels.astype(int) - strips.levels)
    assert (apart.max(axis=2) > 0).mean() < 0.002
    np.testing.assert_array_equal(whole.seen, strips.seen)


def test_platform_motion_is_followed() -> None:
    wide = np.concatenate([ground(), ground(1)], axis=1)
    samples = []
    for i in range(9):
        at = 4 * (i - 4) + 60
        pose = np.array([[1.0, 0, at - 60], [0, 1, 0], [0, 0, 1]])
        samples.append(Sample(shot(wide[:, at : at + WIDTH], i), pose))
    background = learn_background(samples, params=PARAMS)
    assert np.abs(background.pixels.astype(float) - wide[:, 60 : 60 + WIDTH])[background.seen].mean() < 2.5


def test_uncovered_ground_is_unseen_and_not_black() -> None:
    step = np.array([[1.0, 0, 90], [0, 1, 0], [0, 0, 1]])
    samples = [Sample(shot(ground(), i), np.eye(3) if i < 2 else step) for i in range(8)]
    background = learn_background(samples, params=PARAMS)
    assert not background.seen[:, :85].any()
    assert background.seen[:, 95:].all()
    assert (background.tolerance[~background.seen] == 255).all()
    assert (background.tolerance[background.seen] < 255).all()


def test_black_wedge_is_no_ground() -> None:
    samples = []
    for i in range(9):
        pixels = shot(ground(), i)
        pixels[:, : 40 if i < 7 else 0] = 0
        samples.append(Sample(pixels, np.eye(3)))
    background = learn_background(samples, params=PARAMS)
    assert not background.seen[:, :38].any()
    assert background.seen[:, 45:].all()


def with_shadows(count: int, ratio: float) -> list[Sample]:
    samples = []
    for i in range(count):
        land = ground()
        for lane in range(10):
            row, column = 6 + 14 * lane, 10 + (23 * i + 31 * lane) % (WIDTH - 40)
            land[row + 3 : row + 9, column + 3 : column + 17] *= ratio
            land[row : row + 6, column : column + 14] = (225, 220, 228)
        samples.append(Sample(shot(land, i), np.eye(3)))
    return samples


@pytest.mark.parametrize("ratio", [0.4, 0.5, 0.6])
def test_shadow_ratio_and_sun_are_found(ratio: float) -> None:
    shadows = learn_background(with_shadows(15, ratio), params=PARAMS).shadows
    assert shadows.ratio is not None
    assert shadows.direction is not None
    assert np.abs(np.array(shadows.ratio) - ratio).max() < 0.05
    assert np.dot(shadows.direction, (0.7071, 0.7071)) > 0.85


def test_no_shadow_is_invented() -> None:
    shadows = learn_background(passing(), params=PARAMS).shadows
    assert shadows.ratio is None
    assert shadows.direction is None


def test_background_survives_pickling() -> None:
    background = learn_background(passing(4), params=PARAMS)
    again = pickle.loads(pickle.dumps(background))
    assert (again.levels == background.levels).all()
    assert again.shadows == background.shadows


def test_bad_input_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        learn_background([], params=PARAMS)
    with pytest.raises(ValueError, match="one size"):
        learn_background(
            [Sample(np.zeros((9, 8, 3), np.uint8), np.eye(3)), Sample(np.zeros((8, 9, 3), np.uint8), np.eye(3))],
            params=PARAMS,
        )
