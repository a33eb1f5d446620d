"""The parts of registration: correlation, fits, reduction."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vtrack_batch.model import homography
from vtrack_batch.registration.correlation import correlate
from vtrack_batch.registration.polishing import polished
from vtrack_batch.registration.pose import Consensus, fit_pose, robust_rms
from vtrack_batch.registration.reduction import reduce, reduction_factor, to_reduced

CONSENSUS = Consensus(2.0, 1)
AFFINE = np.array([[1.02, 0.03, 40.0], [-0.05, 0.97, -12.0], [0, 0, 1]])
TILTED = np.array([[1.02, 0.03, 40.0], [-0.05, 0.97, -12.0], [2e-5, -1e-5, 1]])


def smooth_noise(rng: np.random.Generator, rows: int, columns: int) -> np.ndarray:
    image = cv2.GaussianBlur(rng.normal(size=(rows, columns)), (0, 0), 1.5)
    return np.clip(128 + 300 * image, 1, 255).astype(np.uint8)


class TestCorrelation:
    @settings(max_examples=25, deadline=None)
    @given(st.integers(0, 10_000), st.integers(2, 9), st.sampled_from([5, 11, 17, 31]))
    def test_equals_the_textbook(self, seed, reach, side):
        """Peak and coefficient are those of OpenCV's float computation, to its rounding."""
        rng = np.random.default_rng(seed)
        plane = smooth_noise(rng, 90, 120)
        shift = rng.integers(-reach + 1, reach, 2)
        half = side // 2
        place = np.array([60, 45])
        col, row = place + shift
        patch = plane[row - half : row + half + 1, col - half : col + half + 1]
        offsets, scores = correlate(plane, patch[None], place[None].astype(float), np.eye(2)[None], search_px=reach)
        wide = half + reach
        window = plane[45 - wide : 45 + wide + 1, 60 - wide : 60 + wide + 1]
        surface = cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED)
        assert scores[0] == pytest.approx(1.0, abs=1e-9)
        assert surface[tuple(shift[::-1] + reach)] == pytest.approx(1.0, abs=1e-4)
        np.testing.assert_allclose(offsets[0], shift, atol=0.5)

    @pytest.mark.parametrize("seed", range(5))
    def test_imperfect_patches_too(self, seed):
        rng = np.random.default_rng(seed)
        plane = smooth_noise(rng, 90, 120)
        dull = (plane[30:61, 45:76] * 0.6 + rng.normal(40, 8, (31, 31))).clip(1, 255).astype(np.uint8)
        window = plane[45 - 21 : 45 + 22, 60 - 21 : 60 + 22]
        _, peak, _, (col, row) = cv2.minMaxLoc(cv2.matchTemplate(window, dull, cv2.TM_CCOEFF_NORMED))
        offsets, scores = correlate(plane, dull[None], np.array([[60.0, 45]]), np.eye(2)[None], search_px=6)
        assert scores[0] == pytest.approx(peak, abs=1e-4)
        assert 0.8 < scores[0] < 0.99
        np.testing.assert_array_equal(np.round(offsets[0]), [col - 6, row - 6])

    def test_sub_pixel_shift(self):
        rng = np.random.default_rng(3)
        plane = smooth_noise(rng, 200, 300)
        moved = cv2.warpAffine(plane, np.array([[1, 0, 0.3], [0, 1, -0.4]]), (300, 200), flags=cv2.INTER_CUBIC)
        places = np.stack(np.meshgrid(np.arange(40, 260, 20), np.arange(40, 160, 20)), axis=-1).reshape(-1, 2)
        patches = np.stack([plane[r - 10 : r + 11, c - 10 : c + 11] for c, r in places])
        offsets, _ = correlate(
            moved, patches, places.astype(float), np.tile(np.eye(2), (len(places), 1, 1)), search_px=4
        )
        np.testing.assert_allclose(np.median(offsets, axis=0), [0.3, -0.4], atol=0.05)

    def test_turned_window(self):
        rng = np.random.default_rng(4)
        plane = smooth_noise(rng, 200, 200)
        quarter = np.ascontiguousarray(np.rot90(plane))  # plane (col, row) -> quarter (row, 199 - col)
        patch = plane[80:101, 90:111]  # centre col 100, row 90
        linear = np.array([[[0.0, 1.0], [-1.0, 0.0]]])
        offsets, scores = correlate(quarter, patch[None], np.array([[90.0, 99.0]]), linear, search_px=5)
        assert scores[0] == pytest.approx(1)
        np.testing.assert_allclose(offsets[0], [0, 0], atol=0.05)

    def test_nothing_is_said_of_rims_black_and_flat_windows(self):
        plane = smooth_noise(np.random.default_rng(5), 100, 100)
        patch = plane[40:61, 40:61]
        black = np.zeros_like(plane)
        for image, place in ((plane, (54.0, 50.0)), (black, (50.0, 50.0)), (np.full_like(plane, 77), (50.0, 50.0))):
            offsets, scores = correlate(image, patch[None], np.array([place]), np.eye(2)[None], search_px=4)
            assert np.isnan(offsets).all()
            assert np.isnan(scores).all()

    def test_no_patches(self):
        plane = np.zeros((50, 50), np.uint8)
        offsets, scores = correlate(
            plane, np.empty((0, 9, 9), np.uint8), np.empty((0, 2)), np.empty((0, 2, 2)), search_px=4
        )
        assert offsets.shape == (0, 2)
        assert scores.shape == (0,)


class TestPose:
    def points(self, truth, count=240, noise=0.05, outliers=0.0, seed=1):
        rng = np.random.default_rng(seed)
        source = rng.uniform((0, 0), (1900, 1000), (count, 2))
        target = homography.apply(truth, source) + rng.normal(0, noise, (count, 2))
        bad = rng.random(count) < outliers
        target[bad] += rng.uniform(-40, 40, (bad.sum(), 2))
        return source, target, np.arange(count) % 4 == 0

    def error(self, matrix, truth):
        frame = homography.corners(1900, 1000)
        return np.abs(homography.apply(matrix, frame) - homography.apply(truth, frame)).max()

    @pytest.mark.parametrize("outliers", [0, 0.4, 0.55])
    def test_affine_stays_affine(self, outliers):
        pose = fit_pose(*self.points(AFFINE, outliers=outliers), CONSENSUS)
        assert pose.matrix[2].tolist() == [0, 0, 1]
        assert self.error(pose.matrix, AFFINE) < 0.06
        assert pose.inlier_share == pytest.approx(1 - outliers, abs=0.12)

    @pytest.mark.parametrize("outliers", [0, 0.4, 0.55])
    def test_perspective_is_seen(self, outliers):
        pose = fit_pose(*self.points(TILTED, outliers=outliers), CONSENSUS)
        assert pose.matrix[2, 0] == pytest.approx(2e-5, rel=0.05)
        assert self.error(pose.matrix, TILTED) < 0.1
        assert 0.04 < pose.residual_px < 0.2 if outliers else 0.05 < pose.residual_px < 0.1

    def test_order_of_points_hardly_matters(self):
        source, target, held_out = self.points(TILTED, outliers=0.3)
        order = np.random.default_rng(9).permutation(len(source))
        one = fit_pose(source, target, held_out, CONSENSUS)
        other = fit_pose(source[order], target[order], held_out[order], CONSENSUS)
        assert self.error(one.matrix, other.matrix) < 0.02

    @pytest.mark.parametrize("count", [0, 1, 3, 7])
    def test_too_few_points(self, count):
        assert fit_pose(*self.points(AFFINE, count=count), CONSENSUS) is None

    def test_points_on_one_line_fit_nothing_wild(self):
        source = np.column_stack([np.linspace(0, 1000, 60), np.full(60, 500.0)])
        pose = fit_pose(source, source + 3, np.arange(60) % 4 == 0, CONSENSUS)
        assert pose is None or self.error(pose.matrix, pose.matrix) == 0

    def test_mirrored_points_fit_nothing(self):
        assert fit_pose(*self.points(np.diag([-1.0, 1, 1])), CONSENSUS) is None

    def test_residual_is_the_root_mean_square_of_gaussian_errors(self):
        errors = np.random.default_rng(0).normal(0, 0.7, (4000, 2))
        clean = np.linalg.norm(errors, axis=1)
        assert robust_rms(clean) == pytest.approx(0.7 * 2**0.5, rel=0.05)
        assert robust_rms(np.append(clean, np.full(2000, 50.0))) < 1.7
        assert robust_rms(np.empty(0)) == np.inf


class TestPolishing:
    @pytest.mark.parametrize(("truth", "freedoms"), [(AFFINE, 6), (TILTED, 8)])
    def test_exact_points_give_the_exact_map_from_a_rough_one(self, truth, freedoms):
        source = np.random.default_rng(2).uniform((0, 0), (1900, 1000), (80, 2))
        rough = AFFINE + np.array([[1e-4, -1e-4, 0.3], [1e-4, 2e-4, -0.2], [0, 0, 0]])
        found = polished(rough, source, homography.apply(truth, source), freedoms=freedoms, tolerance_px=30.0)
        np.testing.assert_allclose(found / found[2, 2], truth, rtol=1e-4, atol=1e-8)

    def test_few_points_change_nothing(self):
        source = np.zeros((3, 2))
        assert polished(AFFINE, source, source + 500, freedoms=6, tolerance_px=1.0) == pytest.approx(AFFINE, abs=1e-9)


class TestReduction:
    @given(st.integers(1, 9), st.floats(-5, 5000), st.floats(-5, 5000))
    def test_centres_of_blocks_map_to_whole_pixels(self, factor, column, row):
        block = np.array([[(factor - 1) / 2, factor + (factor - 1) / 2]])
        np.testing.assert_allclose(homography.apply(to_reduced(factor), block), [[0, 1]], atol=1e-12)

    def test_blocks_are_averaged_and_rests_cut_off(self):
        plane = np.arange(7 * 9, dtype=np.uint8).reshape(7, 9)
        assert reduce(plane, 2).shape == (3, 4)
        assert reduce(plane, 2)[0, 0] in (5, 6)  # mean 5.0 of 0, 1, 9, 10
        assert reduce(plane, 1) is plane

    def test_factor_follows_the_area(self):
        assert reduction_factor((1080, 1920), 130_000) == 4
        assert reduction_factor((100, 100), 130_000) == 1
        assert reduction_factor((6000, 8000), 130_000) == 19
