"""Which patches of a reference count: those on the ground, though half of the picture leans."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vtrack_batch.model import homography
from vtrack_batch.registration.alignment import register
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.reference import prepare_reference
from vtrack_batch.registration.steady import steady_patches

PARAMS = RegistrationParams()
ROWS, COLUMNS = 420, 700
GRID = np.stack(np.meshgrid(np.linspace(0, COLUMNS - 1, 9), np.linspace(0, ROWS - 1, 7)), axis=-1).reshape(-1, 2)


def texture(seed):
    grey = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (ROWS + 80, COLUMNS + 80)), (0, 0), 2.0)
    return np.clip(120 + 40 * grey / grey.std(), 1, 255).astype(np.float32)


@pytest.fixture(scope="module")
def town():
    """Return a function that takes a picture from a place: the ground, and roofs over half of it that lean."""
    ground, roofs = texture(1), texture(2)
    rng, height = np.random.default_rng(3), np.zeros((ROWS + 80, COLUMNS + 80), np.float32)
    for row in range(0, ROWS + 80, 60):
        for column in range(0, COLUMNS + 80, 60):
            if rng.random() < 0.6:
                height[row : row + 54, column : column + 54] = rng.uniform(0.2, 1.0)

    def shot(x, y, seed):
        # A roof moves by the platform's way times its height.
        rows, columns = np.mgrid[: ROWS + 80, : COLUMNS + 80].astype(np.float32)
        leaning = cv2.remap(roofs, columns + 0.06 * x * height, rows + 0.06 * y * height, cv2.INTER_CUBIC)
        scene = np.where(height > 0, leaning, ground)
        whole = cv2.warpAffine(
            scene, np.array([[1.0, 0, -40 - x], [0, 1, -40 - y]]), (COLUMNS, ROWS), flags=cv2.INTER_CUBIC
        )
        noisy = whole + np.random.default_rng(seed).normal(0, 2, whole.shape)
        return np.repeat(np.clip(np.rint(noisy), 1, 255).astype(np.uint8)[:, :, None], 3, axis=2)

    return shot


WAYS = [(-14.0, 5.5), (-9.2, -7.0), (12.3, 8.8), (15.5, -3.3), (6.1, 13.7), (-4.4, -15.2), (10.9, -11.5)]


def errors_px(poses):
    found = [homography.apply(pose, GRID) - GRID - way for pose, way in zip(poses, WAYS, strict=True)]
    return np.array([np.sqrt((error**2).sum(axis=1).mean()) for error in found])


@pytest.fixture(scope="module")
def looks(town):
    reference = prepare_reference(town(0, 0, 0), params=PARAMS)
    laid = [register(town(*way, seed), reference, params=PARAMS) for seed, way in enumerate(WAYS, 1)]
    return reference, laid


def test_poses_settle_on_the_ground_though_roofs_lean(town, looks):
    reference, laid = looks
    steady, poses = steady_patches(reference, laid, params=PARAMS)
    rough = errors_px([frame.frame_to_reference for frame in laid])
    assert rough.max() > 0.15
    assert 0.001 < errors_px(poses).max() < 0.5 * rough.max()
    again = [register(town(*way, seed), steady, params=PARAMS).frame_to_reference for seed, way in enumerate(WAYS, 1)]
    assert 0.001 < errors_px(again).max() < 0.5 * rough.max()


def test_a_third_of_the_patches_remain_some_of_them_held_out(looks):
    reference, laid = looks
    steady, _ = steady_patches(reference, laid, params=PARAMS)
    share = len(steady.centres_px) / len(reference.centres_px)
    assert 0.25 < share <= 0.34
    assert len(steady.patches) == len(steady.held_out) == len(steady.centres_px)
    assert 0.15 < steady.held_out.mean() < 0.35
    np.testing.assert_array_equal(steady.coarse, reference.coarse)


def test_the_order_of_frames_hardly_matters(looks):
    reference, laid = looks
    one, poses = steady_patches(reference, laid, params=PARAMS)
    other, turned = steady_patches(reference, laid[::-1], params=PARAMS)
    np.testing.assert_array_equal(one.centres_px, other.centres_px)
    np.testing.assert_allclose(poses, turned[::-1], atol=1e-9)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_frames_tell_nothing(looks, count):
    reference, laid = looks
    steady, poses = steady_patches(reference, laid[:count], params=PARAMS)
    assert steady is reference
    np.testing.assert_array_equal(poses, [frame.frame_to_reference for frame in laid[:count]])


def test_every_part_of_the_frame_keeps_its_share(looks):
    reference, laid = looks
    steady, _ = steady_patches(reference, laid, params=PARAMS)

    def parts(centres):
        column, row = (centres * 4 / [COLUMNS, ROWS]).astype(int).clip(0, 3).T
        return np.bincount(4 * row + column, minlength=16)

    share = parts(steady.centres_px) / parts(reference.centres_px)
    assert 0.15 < share.min() <= share.max() < 0.55
