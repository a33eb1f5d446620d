"""Boxes that drive so close behind one another that no driver would are one vehicle; all others stay apart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from vtrack_batch.revision.params import RevisionParams
from vtrack_batch.revision.parts import joined_parts
from vtrack_batch.revision.tracked import tracked

START = pd.Timestamp("2026-05-17T08:00:00Z").as_unit("us")
EVERY_S, FRAMES, GSD_M = 1.5, 12, 0.3
EAST_BY_NORTH = np.array([0.8, 0.6])
PARAMS = RevisionParams()


def drive(vehicle: str, ahead_m: float, speed_mps: float, *, beside_m: float = 0.0, **more: Any) -> pd.DataFrame:
    """A box *ahead_m* along the road at the first frame, *beside_m* to the left of the lane, as seen and tracked."""
    frame = np.arange(FRAMES)
    side = np.array([-EAST_BY_NORTH[1], EAST_BY_NORTH[0]])
    xy = (ahead_m + speed_mps * EVERY_S * frame)[:, None] * EAST_BY_NORTH + beside_m * side
    usual = {"length_m": 4.5, "width_m": 1.8, "area_m2": 8.0, "red": 60.0, "green": 60.0, "blue": 60.0, "flags": 0}
    return pd.DataFrame(
        {
            "vehicle_id": vehicle,
            "frame": frame,
            "t_utc": START + pd.to_timedelta(frame * EVERY_S, unit="s").astype("timedelta64[us]"),
            "x_m": xy[:, 0],
            "y_m": xy[:, 1],
            "col_px": xy[:, 0] / GSD_M,
            "row_px": -xy[:, 1] / GSD_M,
            "vx_mps": speed_mps * EAST_BY_NORTH[0],
            "vy_mps": speed_mps * EAST_BY_NORTH[1],
            "speed_mps": abs(speed_mps),
            "heading_deg": np.degrees(np.arctan2(*EAST_BY_NORTH)) % 180,
            **usual,
            **more,
        }
    )


def revised(*drives: pd.DataFrame, seed: int = 0) -> pd.DataFrame:
    """Return what is left of the detections of all drives, given in an order of rows that tells nothing."""
    rows = pd.concat(drives).sample(frac=1, random_state=seed).reset_index(drop=True)
    rows["detection_id"] = [f"d{number:04d}" for number in range(len(rows))]
    found, too_many = joined_parts(rows, tracked(rows, rows), PARAMS)
    return found.drop(index=too_many).sort_values(["frame", "vehicle_id"], ignore_index=True)


def test_a_cab_and_its_load_become_one_box_around_both() -> None:
    # 3 m of cab, 1 m of nothing, 8 m of load: 12 m, whose middle is 4.5 m behind that of the cab
    cab = drive("v-a", 100.0, 12.0, length_m=3.0, width_m=2.2)
    load = drive("v-b", 93.5, 12.0, length_m=8.0, width_m=2.5)
    found = revised(cab, load.iloc[2:])
    assert len(found) == FRAMES
    both = found[found["frame"] >= 2]
    along = both[["x_m", "y_m"]].to_numpy() @ EAST_BY_NORTH
    assert along == pytest.approx(95.5 + 18.0 * both["frame"].to_numpy(), abs=1e-6)
    assert both["length_m"].to_numpy() == pytest.approx(12.0, abs=1e-6)
    assert both["width_m"].to_numpy() == pytest.approx(2.5)
    assert both["area_m2"].to_numpy() == pytest.approx(16.0)
    assert both["col_px"].to_numpy() == pytest.approx(both["x_m"].to_numpy() / GSD_M)
    assert both["row_px"].to_numpy() == pytest.approx(-both["y_m"].to_numpy() / GSD_M)
    alone = found[found["frame"] < 2]
    assert alone["length_m"].to_numpy() == pytest.approx(3.0), "what was seen alone is left as it was seen"


def test_three_parts_of_a_bus_become_one() -> None:
    parts = [drive(f"v-{n}", 50.0 - 6.0 * n, 9.0, length_m=5.0, width_m=2.5) for n in range(3)]
    found = revised(*parts)
    assert len(found) == FRAMES
    assert found["length_m"].to_numpy() == pytest.approx(17.0, abs=1e-6)


def test_parts_whose_tracks_part_are_not_joined_from_afar() -> None:
    load = drive("v-b", 93.5, 12.0, length_m=8.0)
    load.loc[load["frame"] >= 8, ["x_m", "y_m"]] -= 90.0 * EAST_BY_NORTH
    found = revised(drive("v-a", 100.0, 12.0, length_m=3.0), load)
    assert len(found) == FRAMES + 4
    assert found["length_m"].max() == pytest.approx(12.0)


def test_a_chain_of_boxes_longer_than_any_vehicle_is_left_as_it_is() -> None:
    found = revised(*(drive(f"v-{n}", 50.0 - 6.0 * n, 9.0, length_m=5.0) for n in range(4)))
    assert len(found) == 4 * FRAMES
    assert found["length_m"].to_numpy() == pytest.approx(5.0)


@pytest.mark.parametrize(
    "others",
    [
        pytest.param([drive("v-b", 100.0 - 4.5 - 6.0, 12.0)], id="half a second behind at 12 m/s"),
        pytest.param([drive("v-b", 100.0 - 4.5 - 1.0, 2.0), drive("v-c", 100.0, 2.0)], id="a queue that creeps"),
        pytest.param([drive("v-b", 100.0, 12.0, beside_m=3.0)], id="side by side"),
        pytest.param([drive("v-b", 112.0, -12.0, beside_m=1.0)], id="one that comes the other way"),
        pytest.param([drive("v-b", 85.0, 12.6)], id="one that comes nearer, at last as near as a part"),
    ],
)
def test_vehicles_of_their_own_stay_as_they_are(others: list[pd.DataFrame]) -> None:
    drives = [drive("v-a", 100.0, 12.0), *others]
    found = revised(*drives)
    before = pd.concat(drives).sort_values(["frame", "vehicle_id"], ignore_index=True)
    pd.testing.assert_frame_equal(found.drop(columns="detection_id"), before, check_dtype=False)


def test_the_order_of_rows_changes_nothing() -> None:
    drives = [drive("v-a", 100.0, 12.0, length_m=3.0), drive("v-b", 94.0, 12.0, length_m=7.0), drive("v-c", 40.0, 9.0)]
    one, other = (revised(*drives, seed=seed).drop(columns="detection_id") for seed in (1, 2))
    pd.testing.assert_frame_equal(one, other)


def test_nothing_and_one_alone_are_left_alone() -> None:
    alone = drive("v-a", 0.0, 12.0)
    assert len(revised(alone)) == FRAMES
    assert revised(alone.iloc[:0]).empty
