"""Roads on the ground: their outlines, wear, paint marks and the parking spaces along them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation.canvas import Canvas, Float32, multiscale, rectangle
from vtrack_batch.simulation.network import BOX_M, LANE_M, STOP_M, Network

_BAY_M = 2.4
_PAVEMENT_M = 3.0
_DASH_M, _PITCH_M = 3.0, 9.0
_LINE_M = 0.16


@dataclass(frozen=True)
class Layout:
    """Polygons (k, 2) in scene metres; ``lanes`` are the lane centre lines, ``spaces`` (n, 3) x, y, direction in rad.

    ``clear_m`` is how far from each road's axis things must stay; ``axes`` holds 0 for x and 1 for y.
    """

    roads: list[Array]
    bays: list[Array]
    pavements: list[Array]
    lanes: list[Array]
    lines: list[Array]
    spaces: Array
    axes: tuple[int, ...]
    clear_m: float


def layout(network: Network) -> Layout:
    """Return what to draw for a *network*: a crossing, or a plain street."""
    return _crossing(network) if network.routes[0].movement else _street(network)


def wear(canvas: Canvas, lay: Layout, image: Float32, *, rng: np.random.Generator) -> None:
    """Put patches, cracks, wheel tracks and oil onto the roads."""
    tone: Float32 = np.zeros(canvas.shape, np.float32)
    mask = canvas.mask(lay.roads) > 127
    for lane in lay.lanes:
        side = np.array([-(lane[1] - lane[0])[1], (lane[1] - lane[0])[0]])
        side /= np.hypot(*side)
        for offset, width, level in ((0.8, 0.5, 3.0), (-0.8, 0.5, 3.0), (0.0, 0.8, -4.0)):
            _stroke(canvas, tone, lane + offset * side, width, level)
    tone = np.asarray(cv2.GaussianBlur(tone, (0, 0), 0.35 * canvas.px_per_m), np.float32)
    for _ in range(14 * len(lay.lanes)):
        lane = lay.lanes[rng.integers(len(lay.lanes))]
        at = lane[0] + rng.random() * (lane[1] - lane[0])
        size = rng.uniform((1.5, 0.6), (14.0, 1.6)) if rng.random() < 0.7 else rng.uniform((1.0, 1.0), (3.0, 1.6))
        along = (lane[1] - lane[0]) / np.hypot(*(lane[1] - lane[0]))
        _stroke(canvas, tone, np.stack([at, at + along * size[0]]), size[1], rng.normal(0, 6))
    for _ in range(8 * len(lay.lanes)):
        lane = lay.lanes[rng.integers(len(lay.lanes))]
        at = lane[0] + rng.random() * (lane[1] - lane[0])
        crack = at + np.cumsum(rng.normal(0, 0.8, (8, 2)), axis=0)
        for piece in pairwise(crack):
            _stroke(canvas, tone, np.stack(piece), 0.08, -14.0)
    image += (tone * mask)[..., None]


def markings(canvas: Canvas, lay: Layout, more: list[Array], image: Float32, *, rng: np.random.Generator) -> None:
    """Paint the road marks, worn in places."""
    mask = np.zeros(canvas.shape, np.uint8)
    for polygon in [*lay.lines, *more]:
        cv2.fillPoly(mask, [canvas.fixed(polygon)], 255, cv2.LINE_AA, 4)
    worn = np.clip(0.72 + 0.16 * multiscale(canvas, (0.6, 4.0, 25.0), rng), 0.15, 0.95)
    part = (mask.astype(np.float32) / 255 * worn)[..., None]
    image += part * (np.array([214, 213, 206], np.float32) - image)


def _crossing(network: Network) -> Layout:
    road, bay, pavement, lane_lines, lines, spaces = [], [], [], [], [], []
    far, outer_in, outer_out = network.arm_m, 3 * LANE_M, 2 * LANE_M
    for quarter in range(4):
        turn = _quarter(quarter)
        pavement.append(
            rectangle((0, far), (-outer_out - _BAY_M - _PAVEMENT_M, outer_in + _BAY_M + _PAVEMENT_M)) @ turn
        )
        bay.append(rectangle((34, far), (outer_in, outer_in + _BAY_M)) @ turn)
        bay.append(rectangle((34, far), (-outer_out - _BAY_M, -outer_out)) @ turn)
        road.append(rectangle((0, far), (-outer_out, outer_in)) @ turn)
        t = np.linspace(0, 1, 12)[:, None]
        corner = (1 - t) ** 2 * [outer_out, BOX_M] + 2 * t * (1 - t) * [outer_out, outer_in] + t**2 * [BOX_M, outer_in]
        road.append(np.vstack([corner, [[0, 0]]]) @ turn)
        lane_lines += [np.array([[far, y], [0.0, y]]) @ turn for y in (8.0, 4.8, 1.6, -4.8, -1.6)]
        lines += [polygon @ turn for polygon in _arm_marks(far)]
        x = np.arange(37.5, far - 5, 6.4)
        for y in (outer_in + _BAY_M / 2, -outer_out - _BAY_M / 2):
            at = np.stack([x, np.full_like(x, y)], axis=1) @ turn
            spaces.append(np.column_stack([at, np.full(len(x), quarter * np.pi / 2)]))
    clear = outer_in + _BAY_M + _PAVEMENT_M + 1.5
    return Layout(road, bay, pavement, lane_lines, lines, np.vstack(spaces), (0, 1), clear)


def _arm_marks(far: float) -> list[Array]:
    """Return the marks of the arm along +x: stop line, zebra, lane lines, arrows."""
    marks = [rectangle((STOP_M, STOP_M + 0.5), (0.2, 3 * LANE_M - 0.2))]
    marks += [rectangle((14.4, 17.6), (y, y + 0.5)) for y in np.arange(-6.0, 9.4, 1.0)]
    marks += [_bar(STOP_M, far, y) for y in (0.18, -0.18, 3 * LANE_M - 0.25, -2 * LANE_M + 0.25)]
    for y in (LANE_M, 2 * LANE_M, -LANE_M):
        solid = STOP_M + 22 if y > 0 else STOP_M
        if y > 0:
            marks.append(_bar(STOP_M, solid, y))
        marks += [_bar(x, x + _DASH_M, y) for x in np.arange(solid + 3, far - _DASH_M, _PITCH_M)]
    for x in (STOP_M + 8, STOP_M + 30):
        for y in (1.6, 4.8, 8.0):
            marks.append(rectangle((x, x + 2.6), (y - 0.09, y + 0.09)))
            marks.append(np.array([[x, y - 0.35], [x, y + 0.35], [x - 1.6, y]]))
    return marks


def _street(network: Network) -> Layout:
    far, edge = network.arm_m, LANE_M + 0.4
    road = [rectangle((-far, far), (-edge, edge))]
    pavement = [rectangle((-far, far), (-edge - _BAY_M - _PAVEMENT_M, edge + _BAY_M + _PAVEMENT_M))]
    bay = [rectangle((-far, far), (-edge - _BAY_M, edge + _BAY_M))]
    lanes = [np.array([[-far, y], [far, y]]) for y in (-LANE_M / 2, LANE_M / 2)]
    lines = [_bar(x, x + _DASH_M, 0.0) for x in np.arange(-far, far - _DASH_M, _PITCH_M)]
    lines += [_bar(-far, far, y) for y in (-LANE_M - 0.2, LANE_M + 0.2)]
    x = np.arange(-far + 5, far - 5, 6.4)
    spaces = [np.column_stack([x, np.full_like(x, y), np.zeros_like(x)]) for y in (edge + 1.2, -edge - 1.2)]
    return Layout(road, bay, pavement, lanes, lines, np.vstack(spaces), (0,), edge + _BAY_M + _PAVEMENT_M + 1.5)


def _bar(x0: float, x1: float, y: float) -> Array:
    return rectangle((x0, x1), (y - _LINE_M / 2, y + _LINE_M / 2))


def _quarter(quarter: int) -> Array:
    """Return the matrix that turns row vectors counter-clockwise by quarter turns."""
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
    return np.array([[c, s], [-s, c]], float)


def _stroke(canvas: Canvas, tone: Float32, ends: Array, width_m: float, level: float) -> None:
    """Add *level* along the segment *ends* (2, 2) of scene metres (the later stroke wins where they cross)."""
    along = ends[1] - ends[0]
    length = float(np.hypot(*along))
    if length == 0:
        return
    side = np.array([-along[1], along[0]]) / length * width_m / 2
    polygon = np.stack([ends[0] + side, ends[1] + side, ends[1] - side, ends[0] - side])
    cv2.fillPoly(tone, [canvas.fixed(polygon)], level, cv2.LINE_8, 4)
