"""Frames show what stands, moves and shines where the geometry says, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from rendering import camera_of, cars, network, view

from vtrack_batch.model.homography import apply
from vtrack_batch.simulation import ground, render
from vtrack_batch.simulation.scenery import photographed
from vtrack_batch.simulation.standing import in_frame, lean
from vtrack_batch.simulation.town import Town

EAST = np.array([[1.0, 0.0]])


def frame(camera: render.Camera, k: int, table: np.ndarray | None = None) -> np.ndarray:
    rng = np.random.Generator(np.random.SFC64([3, k]))
    return render.render(camera, k, np.zeros((0, 21)) if table is None else table, rng=rng)


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs(a.astype(int) - b.astype(int)).max(axis=2)


@pytest.fixture(scope="module")
def calm() -> render.Camera:
    return camera_of(view(camera={"travel_m": 0.0}, ground={"sway_m": 0.0, "street_trees_per_km": 0.0}))


def test_the_same_seed_gives_the_same_frame_and_another_one_another(calm: render.Camera) -> None:
    again = camera_of(view(camera={"travel_m": 0.0}, ground={"sway_m": 0.0, "street_trees_per_km": 0.0}))
    np.testing.assert_array_equal(frame(again, 1), frame(calm, 1))
    other = camera_of(view(camera={"travel_m": 0.0}, ground={"sway_m": 0.0, "street_trees_per_km": 0.0}, seed=5))
    assert (difference(frame(other, 1), frame(calm, 1)) > 0).mean() > 0.5


def test_nothing_moves_on_a_calm_day(calm: render.Camera) -> None:
    np.testing.assert_array_equal(frame(calm, 0), frame(calm, 2))


def test_bands_and_strips_leave_no_seam(calm: render.Camera, monkeypatch: pytest.MonkeyPatch) -> None:
    table = render.place(calm, 1, cars(2), xy_m=np.array([[-80.0, -4.5], [-60.0, 1.5]]), forward=np.repeat(EAST, 2, 0))
    whole = frame(calm, 1, table)
    monkeypatch.setattr(render, "BAND_ROWS", 37)
    assert difference(frame(calm, 1, table), whole).max() <= 1
    monkeypatch.setattr(ground, "STRIP_ROWS", 101)
    strips = camera_of(calm.view).scenery.ground.rgba
    apart = np.abs(strips.astype(int) - calm.scenery.ground.rgba.astype(int))
    assert apart.max() <= 2
    assert (apart > 0).mean() < 0.001


def test_a_vehicle_changes_the_frame_at_its_place_and_its_shadow_falls_away_from_the_sun(calm: render.Camera) -> None:
    place = np.array([[-70.0, -3.0]])
    table = render.place(calm, 1, cars(1), xy_m=place, forward=EAST)
    changed = difference(frame(calm, 1, table), frame(calm, 1)) > 12
    red = changed & (frame(calm, 1, table)[..., 0].astype(int) - frame(calm, 1, table)[..., 1] > 80)
    col, row = apply(calm.scene_to_frame(1), place)[0]
    assert np.abs(np.argwhere(red).mean(axis=0) - [row, col]).max() < 0.8
    dark = changed & ~cv2.dilate(red.astype(np.uint8), np.ones((3, 3))).astype(bool)
    # the sun stands in the south-east
    shift = np.argwhere(dark).mean(axis=0) - [row, col]
    assert shift[0] < -0.5
    assert shift[1] < 0
    assert 0.6 < red.sum() * 0.16 / (4.5 * 1.8) < 1.1


def test_roofs_lean_by_their_height_and_the_way_from_below_the_platform() -> None:
    at, height = np.array([[100.0, -40.0], [100.0, -40.0], [0.0, 0.0]]), np.array([10.0, 20.0, 15.0])
    seen = lean(at, height, np.zeros(2), 1010.0)
    assert seen[0] - at[0] == pytest.approx([1.0, -0.4])
    assert seen[1] - at[1] == pytest.approx(np.array([100.0, -40.0]) * 20 / 990)
    assert seen[2] == pytest.approx([0.0, 0.0])


def test_travel_moves_what_is_high_and_leaves_the_ground(calm: render.Camera) -> None:
    moving = camera_of(view(camera={"travel_m": 400.0}, ground={"sway_m": 0.0, "street_trees_per_km": 0.0}))
    np.testing.assert_array_equal(moving.scenery.ground.rgba, calm.scenery.ground.rgba)
    apart = difference(frame(moving, 0), frame(moving, 2))
    things = moving.scenery.standing
    assert things is not None
    shift = moving.flight.nadir_m[2] - moving.flight.nadir_m[0]
    tables = [
        in_frame(things, moving.scene_to_frame(k), nadir=nadir, altitude_m=2500.0, sway=None, size_px=(9999, 9999))
        for k, nadir in ((0, np.zeros(2)), (0, shift))
    ]
    tops = [table[np.isin(table[:, 6], things.patch)] for table in tables]
    moved = (tops[1][:, :2] - tops[0][:, :2]) * 0.4
    ratio = np.sort(np.hypot(*moved.T) / np.hypot(*shift))
    inside = things.height_m / (2500 - things.height_m)
    assert inside.min() - 1e-9 <= ratio.min() < ratio.max() <= inside.max() + 1e-9
    # the carriageway far from any house does not move
    col, row = np.round(apply(moving.scene_to_frame(0), np.array([[-60.0, -1.5]]))[0]).astype(int)
    assert apart[row - 4 : row + 5, col - 20 : col + 20].max() <= 1
    assert (apart > 10).mean() > 0.003


def test_crowns_sway_and_nothing_else_does() -> None:
    windy = camera_of(view(camera={"travel_m": 0.0}, ground={"sway_m": 0.5, "street_trees_per_km": 0.0}))
    apart = difference(frame(windy, 0), frame(windy, 2)) > 3
    things = windy.scenery.standing
    assert things is not None
    near = np.zeros(apart.shape, np.uint8)
    for middle, u in zip(things.middle[things.crown], things.u[things.crown], strict=True):
        col, row = apply(windy.scene_to_frame(0), middle[None])[0]
        cv2.circle(near, (round(col), round(row)), int(np.hypot(*u) / 0.4 * 1.5) + 8, 1, -1)
    assert apart.sum() > 200
    assert not (apart & (near == 0)).any()


def deck_over(camera: render.Camera, half: tuple[float, float], at: tuple[float, float]) -> render.Camera:
    """Put one bridge, and nothing else, above the scene."""
    from vtrack_batch.simulation.standing import raise_town

    none = np.zeros((0, 7))
    town = Town(none, np.zeros((0, 4)), np.array([[*at, *half, 0.0, 1.0, 5.5]]), none, [], [], np.zeros((0, 3)))
    rng = np.random.default_rng(1)
    things = raise_town(town, 5.0, np.eye(2), np.zeros(2), rng=rng)
    return replace(camera, scenery=replace(camera.scenery, standing=things))


def test_what_a_bridge_hides_is_not_seen(calm: render.Camera) -> None:
    bridged = deck_over(calm, (15.0, 3.0), (-60.0, 0.0))
    xy = np.array([[-60.0, -3.0], [-63.0, 1.5], [-80.0, -3.0]])
    tables = [
        render.place(bridged, 1, cars(3, rgb=rgb), xy_m=xy, forward=np.repeat(EAST, 3, 0))
        for rgb in ((250.0, 20.0, 20.0), (20.0, 20.0, 250.0))
    ]
    share = render.visible_share(bridged, 1, tables[0])
    assert share[0] < 0.02
    assert 0.4 < share[1] < 0.6
    assert share[2] > 0.98
    apart = difference(frame(bridged, 1, tables[0]), frame(bridged, 1, tables[1])) > 25
    for k, expected in ((0, 0.0), (1, 0.5), (2, 1.0)):
        col, row = np.round(apply(bridged.scene_to_frame(1), xy[[k]])[0]).astype(int)
        body = apart[row - 1 : row + 2, col - 5 : col + 6]
        assert body.mean() == pytest.approx(expected * 0.8, abs=0.25 if expected else 0.01)
    order = np.array([2, 0, 1])
    np.testing.assert_array_equal(render.visible_share(bridged, 1, tables[0][order]), share[order])
    assert render.visible_share(bridged, 1, tables[0][:0]).shape == (0,)


def test_visibility_and_shade_do_not_depend_on_the_picture(calm: render.Camera) -> None:
    plain = camera_of(calm.view, picture=False)
    rng = np.random.default_rng(7)
    xy = np.column_stack([rng.uniform(-110, 30, 300), rng.uniform(-35, 55, 300)])
    looks = cars(300)
    pairs = [render.place(c, 1, looks, xy_m=xy, forward=np.repeat(EAST, 300, 0)) for c in (calm, plain)]
    seen = render.visible_share(calm, 1, pairs[0])
    np.testing.assert_array_equal(render.visible_share(plain, 1, pairs[1]), seen)
    assert 0.02 < (seen < 0.5).mean() < 0.5
    shade = [render.shadow_share(c, 1, table) for c, table in zip((calm, plain), pairs, strict=True)]
    assert np.abs(shade[0] - shade[1]).mean() < 0.05
    assert 0.03 < (shade[0] > 0.5).mean() < 0.6
    colour = render.ground_colour(calm, xy)
    dark, bright = colour[shade[0] > 0.95].mean(), colour[shade[0] < 0.05].mean()
    assert 0.35 < dark / bright < 0.75


def test_trams_keep_to_their_line_and_people_to_the_pavement() -> None:
    line = ((-50.0, 190.0), (200.0, 180.0), (480.0, 205.0))
    more = {"tram": line, "tram_every_s": 14.0, "pedestrians_per_km": 300.0}
    camera = camera_of(view(ground=more, frames=6))
    seen = [render.others(camera, k) for k in range(6)]
    trams = [rows[rows["kind"] == "tram"] for rows in seen]
    assert sum(len(rows) for rows in trams) > 6
    for rows in trams:
        expected = np.interp(rows["col_px"], [p[0] for p in line], [p[1] for p in line])
        assert np.abs(rows["row_px"] - expected).to_numpy().max(initial=0) < 0.7
    first, second = (rows["col_px"].to_numpy() for rows in trams[2:4])
    step = np.abs(second[:, None] - first - 8.0 * 1.5 / 0.4).min(axis=1)
    assert np.median(step) < 0.5
    people = [rows[rows["kind"] == "pedestrian"] for rows in seen]
    assert len(people[0]) > 30
    for rows in people:
        scene = apply(np.linalg.inv(camera.stage.scene_to_ground), rows[["x_m", "y_m"]].to_numpy())
        west, lower, upper = scene[:, 0] < -9, scene[:, 1] > -6, scene[:, 1] < 3
        assert not (west & lower & upper).any()
    walked = np.abs(people[1]["col_px"].iloc[:10].to_numpy() - people[0]["col_px"].iloc[:10].to_numpy()) * 0.4
    assert walked.max() < 3.5


def test_a_picture_can_be_the_ground() -> None:
    seen = view(camera={"travel_m": 300.0})
    stage = camera_of(seen, picture=False).stage
    rgb = np.full((60, 90, 3), (90, 120, 60), np.uint8)
    rgb[20:30, 40:60] = (200, 40, 40)
    # each pixel of the picture is four by four of the frame, its corner upon the frame's
    laid = np.array([[4.0, 0, 1.5], [0, 4.0, 1.5], [0, 0, 1]])
    scenery = photographed(seen, stage, network(), rgb, photo_to_reference=laid)
    camera = replace(camera_of(seen, picture=False), scenery=scenery)
    image = frame(camera, 0)
    assert np.abs(image[85:115, 165:235] - np.array([200, 40, 40])).max() <= 2
    assert np.abs(image[5:70, 5:150] - np.array([90, 120, 60])).max() <= 2
    inside = np.linalg.inv(camera.scene_to_frame(0))
    colours = render.ground_colour(camera, apply(inside, np.array([[200.0, 100.0], [20.0, 20.0]])))
    assert colours.tolist() == [[200, 40, 40], [90, 120, 60]]
    assert len(scenery.parked.xy_m) == 0
