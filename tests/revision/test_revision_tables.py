"""What tracks tell of detections: ghosts go, standing vehicles keep shape, place and name, waiting is not parking."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.model.flags import DetectionFlag
from vtrack_batch.model.views import Views
from vtrack_batch.pipeline.revise import track_revised
from vtrack_batch.revision.absences import FILLED
from vtrack_batch.revision.crossing import Spots, Ways, drivers_through
from vtrack_batch.revision.params import RevisionParams
from vtrack_batch.revision.revise import revise
from vtrack_batch.revision.withdraw import contracted
from vtrack_batch.tracking.track import Tracks, track

START = pd.Timestamp("2026-05-17T08:00:00Z")
EVERY_S, FRAMES = 1.5, 50
PARAMS = RevisionParams()


def sighting(frame: int, x: float, y: float, **more: Any) -> dict[str, Any]:
    usual = {"length_m": 4.5, "width_m": 1.8, "heading_deg": 90.0, "red": 60.0, "green": 60.0, "blue": 60.0, "flags": 0}
    return {"frame": frame, "x_m": x, "y_m": y, **usual, **more}


def through(lane: float, first: int, speed: float = 10.0, colour: float = 60.0) -> list[dict[str, Any]]:
    """A vehicle that drives 300 m east without stopping."""
    frames = [first + k for k in range(int(300 / (speed * EVERY_S)) + 1) if first + k < FRAMES]
    paint = {"red": colour, "green": colour, "blue": colour}
    return [sighting(f, speed * EVERY_S * (f - first), lane, **paint) for f in frames]


def stopping(seen: range | list[int], stands_at: float = 150.0) -> list[dict[str, Any]]:
    """A light vehicle that brakes, stands from frame 12 to 35, and drives on; found in the frames *seen*."""
    paint = {"red": 220.0, "green": 222.0, "blue": 215.0}
    s = [stands_at - 0.9 * max(0, 12 - f) ** 2 + 0.9 * max(0, f - 35) ** 2 for f in range(FRAMES)]
    return [sighting(f, s[f], 3.5, **paint) for f in seen if 0 <= s[f] <= 300]


def scene(*vehicles: list[dict[str, Any]], noise_m: float = 0.1, seed: int = 3) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    rows = pd.DataFrame([row for vehicle in vehicles for row in vehicle])
    rows[["x_m", "y_m"]] += rng.normal(0, noise_m, (len(rows), 2))
    order = rows.sort_values(["frame", "y_m", "x_m"]).index
    rows.loc[order, "detection_id"] = [f"d{n:05d}" for n in range(len(rows))]
    times = (START + pd.to_timedelta(rows["frame"] * EVERY_S, unit="s")).dt.as_unit("us")
    return rows.assign(t_utc=times, sequence="main", area_m2=rows["length_m"] * rows["width_m"])


def view() -> Views:
    t_utc = (START.tz_localize(None).to_datetime64() + (np.arange(FRAMES) * 1.5e6).astype("timedelta64[us]")).astype(
        "datetime64[us]"
    )
    corners = np.tile([[-20.0, -50.0], [320.0, -50.0], [320.0, 50.0], [-20.0, 50.0]], (FRAMES, 1, 1))
    return Views("main", t_utc, corners, np.full(FRAMES, 0.1))


def tracked(detections: pd.DataFrame, taught: FlowMap | None = None) -> Tracks:
    return track(detections, views={"main": view()}, method="untrained", flow_map=taught)


def times_s() -> np.ndarray:
    return view().t_utc.astype(np.int64) / 1e6


def traffic() -> list[list[dict[str, Any]]]:
    return [through(0.0, 4 * k, speed=9.0 + 0.3 * k, colour=30.0 + 20 * k) for k in range(9)]


def test_a_way_pierces_a_box_or_passes_beside_it() -> None:
    spots = Spots(np.array([[0.0, 0.0]]), np.array([[2.0, 1.0]]), np.array([[0.0, 1.0]]), np.zeros(1), np.ones(1) * 9)
    start = np.array([[-9.0, 0.0], [-9.0, 0.0], [-1.5, -9.0], [-9.0, 1.9], [3.0, 3.0], [-9.0, 0.0]])
    stop = np.array([[9.0, 0.0], [9.0, 0.0], [-1.5, 9.0], [9.0, 1.9], [9.0, 9.0], [9.0, 0.0]])
    begin = np.array([1.0, 2.0, 1.0, 1.0, 1.0, 20.0])
    ways = Ways(np.array([1, 1, 2, 3, 4, 5]), start, stop, begin, begin + 1)
    assert drivers_through(spots, ways, during=True).tolist() == [2]
    assert drivers_through(spots, ways, during=False).tolist() == [1]
    empty = Ways(np.zeros(0, int), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    assert drivers_through(spots, empty, during=True).tolist() == [0]


def test_a_ghost_goes_and_what_stands_beside_it_stays() -> None:
    ghost = [sighting(f, 140.0, 0.2, red=200.0, green=30.0, blue=30.0) for f in range(FRAMES)]
    parked = [sighting(f, 140.0, 6.0, red=30.0, green=30.0, blue=200.0) for f in range(FRAMES)]
    world = scene(ghost, parked, *traffic())
    # traffic and the ghost do not mix: where they meet, the tracker may hand over a sighting or two
    found = revise(world, tracked(world).track_points, times_s(), params=PARAMS)
    stays = world["detection_id"].isin(found.detections["detection_id"])
    gone, left = world[~stays], world[stays]
    assert 0.8 * FRAMES < len(gone) <= FRAMES + 4
    assert (gone["red"] == 200.0).mean() > 0.9
    assert (left["blue"] == 200.0).sum() == FRAMES
    assert len(found.detections) == len(left)


def test_a_vehicle_that_drives_and_then_stands_is_no_ghost() -> None:
    world = scene(stopping(range(FRAMES)), *[through(3.5, 38 + k, speed=9.0) for k in (0,)])
    found = revise(world, tracked(world).track_points, times_s(), params=PARAMS)
    assert set(found.detections["detection_id"]) == set(world["detection_id"])


def test_size_and_place_are_held_while_it_stands() -> None:
    rows = stopping(range(FRAMES))
    for row in rows:
        if 12 < row["frame"] < 35 and row["frame"] % 3 == 0:
            row |= {"length_m": 8.0, "width_m": 1.2, "heading_deg": 130.0}
        if row["frame"] == 20:
            row["x_m"] += 1.4
    world = scene(rows, *traffic())
    out = revise(world, tracked(world).track_points, times_s(), params=PARAMS).detections.set_index("detection_id")
    light = world[world["red"] > 200].set_index("detection_id")
    stands = light.index[light["frame"].between(13, 34)]
    area = out.loc[stands, "length_m"] * out.loc[stands, "width_m"]
    assert area.between(0.85 * 8.1, 1.15 * 8.1).all()
    assert np.abs(out.loc[stands, "x_m"] - 150).max() < 0.8
    held = (out["flags"].to_numpy() & int(DetectionFlag.HELD)) > 0
    assert 7 <= held.sum() <= 10
    assert held[out.index.isin(stands)].sum() == held.sum()
    moving = light.index.difference(stands)
    assert (out.loc[moving, "length_m"] == 4.5).all()


@pytest.mark.parametrize("unseen", [range(15, 31), range(20, 21), range(13, 35)])
def test_a_vehicle_that_is_lost_while_it_stands_keeps_its_name(unseen: range) -> None:
    world = scene(stopping([f for f in range(FRAMES) if f not in unseen]), *traffic())
    tracks, detections = track_revised(world, view(), tracked, PARAMS)
    light = world.loc[world["red"] > 200, "detection_id"]
    names = tracks.track_points.loc[tracks.track_points["detection_id"].isin(light), "vehicle_id"]
    assert names.nunique() == 1
    path = tracks.track_points[tracks.track_points["vehicle_id"] == names.iloc[0]]
    assert len(path) == path["t_utc"].nunique() == len(light) + len(unseen)
    assert path["detection_id"].isna().sum() == len(unseen)
    assert np.abs(path.loc[path["detection_id"].isna(), "x_m"] - 150).max() < 1.5
    assert set(detections["detection_id"]) == set(world["detection_id"])
    for table, columns in ((tracks.matches, ["detection_id_from", "detection_id_to"]), (detections, ["detection_id"])):
        assert not any(table[name].astype("string").str.startswith(FILLED).any() for name in columns)
    assert not tracks.trajectories["vehicle_id"].str.contains(FILLED).any()
    ends = tracks.matches.dropna(subset=["detection_id_from", "detection_id_to"])
    assert ends["detection_id_from"].is_unique
    assert ends["detection_id_to"].is_unique


def test_another_colour_at_the_same_spot_is_another_vehicle() -> None:
    rows = stopping([f for f in range(FRAMES) if not 15 <= f < 31])
    for row in rows:
        if row["frame"] >= 31:
            row |= {"red": 30.0, "green": 30.0, "blue": 160.0}
    world = scene(rows, *traffic())
    found = revise(world, tracked(world).track_points, times_s(), params=PARAMS)
    assert len(found.filled) <= 2


def test_where_others_drove_through_meanwhile_nobody_stood() -> None:
    rows = stopping([f for f in range(FRAMES) if not 13 <= f < 35])
    passing = [through(3.5, first, speed=20.0, colour=20.0) for first in (10, 14, 17)]
    world = scene(rows, *passing)
    found = revise(world, tracked(world).track_points, times_s(), params=PARAMS)
    inside = found.filled["x_m"].between(140, 160) & (found.filled["red"] > 200)
    assert inside.sum() <= 2


def test_waiting_where_others_drive_is_not_parking() -> None:
    waits = [sighting(f, 150.0, 0.0, red=200.0, green=30.0, blue=30.0) for f in range(24)]
    parked = [sighting(f, 150.0, 6.5, red=30.0, green=30.0, blue=200.0) for f in range(FRAMES)]
    world = scene(waits, parked, *[through(0.0, 26 + 3 * k, speed=14.0, colour=40.0) for k in range(4)])
    tracks, _ = track_revised(world, view(), tracked, PARAMS)
    reason = {}
    for name, colour in (("waits", "red"), ("parked", "blue")):
        ids = world.loc[world[colour] == 200.0, "detection_id"]
        vehicle = tracks.track_points.loc[tracks.track_points["detection_id"].isin(ids), "vehicle_id"].mode()[0]
        reason[name] = tracks.trajectories.set_index("vehicle_id").loc[vehicle, ["start_reason", "end_reason"]].tolist()
        states = set(tracks.track_points.loc[tracks.track_points["vehicle_id"] == vehicle, "state"])
        assert ("parked" in states) == (name == "parked")
    assert reason == {"waits": ["start_of_data", "lost"], "parked": ["parked", "parked"]}


def test_links_by_way_of_filled_sightings_become_one() -> None:
    t = [START + pd.Timedelta(seconds=k) for k in range(5)]
    rows = [("a", "~1", 0, 0.9), ("~1", "~2", 1, 0.8), ("~2", "b", 2, 0.95), ("c", "~3", 0, 0.7), ("~3", None, 1, 0.6)]
    rows += [("d", "e", 0, 0.5), (None, "f", 0, 0.4)]
    matches = pd.DataFrame(rows, columns=["detection_id_from", "detection_id_to", "k", "probability"])
    matches = matches.assign(
        t_from_utc=[t[k] for k in matches["k"]], t_to_utc=[t[k + 1] for k in matches["k"]], match_id="", method="x"
    )
    found = contracted(matches).set_index("match_id")
    assert sorted(found.index) == [">f", "a>b", "c>", "d>e"]
    assert found.loc["a>b", "probability"] == 0.8
    assert found.loc["a>b", "t_to_utc"] == t[3]
    assert found.loc["c>", "t_to_utc"] == t[1]


def test_order_of_rows_changes_nothing_and_nothing_gives_nothing() -> None:
    world = scene(stopping([f for f in range(FRAMES) if not 15 <= f < 31]), *traffic())
    mixed = world.sample(frac=1, random_state=4).reset_index(drop=True)
    one, other = (track_revised(rows, view(), tracked, PARAMS) for rows in (world, mixed))
    pd.testing.assert_frame_equal(one[0].track_points, other[0].track_points)
    pd.testing.assert_frame_equal(one[0].matches, other[0].matches)
    pd.testing.assert_frame_equal(one[1], other[1])
    off = RevisionParams(revise=False)
    assert track_revised(world, view(), tracked, off)[1] is world
    none, detections = track_revised(world.iloc[:0], view(), tracked, PARAMS)
    assert none.track_points.empty
    assert detections.empty
