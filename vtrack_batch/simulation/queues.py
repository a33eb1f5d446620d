"""True queues: vehicles that stand, or crawl close behind one another, on the way into a junction."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation.counts import Clock
from vtrack_batch.simulation.fleet import Fleet
from vtrack_batch.simulation.places import Places
from vtrack_batch.simulation.traffic import Motion

_CRAWL_MPS = 5 / 3.6
_REACH_M, _GAP_M = 25.0, 15.0
"""Longest clear distance from the junction to the first, and from one to the next vehicle of a queue."""
_COLUMNS = (
    "place", "t_start_utc", "t_end_utc", "vehicles_max", "length_max_m", "head_x_m", "head_y_m", "tail_x_m", "tail_y_m",
    "tail_speed_mps",
)  # fmt: skip


def queue_table(moved: Motion, fleet: Fleet, places: Places, clock: Clock, to_ground: Array) -> pd.DataFrame:
    """Return the table ``queues``: one row per arm and unbroken time with two or more vehicles in its queue.

    Queues stand on the lanes that lead to the arm. ``length_max_m`` reaches from the junction to the rear of the last
    vehicle; head and tail are vehicles' centres at the moment of the greatest length; ``tail_speed_mps`` is how fast
    the tail had moved back until then.
    """
    lines = queued(moved, fleet, places)
    if not len(lines):
        return pd.DataFrame(columns=list(_COLUMNS))
    whole = lines.groupby(["arm", "step"])
    at = whole.agg(vehicles=("row", "size"), length_m=("rear_m", "max")).reset_index()
    at = at[at["vehicles"] >= 2]
    edges = lines.sort_values(["arm", "step", "rear_m"])
    by_rear = edges.groupby(["arm", "step"])["row"]
    at = at.merge(by_rear.agg(head="first", tail="last").reset_index(), on=["arm", "step"])
    spell = ((at["arm"] != at["arm"].shift()) | (at["step"] > at["step"].shift() + 1)).cumsum()
    spells = at.groupby(spell)
    peak = at.loc[spells["length_m"].idxmax()].reset_index(drop=True)
    first = spells.first().reset_index(drop=True)
    took_s = (peak["step"] - first["step"]) * moved.period_s
    head, tail = (apply(to_ground, moved.xy_m[peak[end].to_numpy(np.int64)]) for end in ("head", "tail"))
    columns = (
        np.array([arm.id for arm in places.arms], object)[peak["arm"].to_numpy(np.int64)],
        *(_when(clock, step.to_numpy() * moved.period_s) for step in (first["step"], spells["step"].last())),
        spells["vehicles"].max().to_numpy(np.int32),
        peak["length_m"],
        *head.T,
        *tail.T,
        (peak["length_m"] - first["length_m"]) / took_s.where(took_s > 0),
    )
    table = pd.DataFrame(dict(zip(_COLUMNS, columns, strict=True)))
    return table.sort_values(["place", "t_start_utc"], ignore_index=True)


def _when(clock: Clock, t_s: Array) -> pd.DatetimeIndex:
    return (clock.t_utc[0] + pd.to_timedelta(t_s, unit="s")).round("ms").as_unit("us")


def queued(moved: Motion, fleet: Fleet, places: Places) -> pd.DataFrame:
    """Return the samples that stand in a queue: arm, step, row (of *moved*), rear_m (of the vehicle, from the border).

    On each lane the queue is counted from the junction on, until a vehicle drives or a gap opens.
    """
    parts = []
    slow = np.flatnonzero((moved.speed_mps < _CRAWL_MPS) & (moved.step >= 0))
    for k, arm in enumerate(places.arms):
        lanes = [moved.lanes.index(lane) for lane in arm.lanes_in if lane in moved.lanes]
        row = slow[np.isin(moved.lane[slow], lanes)]
        half = fleet.looks.length_m[moved.vehicle[row]] / 2
        ahead = moved.ahead_m[row]
        parts.append(
            pd.DataFrame(
                {"arm": k, "step": moved.step[row], "row": row, "lane": moved.lane[row], "front_m": ahead,
                 "rear_m": ahead + 2 * half}
            )
        )  # fmt: skip
    if not parts:
        return pd.DataFrame({"arm": [], "step": [], "row": [], "rear_m": []})
    rows = pd.concat(parts, ignore_index=True).sort_values(["arm", "step", "lane", "front_m"], ignore_index=True)
    same = (rows[["arm", "step", "lane"]] == rows[["arm", "step", "lane"]].shift()).all(axis=1)
    clear = rows["front_m"] - rows["rear_m"].shift().where(same, 0.0)
    broken = clear > np.where(same, _GAP_M, _REACH_M)
    return rows[~broken.groupby([rows["arm"], rows["step"], rows["lane"]]).cummax()]
