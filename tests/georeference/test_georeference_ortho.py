"""Pictures lie on the ground where their pixels do, and pictures of neighbours share pixels."""

from __future__ import annotations

import numpy as np
import pytest

from vtrack_batch.errors import UnusableData
from vtrack_batch.georeference.ortho import orthorectify
from vtrack_batch.model import homography
from vtrack_batch.model.ground_grid import GroundGrid


def to_ground(gsd_m, x=0.0, y=0.0):
    return np.array([[gsd_m, 0, x + gsd_m / 2], [0, -gsd_m, y - gsd_m / 2], [0, 0, 1]])


def picture(rows, columns):
    col, row = np.meshgrid(np.arange(columns), np.arange(rows))
    return np.stack([col % 251, row % 251, (col + 2 * row) % 251], axis=2).astype(np.uint8)


class TestGrid:
    def test_edges_lie_on_multiples_and_cover(self):
        corners = np.array([[10.1, 3.9], [25.2, 3.9], [25.2, -7.3], [10.1, -7.3]])
        grid = GroundGrid.covering(corners, 0.5, crs="EPSG:26913")
        assert (grid.x_min_m, grid.y_max_m, grid.shape, grid.crs) == (10.0, 4.0, (23, 31), "EPSG:26913")

    def test_corners_on_edges_cost_no_extra_pixels(self):
        grid = GroundGrid.covering(homography.apply(to_ground(0.1), homography.corners(70, 40)), 0.1)
        assert grid.shape == (40, 70)

    def test_first_pixel_lies_half_a_pixel_inside_the_corner(self):
        grid = GroundGrid(None, 480_000.0, 4_301_000.0, 0.33, (100, 200))
        np.testing.assert_allclose(homography.apply(grid.to_ground, np.zeros((1, 2)))[0], [480_000.165, 4_300_999.835])
        last = homography.apply(grid.to_ground, np.array([[199.0, 99.0]]))[0]
        np.testing.assert_allclose(last, [480_000.0 + 199.5 * 0.33, 4_301_000.0 - 99.5 * 0.33])

    @pytest.mark.parametrize("corners", [[[0, 0], [np.inf, 1]], [[0, 0], [1e7, 1e7]]])
    def test_absurd_pictures_are_refused(self, corners):
        with pytest.raises(UnusableData):
            GroundGrid.covering(np.array(corners, float), 0.33)


class TestOrtho:
    def test_aligned_picture_is_copied(self):
        pixels, place = picture(40, 70), to_ground(0.5, 100, 200)
        grid = GroundGrid.covering(homography.apply(place, homography.corners(70, 40)), 0.5)
        out, valid = orthorectify(pixels, place, grid)
        assert valid.all()
        np.testing.assert_array_equal(out, pixels)

    def test_quarter_turn(self):
        pixels = picture(40, 70)
        east_up = np.array([[0, -0.5, 300.0], [-0.5, 0, 900.0], [0, 0, 1]])  # the frame's top points east
        grid = GroundGrid.covering(homography.apply(east_up, homography.corners(70, 40)), 0.5)
        out, valid = orthorectify(pixels, east_up, grid)
        assert grid.shape == (71, 41)  # centres of the frame lie on edges of the grid
        assert 0.9 < valid.mean() <= 1
        inner = np.zeros_like(valid)
        inner[2:-2, 2:-2] = True
        source = homography.apply(np.linalg.inv(east_up) @ grid.to_ground, np.argwhere(inner)[:, ::-1].astype(float))
        np.testing.assert_allclose(out[inner][:, :2], source, atol=0.6)  # the ramps tell col and row

    def test_coarser_grid_averages(self):
        pixels = np.zeros((64, 96, 3), np.uint8)
        pixels[::2, ::2] = 200  # mean 50, whatever the phase
        place = to_ground(0.1)
        grid = GroundGrid.covering(homography.apply(place, homography.corners(96, 64)), 0.4)
        out, valid = orthorectify(pixels, place, grid)
        assert out.shape == (16, 24, 3)
        assert valid.all()
        np.testing.assert_array_equal(out, 50)

    def test_unseen_and_outside_are_black_and_invalid(self):
        pixels, place = np.full((20, 30, 3), 9, np.uint8), to_ground(1.0)
        seen = np.ones((20, 30), bool)
        seen[5:8, 10:14] = False
        grid = GroundGrid(None, -2.0, 1.0, 1.0, (24, 36))
        out, valid = orthorectify(pixels, place, grid, seen=seen)
        assert valid.sum() == 20 * 30 - 12
        assert not valid[6:9, 12:16].any()
        assert not valid[0].any()
        assert (out[~valid] == 0).all()
        assert (out[valid] == 9).all()

    def test_grids_taller_than_one_strip(self):
        pixels, place = picture(1500, 8), to_ground(1.0)
        grid = GroundGrid.covering(homography.apply(place, homography.corners(8, 1500)), 1.0)
        np.testing.assert_array_equal(orthorectify(pixels, place, grid)[0], pixels)
