"""Vehicles cut from one place and painted into another: what a picture shows of them stays what it was."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vtrack_batch.completeness.donors import Canvas, cut, erase, paint

HEIGHT, WIDTH, PX_PER_M = 160, 230, 3.0
ROAD, SUN = np.array([110.0, 112.0, 108.0]), (0.6, 0.8)


def box(col: float, row: float, angle_deg: float, length_m: float = 4.5, width_m: float = 1.8) -> np.ndarray:
    turn = np.radians(angle_deg)
    along = np.array([np.cos(turn), np.sin(turn)]) * length_m / 2 * PX_PER_M
    across = np.array([-np.sin(turn), np.cos(turn)]) * width_m / 2 * PX_PER_M
    return np.array([col, row, *along, *across])


def filled(picture: np.ndarray, at: np.ndarray, colour: tuple[float, ...] | None, shift: float = 0.0) -> None:
    """Draw the box in *colour*, or, without one, its shadow *shift* px away from the sun."""
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    corners = at[:2] + signs[:, :1] * at[2:4] + signs[:, 1:] * at[4:6] + shift * np.array(SUN)
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.fillConvexPoly(mask, np.rint(corners * 16).astype(np.int32), 255, cv2.LINE_AA, 4)
    share = (mask / 255.0)[:, :, None]
    picture[:] = (1 - share) * picture + share * (picture * 0.5 if colour is None else np.array(colour, float))


def canvas(*vehicles: tuple[np.ndarray, tuple[float, ...]], light: float = 1.0, shadows: bool = True) -> Canvas:
    ground = np.dstack([np.broadcast_to(ROAD, (HEIGHT, WIDTH, 3)), np.full((HEIGHT, WIDTH), 5.0)])
    picture = ground[:, :, :3].copy()
    for at, colour in vehicles:
        if shadows:
            filled(picture, at, None, 4.0)
        filled(picture, at, colour)
    pixels = np.clip(picture * light, 0, 255).round().astype(np.uint8)
    return Canvas(pixels, ground.astype(np.uint8), PX_PER_M, SUN if shadows else None)


def test_a_vehicle_looks_the_same_at_its_new_place() -> None:
    here, there = box(60.3, 50.7, 20), box(160.0, 100.2, 20)
    scene, expected = canvas((here, (180, 40, 30))), canvas((here, (180, 40, 30)), (there, (180, 40, 30)))
    donor = cut(scene, here)
    assert donor is not None
    assert paint(scene, there, donor)
    off = np.abs(scene.pixels.astype(int) - expected.pixels).max(axis=2)
    changed = np.abs(expected.pixels.astype(int) - canvas((here, (180, 40, 30))).pixels).max(axis=2) > 20
    assert changed.sum() > 80
    assert off[changed].mean() < 20 < 60 < np.abs(expected.pixels - ROAD)[changed].max(axis=1).mean()
    assert np.median(off[changed]) < 10
    assert off[~changed].mean() < 0.5


@pytest.mark.parametrize("light", [0.7, 1.2])
def test_paint_takes_on_the_light_of_its_new_place(light: float) -> None:
    here, there = box(60, 50, 0), box(150, 100, 0)
    donor = cut(canvas((here, (150, 90, 60)), shadows=False), here)
    dim = canvas(light=light, shadows=False)
    assert donor is not None
    assert paint(dim, there, donor)
    assert np.abs(dim.pixels[100, 150] - light * np.array([150, 90, 60])).max() < 6
    assert np.abs(dim.pixels[20, 20] - light * ROAD).max() < 1.5


@pytest.mark.parametrize("turn", [15, -20])
def test_a_vehicle_turns_with_its_place(turn: int) -> None:
    here, there = box(60, 50, 10), box(150, 100, 10 + turn)
    donor = cut(canvas((here, (230, 230, 225)), shadows=False), here)
    scene = canvas(shadows=False)
    assert donor is not None
    assert paint(scene, there, donor)
    rows, columns = np.nonzero(scene.pixels[:, :, 0] > 170)
    axis = np.linalg.eigh(np.cov(columns, rows))[1][:, 1]
    assert abs((np.degrees(np.arctan2(axis[1], axis[0])) - 10 - turn + 90) % 180 - 90) < 4
    assert np.hypot(columns.mean() - 150, rows.mean() - 100) < 0.5
    assert 0.85 < len(rows) / (4.5 * 1.8 * PX_PER_M**2) < 1.15


def test_shadow_is_painted_beside_the_vehicle_away_from_the_sun() -> None:
    here, there = box(60, 50, 0), box(150, 100, 0)
    donor = cut(canvas((here, (220, 220, 220))), here)
    scene = canvas()
    assert donor is not None
    assert paint(scene, there, donor)
    below, above = scene.pixels[100 + 5, 150], scene.pixels[100 - 5, 150]
    assert below.max() < 0.7 * ROAD.min()
    assert np.abs(above - ROAD).max() < 4


def test_what_is_erased_is_ground_and_neighbours_stay() -> None:
    gone, stays = box(100, 80, 0), box(100, 88, 0)
    colours = ((200, 30, 30), (30, 40, 200))
    scene, before = canvas((gone, colours[0]), (stays, colours[1])), canvas((gone, colours[0]), (stays, colours[1]))
    keep = np.zeros((HEIGHT, WIDTH), bool)
    keep[84:93, 92:108] = True
    erase(scene, gone, keep, 1.0)
    assert np.abs(scene.pixels[80, 95:105] - ROAD).max() < 4
    assert (scene.pixels[keep] == before.pixels[keep]).all()
    assert (scene.pixels[:, :60] == before.pixels[:, :60]).all()


def test_nothing_is_cut_beside_unseen_ground_or_over_the_border() -> None:
    scene = canvas((box(60, 50, 0), (200, 30, 30)))
    scene.ground[:, 72:75, 3] = 255
    assert cut(scene, box(60, 50, 0)) is None
    assert cut(scene, box(3, 50, 0)) is None
    assert cut(scene, box(150, 100, 0)) is not None


def test_a_vehicle_painted_over_the_border_is_cut_off() -> None:
    donor = cut(canvas((box(60, 50, 0), (220, 220, 220)), shadows=False), box(60, 50, 0))
    scene = canvas(shadows=False)
    assert donor is not None
    assert paint(scene, box(1, 100, 0), donor)
    assert scene.pixels[100, 3].min() > 200
    assert not paint(scene, box(-200, 100, 0), donor)
