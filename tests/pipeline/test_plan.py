"""The plan says what is due and why, and nothing else changes it."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vtrack_batch.config.survey import Survey
from vtrack_batch.pipeline.plan import STEPS, Plan, cut_units, make_plan, reason_due

START = pd.Timestamp("2026-05-17T06:00:00Z")


def frames(seconds: list[float], sequence: str = "a/x", date: str = "2026-05-17") -> pd.DataFrame:
    times = pd.DatetimeIndex([START + pd.Timedelta(seconds=s) for s in seconds]).as_unit("us")
    names = [f"{sequence}-{s:07.1f}.jpg" for s in seconds]
    return pd.DataFrame(
        {
            "path": names,
            "t_utc": times,
            "sha256": [f"hash of {name}" for name in names],
            "beside": "",
            "sequence": sequence,
            "date": date,
        }
    ).sort_values("t_utc", ignore_index=True)


def plan(rows: pd.DataFrame, **sections: dict[str, object]) -> Plan:
    survey = Survey.model_validate({"execution": {"unit_s": 60.0, "halo_s": 10.0}, **sections})
    return make_plan(rows, survey, zones_text=None, learned={})


def keys(made: Plan) -> dict[str, str]:
    return {f"{piece.step} {piece.name}": piece.key for piece in made.pieces()}


def changed(before: Plan, after: Plan) -> set[str]:
    former = keys(before)
    return {name for name, key in keys(after).items() if former.get(name) != key}


TIMES = [float(s) for s in np.arange(0, 300, 2.5)]


def test_units_are_cut_by_the_clock_and_hold_every_frame_once() -> None:
    units = cut_units(frames([57.0, 59.0, 61.0, 130.0]), unit_s=60.0, halo_s=3.0)
    assert [len(unit.frames) for unit in units] == [2, 1, 1]
    assert [[ref.path[-11:-4] for ref in unit.halo] for unit in units] == [["00061.0"], ["00059.0"], []] or [
        len(unit.halo) for unit in units
    ] == [1, 1, 0]


@settings(deadline=None)
@given(st.permutations(range(len(TIMES))))
def test_the_order_of_listing_does_not_matter(order: list[int]) -> None:
    rows = frames(TIMES)
    shuffled = rows.iloc[order].sort_values("t_utc", ignore_index=True)
    assert keys(plan(rows)) == keys(plan(shuffled))


def test_a_late_frame_touches_its_unit_and_its_day_only() -> None:
    before = plan(frames(TIMES))
    late = changed(before, plan(frames(sorted([*TIMES, 91.0]))))
    assert {name for name in late if name.startswith("detect")} == {"detect a/x 2026-05-17T06:01:00Z"}
    assert {name.split()[0] for name in late} == set(STEPS)


def test_a_late_frame_near_a_border_touches_the_neighbour_too() -> None:
    late = changed(plan(frames(TIMES)), plan(frames(sorted([*TIMES, 119.0]))))
    units = {name for name in late if name.startswith("detect")}
    assert units == {"detect a/x 2026-05-17T06:01:00Z", "detect a/x 2026-05-17T06:02:00Z"}


def test_another_day_is_left_alone() -> None:
    other = frames(TIMES, "a/y", "2026-05-18")
    both = pd.concat([frames(TIMES), other], ignore_index=True)
    more = pd.concat([frames(sorted([*TIMES, 91.0])), other], ignore_index=True)
    assert not any("a/y" in name or "2026-05-18" in name for name in changed(plan(both), plan(more)))


@pytest.mark.parametrize(
    ("sections", "steps"),
    [
        ({"detection": {"weak_score": 0.3}}, {"detect", "track", "traffic", "picture"}),
        ({"tracking": {"min_sightings": 3}}, {"track", "traffic", "picture"}),
        ({"traffic": {"bin_s": 300}}, {"traffic", "picture"}),
        ({"survey": {"name": "other"}}, {"picture"}),
        ({"execution": {"unit_s": 60.0, "halo_s": 10.0, "workers": 2}}, set()),
    ],
)
def test_a_changed_parameter_redoes_its_step_and_what_follows(
    sections: dict[str, dict[str, object]], steps: set[str]
) -> None:
    rows = frames(TIMES)
    assert {name.split()[0] for name in changed(plan(rows), plan(rows, **sections))} == steps


def test_the_reason_names_what_changed() -> None:
    rows = frames(TIMES)
    before, after = plan(rows), plan(rows, traffic={"bin_s": 300})
    former = dict(before.traffic[0].ingredients)
    assert reason_due(after.traffic[0], former) == "changed: traffic"
    assert reason_due(after.traffic[0], None) == "new"
    assert reason_due(before.traffic[0], former) == "its result is missing"
