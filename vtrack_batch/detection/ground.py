"""Candidates in metres on the ground: one matrix takes the centre and the half axes of every box there."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vtrack_batch.detection.candidates import Candidates
from vtrack_batch.model import homography
from vtrack_batch.model.flags import DetectionFlag
from vtrack_batch.model.homography import Array


def measure_on_ground(candidates: Candidates, frame_to_ground: Array) -> pd.DataFrame:
    """Return the frame's part of table ``detections``: place, size and axis on the ground beside what the picture says.

    *frame_to_ground* (3, 3) takes frame px to ground metres (x right, y up). Rows keep the candidates' order; columns
    are x_m, y_m, length_m, width_m, heading_deg (0-180), area_m2, col_px, row_px, red, green, blue, contrast, source,
    flags. The axes go through the local linear part of the map, so size and heading are right under scale, rotation,
    and unequal distances along rows and columns.
    """
    centre_px = np.stack([candidates.col_px, candidates.row_px], axis=1)
    centre = homography.apply(frame_to_ground, centre_px)
    local = homography.jacobian(frame_to_ground, centre_px)
    front = np.einsum("nij,nj->ni", local, np.stack([candidates.lx_px, candidates.ly_px], axis=1))
    side = np.einsum("nij,nj->ni", local, np.stack([candidates.wx_px, candidates.wy_px], axis=1))
    return pd.DataFrame(
        {
            "x_m": centre[:, 0],
            "y_m": centre[:, 1],
            "length_m": 2 * np.hypot(front[:, 0], front[:, 1]),
            "width_m": 2 * np.hypot(side[:, 0], side[:, 1]),
            "heading_deg": np.degrees(np.arctan2(front[:, 0], front[:, 1])) % 180.0,
            "area_m2": candidates.area_px * np.abs(np.linalg.det(local)),
            "col_px": candidates.col_px,
            "row_px": candidates.row_px,
            "red": candidates.red,
            "green": candidates.green,
            "blue": candidates.blue,
            "contrast": candidates.contrast,
            "source": pd.Categorical(
                np.where(candidates.flags & DetectionFlag.IN_BACKGROUND, "colour", "background"),
                categories=["background", "colour", "both"],
            ),
            "flags": candidates.flags,
        }
    )
