"""Templates are drawn once for frames of nearly one scale, and as large as vehicles are."""

from __future__ import annotations

import numpy as np
import pytest

from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.detection.templates import draw_templates

PARAMS = DetectionParams()


def test_frames_of_a_block_share_one_drawing() -> None:
    first = draw_templates((3.030, 3.030), (0.6, 0.8), PARAMS)
    assert draw_templates((3.031, 3.0295), (0.601, 0.7993), PARAMS) is first
    assert draw_templates((3.09, 3.09), (0.6, 0.8), PARAMS) is not first
    assert draw_templates((3.030, 3.030), None, PARAMS) is not first


@pytest.mark.parametrize("px_per_m", [(2.1, 3.7), (3.017, 3.043), (4.4, 4.4)])
def test_half_axes_are_those_of_the_scale_asked_for_to_half_a_percent(px_per_m: tuple[float, float]) -> None:
    drawn = draw_templates(px_per_m, None, PARAMS)
    metres = drawn.half_axes[..., :2] / np.array(px_per_m)
    half_lengths = np.array(PARAMS.sizes_m)[:, 0] / 2
    assert np.abs(np.linalg.norm(metres, axis=-1) / half_lengths - 1).max() <= 0.0026
    assert drawn.margin > 17.0 / 2 * max(px_per_m)
