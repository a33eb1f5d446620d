from __future__ import annotations

import numpy as np

from vtrack_batch.detection.candidates import Candidates
from vtrack_batch.detection.ground import measure_on_ground
from vtrack_batch.model.tables import TABLES


def one(lx: float, ly: float, wx: float, wy: float, count: int = 1) -> Candidates:
    def some(value: float) -> np.ndarray:
        return np.full(count, value)

    return Candidates(
        some(101.0), some(42.0), some(lx), some(ly), some(wx), some(wy), some(30.0), some(10.0), some(20.0),
        some(30.0), some(55.0), some(0.8), np.full(count, 5, np.int32),
    )  # fmt: skip


TO_GROUND = np.array([[0.5, 0, 1000.0], [0, -0.25, 2000.0], [0, 0, 1]])
"""0.5 m along columns, 0.25 m along rows, y up."""


def test_place_size_and_area_in_metres() -> None:
    row = measure_on_ground(one(5, 0, 0, 4), TO_GROUND).iloc[0]
    assert np.isclose(row["x_m"], 1050.5)
    assert np.isclose(row["y_m"], 1989.5)
    assert np.isclose(row["length_m"], 5.0)
    assert np.isclose(row["width_m"], 2.0)
    assert np.isclose(row["area_m2"], 30 * 0.125)
    assert np.isclose(row["heading_deg"], 90.0)


def test_heading_is_clockwise_from_north() -> None:
    north = measure_on_ground(one(0, 8, 2, 0), TO_GROUND).iloc[0]
    assert np.isclose(north["heading_deg"] % 180, 0.0)
    assert np.isclose(north["length_m"], 4.0)
    north_east = measure_on_ground(one(4, -8, 1, 1), TO_GROUND).iloc[0]
    assert np.isclose(north_east["heading_deg"], 45.0)
    south_east = measure_on_ground(one(4, 8, 1, 1), TO_GROUND).iloc[0]
    assert np.isclose(south_east["heading_deg"], 135.0)


def test_columns_are_those_of_the_data_dictionary() -> None:
    found = measure_on_ground(one(5, 0, 0, 4, count=3), TO_GROUND)
    assert set(found.columns) == set(TABLES["detections"].column_names) - {
        "detection_id", "frame_id", "sequence", "t_utc", "vx_mps", "vy_mps"
    }  # fmt: skip
    assert (found["source"] == "background").all()
    assert (found["flags"] == 5).all()


def test_no_candidates_give_no_rows() -> None:
    found = measure_on_ground(one(5, 0, 0, 4, count=0), TO_GROUND)
    assert len(found) == 0
    assert found["x_m"].dtype == np.float64
