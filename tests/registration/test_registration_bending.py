"""Frames that no plane pose fits: how far they bend is found, taken out, and nothing else is moved."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from registration_scenes import COLUMNS, MARGIN, ROWS, SCENE, motion, view, wave

from vtrack_batch.registration.bending import Bend, common_picture, find_bend, residual_px, straighten
from vtrack_batch.registration.params import RegistrationParams

PARAMS = RegistrationParams()
GRID = np.stack(np.meshgrid(np.arange(20, COLUMNS - 20, 8), np.arange(20, ROWS - 20, 8)), axis=-1).reshape(-1, 2)


def rms(vectors):
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def straight_of(points, shift):
    """Return where points of a bent frame lie in the straight one."""
    return points - shift(points)


@pytest.mark.parametrize("size_px", [0.8, 2.5])
def test_a_smooth_distortion_is_recovered_under_any_pose(size_px):
    shift, picture = wave(size_px), common_picture([(view(), np.eye(3))])
    for pose in (np.eye(3), motion(shift=(9.3, -5.6), turn_deg=2, scale=1.03)):
        bend = find_bend(view(pose, shift, seed=2), pose, picture, params=PARAMS)
        wanted = straight_of(GRID, shift)
        left = rms(bend.to_straight(GRID.astype(float)) - wanted)
        assert 0.005 < left < 0.3 * rms(shift(GRID))


def test_a_frame_that_fits_is_hardly_moved():
    picture = common_picture([(view(), np.eye(3))])
    for pose in (motion(shift=(-7.4, 3.2), turn_deg=-3), motion(scale=0.97, tilt=(2e-5, -1e-5))):
        bend = find_bend(view(pose, seed=3), pose, picture, params=PARAMS)
        assert 0.0 < rms(bend.shift_px.reshape(-1, 2)) < 0.08


def test_straightening_gives_back_the_straight_frame():
    shift, clean = wave(2.5), view(noise=0)
    bent = view(shift=shift, noise=0)
    bend = find_bend(bent, np.eye(3), common_picture([(clean, np.eye(3))]), params=PARAMS)
    inner = slice(20, ROWS - 20), slice(20, COLUMNS - 20)
    before = np.abs(bent[inner].astype(float) - clean[inner]).mean()
    after = np.abs(straighten(bent, bend)[inner].astype(float) - clean[inner]).mean()
    assert 0.2 < after < 0.5 * before


def test_points_and_pixels_are_moved_alike():
    pixels = np.zeros((240, 320, 3), np.uint8)
    pixels[100:104, 150:154] = 200
    bend = Bend(np.broadcast_to(np.array([3.25, -1.5], np.float32), (30, 40, 2)).copy())
    moved_rows, moved_columns = np.nonzero(straighten(pixels, bend)[:, :, 1] > 90)
    middle = bend.to_straight(np.array([[151.5, 101.5]]))[0]
    np.testing.assert_allclose(middle, [148.25, 103.0], atol=1e-6)
    assert abs(moved_columns.mean() - middle[0]) < 0.6
    assert abs(moved_rows.mean() - middle[1]) < 0.6
    np.testing.assert_allclose(bend.to_frame(middle[None])[0], [151.5, 101.5], atol=1e-6)


def test_no_shift_leaves_every_pixel_as_it_is():
    pixels = view(seed=5)
    still = Bend(np.zeros((ROWS // 8, COLUMNS // 8, 2), np.float32))
    np.testing.assert_array_equal(straighten(pixels, still), pixels)


@pytest.mark.parametrize("size", [(37, 15), (100, 21)])
def test_a_slow_vehicle_is_not_drawn_onto_its_place_in_the_picture(size):
    def scene(x):
        shown = SCENE.copy()
        left, top = MARGIN + 150 + x, MARGIN + 140
        shown[top : top + size[1], left : left + size[0]] = (40, 60, 150)
        shown[top + 3 : top + size[1] - 3, left + size[0] // 2 : left + size[0] // 2 + 6] = (220, 220, 230)
        return shown

    picture = common_picture([(view(scene=scene(0)), np.eye(3))])
    middle = np.array([[150.0 + size[0] / 2 + 3, 140.0 + size[1] / 2]])
    bend = find_bend(view(scene=scene(3), seed=4), np.eye(3), picture, params=PARAMS)
    # It drove on by 3 px: less than a tenth of that may be taken for a bend.
    assert np.linalg.norm(bend.to_straight(middle) - middle) < 0.3


def test_the_common_picture_is_the_median_and_shows_no_passer_by():
    passing = SCENE.copy()
    passing[MARGIN + 100 : MARGIN + 140, MARGIN + 200 : MARGIN + 260] = 255
    frames = [(view(seed=1), np.eye(3)), (view(seed=2, scene=passing), np.eye(3)), (view(seed=3), np.eye(3))]
    alone = common_picture(frames[:1]).astype(int)
    both = common_picture(frames).astype(int)
    assert both.shape == (ROWS // 2, COLUMNS // 2)
    assert np.abs(both - alone).mean() < 8
    assert np.abs(common_picture(frames[1:2]).astype(int) - alone)[50:70, 100:130].mean() > 20


def test_residual_is_that_of_the_straightened_frame():
    shift = wave(2.0)
    nodes = np.stack(np.meshgrid(np.arange(COLUMNS // 8), np.arange(ROWS // 8)), axis=-1) * 8 + 3.5
    bend = Bend(shift(nodes.reshape(-1, 2)).reshape(ROWS // 8, COLUMNS // 8, 2).astype(np.float32))
    seen = GRID.astype(float)
    there = straight_of(seen, shift)
    seen[::7] = np.nan
    rigid, bent = (residual_px(seen, there, np.eye(3), given) for given in (None, bend))
    assert 0.8 < rigid < 2.5
    assert 0.0 < bent < 0.1
    assert residual_px(seen[::7], there[::7], np.eye(3), None) == float("inf")


def test_small_frames_and_blank_ones_are_left_alone():
    small = view()[:90, :120]
    bend = find_bend(small, np.eye(3), common_picture([(small, np.eye(3))]), params=PARAMS)
    assert not bend.shift_px.any()
    blank = np.full((ROWS, COLUMNS, 3), 90, np.uint8)
    bend = find_bend(blank, np.eye(3), common_picture([(blank, np.eye(3))]), params=PARAMS)
    assert np.abs(bend.shift_px).max() < 0.2


def test_threads_do_not_change_a_bit():
    picture, bent = common_picture([(view(), np.eye(3))]), view(shift=wave(2.0), seed=6)
    found, threads = [], cv2.getNumThreads()
    for count in (1, 3):
        try:
            cv2.setNumThreads(count)
            found.append(find_bend(bent, np.eye(3), picture, params=PARAMS).shift_px)
        finally:
            cv2.setNumThreads(threads)
    np.testing.assert_array_equal(*found)
