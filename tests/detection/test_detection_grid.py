"""Whole grids are asked for the road at once: the answer is that of their points one by one."""

from __future__ import annotations

import numpy as np
import pytest

from vtrack_batch.detection.place import Place


@pytest.mark.parametrize("origin_m", [(0.0, 0.0), (3.3, -2.1), (-7.0, 40.0)])
def test_a_grid_says_what_its_points_say(origin_m: tuple[float, float]) -> None:
    road = np.random.default_rng(4).random((37, 61)) < 0.4
    place = Place(road, np.array(origin_m), (0.3, 0.3), True, False, ())
    x_m, y_m = np.arange(-5.0, 40.0, 0.7), np.arange(-8.0, 30.0, 1.1)
    points = np.stack(np.meshgrid(x_m, y_m), axis=-1).reshape(-1, 2)
    on = place.on_grid(x_m, y_m)
    assert on.shape == (len(y_m), len(x_m))
    np.testing.assert_array_equal(on.ravel(), place.on_road(points))
    assert on.any() == (origin_m[1] < 30)
