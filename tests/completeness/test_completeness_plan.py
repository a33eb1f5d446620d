"""Where vehicles are painted, who stands, and what is made of those that come back."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from vtrack_batch.completeness.boxes import grown, mapped, overlaps
from vtrack_batch.completeness.estimate import completeness
from vtrack_batch.completeness.injection import Glimpse, Injections, lone, plan_injections
from vtrack_batch.completeness.motion import moving, stays_of
from vtrack_batch.completeness.params import CompletenessParams
from vtrack_batch.completeness.sightings import came_back, paint_of

GSD = (0.5, 0.5)


def boxes_at(places: list[tuple[float, float]], angle_deg: float = 0.0, length: float = 9.0) -> np.ndarray:
    turn = np.radians(angle_deg)
    half = [np.cos(turn) * length / 2, np.sin(turn) * length / 2, -np.sin(turn) * 2, np.cos(turn) * 2]
    return np.array([[*place, *half] for place in places]).reshape(-1, 6)


def test_boxes_overlap_as_polygons_do() -> None:
    from shapely import box as rectangle
    from shapely.affinity import rotate, translate

    rng = np.random.default_rng(3)
    centre, angle = rng.uniform(0, 40, (40, 2)), rng.uniform(0, 180, 40)
    boxes = np.concatenate([boxes_at([tuple(c)], a) for c, a in zip(centre, angle, strict=True)])
    shapes = [
        translate(rotate(rectangle(-4.5, -2, 4.5, 2), a, origin=(0, 0)), *c) for c, a in zip(centre, angle, strict=True)
    ]
    expected = np.array([[one.intersects(other) for other in shapes] for one in shapes])
    assert (overlaps(boxes, boxes) == expected).all()
    assert 40 < expected.sum() < 1600


def test_boxes_go_through_a_map_and_back() -> None:
    turn = np.array([[0.0, -2.0, 5.0], [2.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    boxes = boxes_at([(3, 4), (10, 2)], 30)
    assert np.allclose(mapped(mapped(boxes, turn), np.linalg.inv(turn)), boxes)
    assert np.allclose(np.hypot(*grown(boxes, 1.5)[:, 2:4].T), 6.0)


def test_a_stay_bridges_misses_and_ends_when_it_moves_on() -> None:
    rng = np.random.default_rng(1)
    places = [np.array([[10.0 + 8 * k, 3.0], [50.0, 9.0]]) + rng.normal(0, 0.05, (2, 2)) for k in range(9)]
    places[3] = places[3][:1]
    places[4] = places[4][:1]
    stay = stays_of(places, 1.5 * np.arange(9), 4.0)
    assert all(s[0] == -1 for s in stay)
    assert {int(s[1]) for s in stay if len(s) > 1} == {0}
    assert all(s.max(initial=-1) == -1 for s in stays_of(places[:3], 1.5 * np.arange(3), 4.0))
    assert stays_of([np.zeros((0, 2))] * 3, np.arange(3.0), 4.0)[1].shape == (0,)


def test_what_moves_along_its_axis_in_one_colour_moves() -> None:
    first, second = boxes_at([(0, 0), (0, 30), (0, 60)]), boxes_at([(12, 0), (0, 42), (12, 60)])
    paint = np.array([[200.0, 20, 20], [20, 20, 200], [90, 90, 90]])
    other = paint.copy()
    other[2] += 60
    going = moving([first, second], [paint, other], np.array([0.0, 1.0]))
    assert going[0].tolist() == [True, False, False]
    assert going[1].tolist() == [True, False, False]


def street(frames: int) -> list[Glimpse]:
    """One lane of vehicles at 12 px a frame, and four that stand."""
    glimpses = []
    for k in range(frames):
        driven = boxes_at([(40.0 * i + 12 * k, 50.0) for i in range(8)])
        queue = boxes_at([(20.0 * i, 80.0) for i in range(4)])
        stay = np.r_[np.full(8, -1), np.arange(4)]
        glimpses.append(Glimpse(1.5 * k, np.eye(3), np.concatenate([driven, queue]), stay, stay < 0))
    return glimpses


def planned(seed: int = 1, most: int = 100) -> list[Injections]:
    params = CompletenessParams(injections_per_unit=most)
    return plan_injections(
        street(12), range(0, 12, 2), np.array([[4.5, 0.0], [-4.4, 0.1]]), metres_per_px=GSD, params=params, seed=(seed,)
    )


def test_a_plan_overlaps_nothing_that_stays_and_is_the_same_again() -> None:
    plan, glimpses = planned(), street(12)
    for k, injections in zip(range(0, 12, 2), plan, strict=True):
        left = glimpses[k].boxes[~injections.replaced]
        assert not overlaps(injections.boxes, left).any()
        assert (overlaps(injections.boxes, injections.boxes).sum(axis=1) == 1).all()
        assert (injections.stay >= 0).sum() == injections.replaced[8:].sum()
    again, other = planned(), planned(seed=2)
    assert all((a.boxes == b.boxes).all() and (a.donor == b.donor).all() for a, b in zip(plan, again, strict=True))
    assert any(len(a.boxes) != len(b.boxes) or (a.boxes != b.boxes).any() for a, b in zip(plan, other, strict=True))
    assert sum(len(i.boxes) for i in planned(most=12)) <= 12


def test_one_stay_is_one_vehicle_in_all_frames() -> None:
    donors: dict[int, set[int]] = {}
    for injections in planned():
        for stay, donor in zip(injections.stay, injections.donor, strict=True):
            if stay >= 0:
                donors.setdefault(int(stay), set()).add(int(donor))
    assert 1 <= len(donors) <= 4
    assert all(len(each) == 1 for each in donors.values())


def test_only_those_that_are_alone_are_cut_out() -> None:
    boxes = boxes_at([(0, 0), (0, 6), (60, 0), (120, 0)])
    glimpse = Glimpse(0.0, np.eye(3), boxes, np.full(4, -1), np.array([True, True, True, False]))
    assert lone(glimpse, 2.0).tolist() == [2]


def test_a_box_counts_for_the_vehicle_that_is_nearest() -> None:
    painted, others = np.array([[0.0, 0.0], [10.0, 0.0], [30.0, 0.0]]), np.array([[1.5, 0.0]])
    found = np.array([[1.0, 0.0], [10.9, 0.0], [10.2, 0.0], [33.0, 0.0]])
    assert came_back(painted, others, found, 1.65).tolist() == [-1, 2, -1]
    assert came_back(painted, others, np.zeros((0, 2)), 1.65).tolist() == [-1, -1, -1]
    assert came_back(np.zeros((0, 2)), others, found, 1.65).shape == (0,)


def test_paint_classes() -> None:
    colours = np.array([[20.0, 25, 30], [110, 112, 105], [230, 230, 225], [180, 30, 30]])
    assert paint_of(*colours.T).tolist() == ["dark", "grey", "light", "coloured"]


def world(rng: np.random.Generator, moving_share: float, standing_share: float, many: int) -> pd.DataFrame:
    """Rows of a place where these shares are found: half of the vehicles stand, four sightings to a stay."""
    stands = np.arange(many) % 2 == 1
    seen = rng.random(many) < np.where(stands, standing_share, moving_share)
    real = pd.DataFrame({"stands": stands[seen], "painted": False, "found": True, "stay": ""})
    stay = np.arange(many) // 8
    by_stay = rng.random(many) < standing_share
    back = np.where(stands, by_stay[stay], rng.random(many) < moving_share)
    names = np.where(stands, [f"s{n}" for n in stay], [f"m{n}" for n in range(many)])
    painted = pd.DataFrame({"stands": stands, "painted": True, "found": back, "stay": names})
    return pd.concat([real, painted], ignore_index=True)


def test_completeness_is_the_share_that_is_found_within_its_interval() -> None:
    rng, hits, values = np.random.default_rng(11), 0, []
    for _ in range(60):
        rows = world(rng, 0.95, 0.6, 800)
        found = completeness(rows, np.ones((len(rows), 1), bool), np.zeros(len(rows), np.int64), 1)
        values.append(found["completeness"].iloc[0])
        hits += int(found["completeness_lo"].iloc[0] <= 0.775 <= found["completeness_hi"].iloc[0])
    assert np.mean(values) == pytest.approx(0.775, abs=0.02)
    assert 50 <= hits <= 60
    assert found["completeness_hi"].iloc[0] - found["completeness_lo"].iloc[0] < 0.2


def test_nothing_is_said_of_places_without_witnesses() -> None:
    rows = world(np.random.default_rng(2), 0.9, 0.9, 200)
    inside = np.stack([np.ones(len(rows), bool), np.arange(len(rows)) < 3, np.zeros(len(rows), bool)], axis=1)
    found = completeness(rows, inside, np.zeros(len(rows), np.int64), 2)
    assert found[["place", "bin"]].to_numpy().tolist() == [[0, 0]]
    assert completeness(rows.iloc[:0], inside[:0], np.zeros(0, np.int64), 2).empty
