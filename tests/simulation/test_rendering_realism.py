"""The measures that lay rendered frames beside real ones measure what they say."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

NOBODY = np.zeros((0, 4))


@pytest.fixture(scope="module")
def realism() -> ModuleType:
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "realism.py"
    spec = importlib.util.spec_from_file_location("realism", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def grey(values: np.ndarray) -> np.ndarray:
    return np.repeat(np.clip(np.round(values), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


@pytest.mark.parametrize("sigma", [2.0, 5.0])
def test_noise_is_the_noise_also_beside_a_town(realism: ModuleType, sigma: float) -> None:
    rng = np.random.default_rng(3)
    clean = np.tile(np.linspace(60, 130, 400), (240, 1))
    clean[:, 250:] += 80 * (rng.random((240, 150)) > 0.5)
    found = realism.frame_statistics(grey(clean + rng.normal(0, sigma, clean.shape)), NOBODY)["noise_dn"]
    assert len(found) > 40
    assert 0.85 * sigma < np.median(found) < 1.1 * sigma


def test_a_slope_has_one_gradient_and_shares_add_up(realism: ModuleType) -> None:
    found = realism.frame_statistics(grey(np.tile(np.arange(120) * 2.0, (90, 1))), NOBODY)
    inside = np.searchsorted(realism.GRADIENT_EDGES_DN, 2.0, side="right") - 1
    assert found["gradient_share"][inside] > 0.97
    for name in ("gradient_share", "luminance_share", "saturation_share"):
        assert found[name].sum() == pytest.approx(1.0)
    assert found["saturation_share"][0] == 1.0


def test_a_wave_shows_at_its_frequency(realism: ModuleType) -> None:
    wave = 100 + 40 * np.sin(2 * np.pi * 0.17 * np.arange(256))[None, :] * np.ones((128, 1))
    found = realism.frame_statistics(grey(wave), NOBODY)
    assert found["spectrum_cpp"][np.argmax(found["spectrum_power"])] == pytest.approx(0.17, abs=1 / 64)


def test_contrast_is_that_of_the_body_to_the_ground_around_it(realism: ModuleType) -> None:
    image = np.full((120, 200, 3), 110, np.uint8)
    boxes = np.array([[20, 30, 28, 12], [60, 80, 12, 30], [120, 20, 30, 12], [300, 20, 20, 10]], float)
    for (left, top, width, height), rgb in zip(
        boxes[:3].astype(int), [(50,) * 3, (200,) * 3, (110, 110, 210)], strict=True
    ):
        cv2.rectangle(image, (left, top), (left + width - 1, top + height - 1), rgb, -1)
    found = realism.frame_statistics(image, boxes)
    assert found["contrast_dn"][:2] == pytest.approx([-60, 90], abs=1)
    assert found["contrast_dn"][2] == pytest.approx(100 * 0.114, abs=1.5)
    assert found["colour_contrast_dn"][:3] == pytest.approx([60, 90, 100], abs=1)
    assert np.isnan(found["contrast_dn"][3])
    order = np.array([2, 3, 0, 1])
    np.testing.assert_array_equal(
        realism.frame_statistics(image, boxes[order])["contrast_dn"], found["contrast_dn"][order]
    )


def test_distances_run_from_the_same_to_apart(realism: ModuleType) -> None:
    sample = np.arange(50.0)
    assert realism.distance(sample, sample[::-1]) == 0
    assert realism.distance(sample, sample + 100) == 1
    assert realism.distance(sample, sample + 10) == pytest.approx(0.2)
    assert realism.share_distance(np.array([0.5, 0.5, 0]), np.array([0.5, 0, 0.5])) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("image", "boxes"),
    [
        (np.zeros((100, 100), np.uint8), NOBODY),
        (np.zeros((30, 100, 3), np.uint8), NOBODY),
        (np.zeros((100, 100, 3), np.uint8), np.zeros((2, 5))),
    ],
)
def test_what_is_no_frame_is_refused(realism: ModuleType, image: np.ndarray, boxes: np.ndarray) -> None:
    with pytest.raises(ValueError, match="not"):
        realism.frame_statistics(image, boxes)
