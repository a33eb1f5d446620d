"""Medians of wide squares agree with those of OpenCV, wherever they are asked for."""

import cv2
import numpy as np
import pytest

from vtrack_batch.detection.medians import REACH, medians


@pytest.mark.parametrize("shape", [(1, 1), (5, 31), (40, 17), (64, 90)])
@pytest.mark.parametrize("levels", [2, 12, 256])
def test_medians_are_exact_where_they_are_wanted_and_nothing_changes_elsewhere(
    shape: tuple[int, int], levels: int
) -> None:
    rng = np.random.default_rng(levels)
    plane = (rng.integers(0, levels, shape) * 255 // (levels - 1)).astype(np.uint8)
    wanted = (rng.random(shape) < 0.6).astype(np.uint8)
    expected = np.asarray(cv2.medianBlur(plane, 2 * REACH + 1)).reshape(shape)
    found = medians(plane, wanted)
    assert (found[wanted == 1] == expected[wanted == 1]).all()
    assert (found[wanted == 0] == plane[wanted == 0]).all()
