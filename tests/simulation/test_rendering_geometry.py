"""Lines, textures and what a network asks to be drawn."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from rendering import lane, network

from vtrack_batch.simulation import polyline
from vtrack_batch.simulation.marks import road_marks
from vtrack_batch.simulation.roadnet import RoadNet
from vtrack_batch.simulation.roads import BAY_M, PAVEMENT_M, layout
from vtrack_batch.simulation.texture import fractal, octaves

BEND = np.array([[0, 0], [30, 0], [30, 20.0]])


def area(outline: np.ndarray) -> float:
    return float(cv2.contourArea(outline.astype(np.float32)))


def test_a_parallel_keeps_its_distance_also_past_a_bend() -> None:
    left = polyline.parallel(BEND, 2.0)
    assert left == pytest.approx(np.array([[0, 2], [28, 2], [28, 20.0]]))
    right = polyline.parallel(BEND, -2.0)
    assert right == pytest.approx(np.array([[0, -2], [32, -2], [32, 20.0]]))


def test_a_cut_has_the_length_that_was_asked_for_and_keeps_the_bend() -> None:
    part = polyline.cut(BEND, 25.0, 38.0)
    assert part == pytest.approx(np.array([[25, 0], [30, 0], [30, 8.0]]))
    assert polyline.cut(BEND, 49.99, 80.0).shape == (0, 2)
    assert polyline.cut(BEND, -5.0, 500.0) == pytest.approx(BEND)


def test_places_along_a_line_point_ahead() -> None:
    xy, ahead = polyline.along(BEND, [10.0, 40.0, 999.0])
    assert xy == pytest.approx(np.array([[10, 0], [30, 10], [30, 20.0]]))
    assert ahead == pytest.approx(np.array([[1, 0], [0, 1], [0, 1.0]]))


def test_dashes_cover_a_third_of_the_line() -> None:
    marks = polyline.dashes(np.array([[0, 0], [90.0, 0]]), dash_m=3, pitch_m=9, width_m=0.2)
    assert len(marks) == 10
    assert sum(area(mark) for mark in marks) == pytest.approx(10 * 3 * 0.2, rel=1e-3)


@pytest.mark.parametrize("turned", [1, -1])
def test_an_outline_grows_on_all_sides_whichever_way_it_runs(turned: int) -> None:
    oblong = np.array([[0, 0], [10, 0], [10, 4], [0, 4.0]])[::turned]
    assert area(polyline.widened(oblong, 1.5)) == pytest.approx(13 * 7, rel=1e-6)


def test_strips_of_a_texture_fit_together() -> None:
    whole = fractal((90, 130), cells_px=[1.0, 3.7, 25.0], seed=8)
    for first, last in ((0, 31), (31, 32), (32, 90)):
        part = fractal((last - first, 130), cells_px=[1.0, 3.7, 25.0], seed=8, first_row=first)
        np.testing.assert_array_equal(part, whole[first:last])
    assert np.abs(fractal((90, 130), cells_px=[1.0, 3.7, 25.0], seed=9) - whole).mean() > 0.3


def test_power_falls_with_about_the_square_of_the_frequency() -> None:
    texture = fractal((512, 640), cells_px=octaves(4.0, 0.25, 32.0), seed=3)
    assert 0.7 < texture.std() < 1.4
    power = np.abs(np.fft.fft2(texture - texture.mean())) ** 2
    radius = np.hypot(np.fft.fftfreq(512)[:, None], np.fft.fftfreq(640)[None, :])
    low, high = (power[(radius > f / 1.4) & (radius < f * 1.4)].mean() for f in (0.02, 0.2))
    assert -2.8 < np.log10(high / low) < -1.6


def test_asphalt_is_as_wide_as_the_lanes_and_paint_lies_on_it() -> None:
    lay = layout(network())
    canvas = np.zeros((500, 1000), np.uint8)

    def to_px(points: np.ndarray) -> np.ndarray:
        return np.round((points + np.array([225, 30])) * 4 * 16).astype(np.int32)

    for outline in lay.asphalt:
        cv2.fillPoly(canvas, [to_px(outline)], 255, cv2.LINE_8, 4)
    across = canvas[:, (225 - 100) * 4] > 0
    assert across.sum() / 4 == pytest.approx(9.0 + 0.4, abs=0.5)
    for mark in lay.marks:
        col, row = (to_px(mark.mean(axis=0, keepdims=True)) // 16)[0]
        assert canvas[row, col], mark


def test_only_those_who_enter_a_signal_have_a_stop_line_and_only_neighbours_a_lane_line() -> None:
    across = [m for m in road_marks(network()) if np.ptp(m[:, 1]) > 2.0 and np.ptp(m[:, 0]) < 1.0]
    stops = [m for m in across if m[:, 0].max() == pytest.approx(-9.0)]
    assert sorted(round(float(m[:, 1].mean()), 1) for m in stops) == [-4.5, -1.5]
    lines = [m for m in road_marks(network()) if np.allclose(m[:, 1].mean(), -3.0, atol=0.05) and np.ptp(m[:, 0]) > 2]
    assert len(lines) > 15
    dashes = [m for m in lines if m[:, 0].max() < -35]
    assert {round(float(np.ptp(m[:, 0])), 3) for m in dashes} == {3.0}


def test_people_and_parked_cars_keep_off_the_carriageway_and_off_fast_roads() -> None:
    lay = layout(network())
    south = lay.spaces[lay.spaces[:, 1] < 0]
    assert len(south) > 10
    assert south[:, 1] == pytest.approx(-6 - BAY_M / 2)
    walks = [walk[:, 1] for walk in lay.walks if walk[0, 1] < 0]
    assert walks
    assert np.concatenate(walks) == pytest.approx(-6 - BAY_M - PAVEMENT_M / 2, abs=0.1)
    fast = layout(network(speed_mps=30.0))
    assert len(fast.spaces) == 0
    assert fast.pavements == []
    assert fast.walks == []


def test_nothing_or_a_point_is_a_network_too() -> None:
    point = lane("p", 0, [(3.0, 3.0)])
    for net in (RoadNet((), ()), RoadNet((point,), ()), RoadNet((lane("q", 0, [(1, 1), (1, 1)]),), ())):
        lay = layout(net)
        assert lay.asphalt == []
        assert lay.marks == []
        assert lay.spaces.shape == (0, 3)
