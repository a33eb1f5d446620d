"""What no vehicle does is not followed, and what hardly one does is flagged."""

import numpy as np
import pandas as pd
import pytest
from tracking_worlds import labels, street, times, utc

from vtrack_batch.model.flags import TrajectoryFlag
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.tracking.track import track

LIMIT_MPS = TrackingParams().motion.max_speed_mps


def lone(x_m, interval_s, y_m=30.0):
    """A vehicle beside the street, at one place for each frame."""
    t = np.arange(len(x_m)) * interval_s
    table = pd.DataFrame({"t_utc": times(t), "x_m": x_m, "y_m": y_m, "red": 220.0, "green": 30.0, "blue": 40.0})
    return table.assign(truth=99, speed=np.nan, detection_id=[f"lone{n:03d}" for n in range(len(x_m))])


def driven(speeds_mps, interval_s):
    return np.cumsum(np.asarray(speeds_mps) * interval_s)


@pytest.mark.parametrize("interval_s", [0.5, 1.5, 2.5])
def test_what_is_elsewhere_in_no_time_is_not_one_vehicle(interval_s):
    """Fault 69: a red vehicle here until half-time, one as red 400 m on from then on."""
    frames = 20
    x_m = driven(np.full(frames, 12.0), interval_s)
    x_m[frames // 2 :] += 400.0
    world = utc(pd.concat([street(interval_s, frames), lone(x_m, interval_s)], ignore_index=True))
    tracks = track(world)
    mine = labels(tracks, world).query("truth == 99").sort_values("t_utc")
    before, after = mine["vehicle_id"].iloc[: frames // 2], mine["vehicle_id"].iloc[frames // 2 :]
    assert before.nunique() == after.nunique() == 1
    assert before.iloc[0] != after.iloc[0]
    assert tracks.track_points["speed_mps"].max() < LIMIT_MPS


def test_a_stop_harder_than_any_brake_is_flagged_and_no_other():
    """Fault 69."""
    interval_s = 0.5
    x_m = driven([28.0] * 12 + [0.0] * 12, interval_s)
    world = utc(pd.concat([street(interval_s, 24), lone(x_m, interval_s)], ignore_index=True))
    tracks = track(world)
    hard = tracks.trajectories.set_index("vehicle_id")["flags"].astype(int) & int(TrajectoryFlag.IMPLAUSIBLE_SPEED)
    mine = set(labels(tracks, world).query("truth == 99")["vehicle_id"].astype(str))
    assert {str(name) for name in hard.index[hard > 0]} == mine
