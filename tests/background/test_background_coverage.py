"""Wedges without data are told from dark ground by their size alone."""

from __future__ import annotations

import numpy as np
import pytest

from vtrack_batch.background.coverage import without_data


@pytest.mark.parametrize("corner", [(0, 0), (31, 47), (38, 50), (45, 86)])
def test_a_square_of_fifteen_pixels_is_a_wedge_wherever_it_lies(corner: tuple[int, int]) -> None:
    frame = np.full((60, 101, 3), 90, np.uint8)
    row, column = corner
    frame[row : row + 15, column : column + 15] = (2, 0, 3)
    missing = without_data(frame)
    assert missing is not None
    assert (missing[row : row + 15, column : column + 15] == 255).all()
    assert 225 <= (missing == 255).sum() <= 19 * 19


@pytest.mark.parametrize("size", [(14, 80), (80, 14)])
def test_what_is_narrower_is_dark_ground(size: tuple[int, int]) -> None:
    frame = np.full((90, 90, 3), 90, np.uint8)
    frame[3 : 3 + size[0], 5 : 5 + size[1]] = 0
    assert without_data(frame) is None


def test_dark_blue_is_a_colour() -> None:
    assert without_data(np.full((40, 50, 3), (0, 0, 4), np.uint8)) is None
