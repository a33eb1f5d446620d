"""Known motion in, the same motion out; and what cannot be laid on the reference is refused."""

from __future__ import annotations

import pickle
from dataclasses import replace

import cv2
import numpy as np
import pytest
from registration_scenes import COLUMNS, ROWS, camera, make_scene, motion

from vtrack_batch.errors import UnusableFrame
from vtrack_batch.model import homography
from vtrack_batch.registration.alignment import Registration, register
from vtrack_batch.registration.coarse import Guess
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.reference import prepare_reference

PARAMS = RegistrationParams()


@pytest.fixture(scope="module")
def view():
    return camera()


@pytest.fixture(scope="module")
def reference(view):
    return prepare_reference(view(noise=2.0, seed=99), params=PARAMS)


def error_px(found: Registration, truth: np.ndarray) -> float:
    """Largest distance over the whole frame between where pixels are put and where they belong."""
    places = np.stack(np.meshgrid(np.linspace(0, COLUMNS - 1, 9), np.linspace(0, ROWS - 1, 7)), axis=-1).reshape(-1, 2)
    return float(
        np.linalg.norm(
            homography.apply(found.frame_to_reference, places) - homography.apply(truth, places), axis=1
        ).max()
    )


MOTIONS = {
    "none": {},
    "right": {"shift": (12.0, 0.0)},
    "half a pixel": {"shift": (0.5, -0.5)},
    "15 % of the frame": {"shift": (0.15 * COLUMNS, -0.15 * ROWS)},
    "a third of the frame": {"shift": (-0.3 * COLUMNS, 0.1 * ROWS)},
    "3 degrees": {"shift": (20.3, 11.7), "turn_deg": 3},
    "-8 degrees": {"turn_deg": -8},
    "8 % closer": {"scale": 0.92, "shift": (5, 3)},
    "tilted": {"tilt": (6e-5, -4e-5), "turn_deg": 1},
}


class TestKnownMotion:
    @pytest.mark.parametrize("name", MOTIONS)
    def test_comes_out(self, view, reference, name):
        truth = motion(**MOTIONS[name])
        found = register(view(truth), reference, params=PARAMS)
        assert found.accepted
        assert found.reason is None
        assert error_px(found, truth) < 0.15
        assert 0.005 < found.residual_px < 0.3  # not zero either: frame and reference have noise of their own
        assert found.frame_to_reference[2, 2] == 1
        assert found.inliers >= 20
        assert 0.9 < found.inlier_share <= 1

    def test_direction_is_frame_to_reference(self, view, reference):
        found = register(view(motion(shift=(12, -7))), reference, params=PARAMS)
        np.testing.assert_allclose(
            homography.apply(found.frame_to_reference, np.array([[100.0, 50]])), [[112, 43]], atol=0.1
        )

    @pytest.mark.parametrize("turn_deg", [45, 90, 180, -120])
    def test_any_rotation(self, view, reference, turn_deg):
        truth = motion(turn_deg=turn_deg, shift=(9, 4))
        found = register(view(truth), reference, params=PARAMS)
        assert found.accepted
        assert error_px(found, truth) < 0.3

    @pytest.mark.parametrize(("gain", "offset"), [(0.8, -10), (1.2, 10), (0.5, 0), (1.0, 40)])
    def test_exposure_does_not_matter(self, view, reference, gain, offset):
        truth = motion(shift=(15, 9), turn_deg=1)
        dimmed = np.clip(view(truth) * gain + offset, 0, 255).astype(np.uint8)
        found = register(dimmed, reference, params=PARAMS)
        assert found.accepted
        assert error_px(found, truth) < 0.15

    def test_cloud_shade_does_not_matter(self, view, reference):
        truth = motion(shift=(15, 9), turn_deg=1)
        shade = np.linspace(0.5, 1.1, COLUMNS)[None, :, None]
        found = register((view(truth) * shade).clip(0, 255).astype(np.uint8), reference, params=PARAMS)
        assert found.accepted
        assert error_px(found, truth) < 0.15

    @pytest.mark.parametrize("seed", range(4))
    def test_movers_on_two_fifths_of_the_ground_are_outvoted(self, view, reference, seed):
        truth, rng = motion(shift=(15, 9), turn_deg=1), np.random.default_rng(seed)
        frame = view(truth)
        moved = np.roll(frame, (5, -7), axis=(0, 1))  # all of them together, the worst case
        cells = cv2.resize((rng.random((10, 15)) < 0.4).astype(np.uint8), (COLUMNS, ROWS), interpolation=0) > 0
        found = register(np.where(cells[..., None], moved, frame), reference, params=PARAMS)
        assert found.accepted
        assert error_px(found, truth) < 0.3
        assert 0.3 < found.inlier_share < 1

    def test_repetitive_texture_does_not_slip_by_a_period(self, view):
        truth = motion(shift=(31, 0))
        col, row = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
        paving = (((col // 8) + (row // 8)) % 2 * 60.0)[..., None]

        def paved(frame, dx):
            return np.clip(frame * 0.5 + np.roll(paving, -dx, axis=1), 0, 255).astype(np.uint8)

        found = register(paved(view(truth), 31), prepare_reference(paved(view(), 0), params=PARAMS), params=PARAMS)
        assert found.accepted
        assert error_px(found, truth) < 0.3

    def test_frame_of_another_size(self, view, reference):
        cut = np.ascontiguousarray(view()[20:280, 30:400])
        found = register(cut, reference, params=PARAMS)
        assert found.accepted
        np.testing.assert_allclose(found.frame_to_reference, [[1, 0, 30], [0, 1, 20], [0, 0, 1]], atol=0.1)

    def test_wedge_without_data(self, view, reference):
        truth = motion(shift=(6, 4))
        frame = view(truth)
        frame[:, :60] = 0
        found = register(frame, reference, params=PARAMS)
        assert found.accepted
        assert error_px(found, truth) < 0.15


class TestRefusal:
    @pytest.mark.parametrize("value", [0, 128, 255])
    def test_uniform(self, reference, value):
        found = register(np.full((ROWS, COLUMNS, 3), value, np.uint8), reference, params=PARAMS)
        assert (found.accepted, found.reason, found.inliers) == (False, "blank", 0)

    @pytest.mark.parametrize("seed", range(3))
    def test_other_scene(self, reference, seed):
        found = register(make_scene(100 + seed, ROWS, COLUMNS), reference, params=PARAMS)
        assert (found.accepted, found.reason) == (False, "not_registered")
        assert np.isfinite(found.frame_to_reference).all()

    def test_mirrored(self, view, reference):
        assert not register(np.ascontiguousarray(view()[:, ::-1]), reference, params=PARAMS).accepted

    def test_noise(self, reference):
        noise = np.random.default_rng(2).integers(0, 255, (ROWS, COLUMNS, 3), np.uint8)
        assert register(noise, reference, params=PARAMS).reason == "not_registered"

    @pytest.mark.parametrize("value", [0, 230])
    @pytest.mark.parametrize("side", ["left", "bottom"])
    def test_half_covered(self, view, reference, value, side):
        frame = view(motion(shift=(6, 4)))
        frame[(slice(None), slice(0, COLUMNS // 2)) if side == "left" else (slice(ROWS // 2, None),)] = value
        assert register(frame, reference, params=PARAMS).reason == "partly_covered"

    def test_little_overlap(self, view, reference):
        found = register(
            view(motion(shift=(12, 8))), reference, params=PARAMS.model_copy(update={"min_overlap_share": 0.99})
        )
        assert found.reason == "little_overlap"

    def test_large_residual(self, view, reference):
        strict = PARAMS.model_copy(update={"max_residual_px": 0.001})
        assert register(view(motion(shift=(6, 4))), reference, params=strict).reason == "residual_too_large"


class TestOrderOfWork:
    def test_same_bytes_again_pickled_and_whatever_came_before(self, view, reference):
        frame = view(motion(shift=(15, 9), turn_deg=2))
        first = register(frame, reference, params=PARAMS)
        register(view(motion(shift=(-30, 2))), reference, params=PARAMS)
        threads = cv2.getNumThreads()
        try:
            for start, count in ((None, 1), (np.eye(3), 2), (motion(shift=(40, 40)), 1), (first.frame_to_reference, 2)):
                cv2.setNumThreads(count)
                again = register(frame, pickle.loads(pickle.dumps(reference)), start=start, params=PARAMS)
                assert again.frame_to_reference.tobytes() == first.frame_to_reference.tobytes()
                assert again.residual_px == first.residual_px
        finally:
            cv2.setNumThreads(threads)

    def test_start_helps_where_the_frame_alone_does_not_tell(self, view, reference, monkeypatch):
        truth = motion(shift=(15, 9), turn_deg=2)
        monkeypatch.setattr(
            "vtrack_batch.registration.alignment.pose_by_flow",
            lambda *_: Guess(motion(shift=(99, 0)), 0.1),
        )
        monkeypatch.setattr("vtrack_batch.registration.alignment.pose_by_features", lambda *_: None)
        assert not register(view(truth), reference, params=PARAMS).accepted
        found = register(view(truth), reference, start=motion(shift=(17, 8), turn_deg=1.8), params=PARAMS)
        assert found.accepted
        assert error_px(found, truth) < 0.15


class TestReference:
    def test_patches_are_spread_and_partly_held_out(self, reference):
        col, row = reference.centres_px.T
        assert np.histogram2d(row, col, bins=(3, 5), range=((0, ROWS), (0, COLUMNS)))[0].min() >= 5
        assert 0.2 < reference.held_out.mean() < 0.3
        held = reference.centres_px[reference.held_out]
        assert np.histogram2d(held[:, 1], held[:, 0], bins=(2, 3), range=((0, ROWS), (0, COLUMNS)))[0].min() >= 3

    def test_held_out_patches_do_not_touch_the_fit(self, view, reference):
        frame = view(motion(shift=(15, 9), turn_deg=1))
        spoilt = reference.patches.copy()
        spoilt[reference.held_out] = np.roll(spoilt[reference.held_out], 2, axis=2)
        honest = register(frame, reference, params=PARAMS)
        found = register(frame, replace(reference, patches=spoilt), params=PARAMS)
        # They have a say in how far the last search reaches and in affine or homography, but not in the fit itself.
        assert error_px(found, honest.frame_to_reference) < 0.1
        assert 1.5 < found.residual_px < 3.5  # two pixels off, as the held-out patches now say

    def test_no_patch_beside_missing_data(self, view):
        frame = view()
        frame[:, :80] = 0
        made = prepare_reference(frame, params=PARAMS)
        assert made.centres_px[:, 0].min() >= 80 + PARAMS.patch_px // 2

    @pytest.mark.parametrize("shape", [(ROWS, COLUMNS, 3), (8, 8, 3)])
    def test_reference_without_texture_is_refused(self, shape):
        with pytest.raises(UnusableFrame, match="blank"):
            prepare_reference(np.full(shape, 90, np.uint8), params=PARAMS)

    def test_wrong_arrays_are_refused(self, view, reference):
        with pytest.raises(ValueError, match="uint8"):
            register(view()[:, :, 0], reference, params=PARAMS)
        with pytest.raises(ValueError, match="uint8"):
            prepare_reference(view().astype(float), params=PARAMS)
