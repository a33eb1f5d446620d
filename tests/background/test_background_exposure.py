from __future__ import annotations

import numpy as np
import pytest

from vtrack_batch.background.exposure import Exposure, fit_exposure


def scene(seed: int = 3, height: int = 120, width: int = 210) -> np.ndarray:
    """Patches of flat colours, 15 px wide."""
    rng = np.random.default_rng(seed)
    patches = rng.integers(35, 190, (height // 15, width // 15, 3))
    return np.kron(patches, np.ones((15, 15, 1))) + rng.normal(0, 1.5, (height, width, 3))


def to_bytes(levels: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("gamma", [0.8, 1.0, 1.25])
@pytest.mark.parametrize("gain", [0.8, 1.15])
def test_monotone_change_is_undone_in_spite_of_vehicles(gamma: float, gain: float) -> None:
    target = scene()
    picture = gain * 255 * (target / 255) ** gamma
    rng = np.random.default_rng(0)
    for row, column in zip(rng.integers(0, 110, 50), rng.integers(0, 195, 50), strict=True):
        picture[row : row + 5, column : column + 12] = rng.choice([20, 250])
    everywhere = np.ones(target.shape[:2], bool)
    exposure = fit_exposure(to_bytes(picture), to_bytes(target), everywhere, tile_px=1000)
    for level in (50, 90, 130, 170):
        seen = gain * 255 * (level / 255) ** gamma
        for channel in range(3):
            found = np.interp(seen, np.arange(256), exposure.levels[channel]) * exposure.gain.mean()
            assert abs(found - level) < 5


def test_map_never_falls() -> None:
    rng = np.random.default_rng(5)
    one, other = (rng.integers(0, 256, (90, 140, 3), dtype=np.uint8) for _ in range(2))
    exposure = fit_exposure(one, other, np.ones((90, 140), bool), tile_px=40)
    assert (np.diff(exposure.levels, axis=1) >= 0).all()
    assert np.isfinite(exposure.levels).all()


def test_white_cars_stay_white_where_no_ground_is_white() -> None:
    target = np.full((120, 210, 3), 100.0) + np.random.default_rng(1).normal(0, 8, (120, 210, 3))
    picture = target.copy()
    picture[30:50, 60:120] = 245
    exposure = fit_exposure(to_bytes(picture), to_bytes(target), np.ones((120, 210), bool), tile_px=1000)
    assert 225 < exposure.levels[:, 245].min() <= exposure.levels[:, 245].max() < 270


def test_cloud_is_followed_smoothly() -> None:
    target = scene(height=240, width=420)
    cloud = np.linspace(0.8, 1.1, 420)[None, :, None]
    exposure = fit_exposure(to_bytes(target * cloud), to_bytes(target), np.ones((240, 420), bool), tile_px=40)
    gain = exposure.gain_map(240, 420).mean(axis=0)
    ratio = gain[-4] / gain[3]
    assert 0.8 / 1.1 * 0.97 < ratio < 0.8 / 1.1 * 1.12


def test_too_little_to_go_by_changes_nothing() -> None:
    picture = to_bytes(scene())
    exposure = fit_exposure(picture, picture // 2, np.zeros(picture.shape[:2], bool), tile_px=60)
    assert (exposure.levels == np.arange(256)).all()
    assert (exposure.gain == 1).all()


@pytest.mark.parametrize("rows", [(0, 40), (40, 103), (96, 203)])
def test_some_rows_of_the_gain_are_those_of_the_whole(rows: tuple[int, int]) -> None:
    gain = np.random.default_rng(7).uniform(0.7, 1.4, (3, 5)).astype(np.float32)
    exposure = Exposure(np.zeros((3, 256), np.float32), gain)
    whole, part = exposure.gain_map(203, 301), exposure.gain_map(203, 301, rows)
    wanted = whole[rows[0] // 8 : -(-rows[1] // 8)]
    assert part.shape == wanted.shape
    assert np.abs(part - wanted).max() < 0.02
    assert np.ptp(wanted) > 0.1
