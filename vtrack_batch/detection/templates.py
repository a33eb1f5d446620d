"""Sample points of oriented boxes, as pixel offsets in tables: every size in every direction, drawn up once a block."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.detection.params import DetectionParams

INSIDE, FRONT, BACK, LEFT, RIGHT, CAST = range(6)
"""Parts of a template: the box, four strips just outside of it, and where its cast shadow should lie."""

PARTS = 6
_CAR_REACH, _LORRY_REACH, _LORRY_WIDTH_M = 1.5, 3.5, 2.3
_MOST_ALONG, _MOST_ACROSS = 16, 8
_SCALE_STEP, _ANGLE_STEP = 0.005, float(np.radians(2.0))


@dataclass(frozen=True, eq=False)
class Templates:
    """Offsets of all templates, one after the other.

    ``offsets`` (n, 2) int32 (row, column); ``starts`` (directions, sizes, 7) int32: part p lies in
    starts[d, k, p]:starts[d, k, p + 1]; ``half_axes`` (directions, sizes, 4) float64: from the centre to the front (x,
    y) and to the side (x, y), in px; ``shades`` (sizes, 2) the longest shadow that each size may cast (x, y), in px.
    """

    offsets: NDArray[np.int32]
    starts: NDArray[np.int32]
    half_axes: NDArray[np.float64]
    shades: NDArray[np.float64]

    @property
    def margin(self) -> int:
        """How far in px a box, its rim and its shadow may reach from its centre, and some more."""
        shadowed = np.abs(self.half_axes).max() + np.abs(self.shades).max()
        return int(max(np.abs(self.offsets).max(), shadowed)) + 6


def draw_templates(
    px_per_m: tuple[float, float], shadow: tuple[float, float] | None, params: DetectionParams
) -> Templates:
    """Return the templates for a grid with *px_per_m* (x, y); *shadow* = unit vector in px towards cast shadows.

    Scale and shadow are rounded to half a percent and two degrees, so that the frames of a block share one drawing.
    """
    scale_x, scale_y = (float(np.exp(_SCALE_STEP * round(np.log(scale) / _SCALE_STEP))) for scale in px_per_m)
    if shadow is not None:
        angle = _ANGLE_STEP * round(np.arctan2(shadow[1], shadow[0]) / _ANGLE_STEP)
        shadow = (float(np.cos(angle)), float(np.sin(angle)))
    return _drawn((scale_x, scale_y), shadow, params)


@lru_cache(maxsize=8)
def _drawn(px_per_m: tuple[float, float], shadow: tuple[float, float] | None, params: DetectionParams) -> Templates:
    angles = np.pi * np.arange(params.directions) / params.directions
    axes = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    offsets: list[NDArray[np.int32]] = []
    starts = np.zeros((len(axes), len(params.sizes_m), PARTS + 1), np.int32)
    total = 0
    for d, axis in enumerate(axes):
        for k, size in enumerate(params.sizes_m):
            starts[d, k, 0] = total
            for part, points in enumerate(_parts(axis, size, px_per_m, shadow, params)):
                pixels = _pixels(points, axis, px_per_m)
                offsets.append(pixels)
                total += len(pixels)
                starts[d, k, part + 1] = total
    length, width = np.array(params.sizes_m, float).T / 2
    sideways = np.stack([-axes[:, 1], axes[:, 0]], axis=1)
    half_axes = np.concatenate(
        [axes[:, None] * length[:, None] * px_per_m, sideways[:, None] * width[:, None] * px_per_m], axis=2
    )
    return Templates(np.concatenate(offsets), starts, half_axes, _shades(px_per_m, shadow, params))


def _shades(
    px_per_m: tuple[float, float], shadow: tuple[float, float] | None, params: DetectionParams
) -> NDArray[np.float64]:
    """Return how far shadows may reach: lorries stand higher than cars, by about as much as they are wider and more."""
    if shadow is None:
        return np.zeros((len(params.sizes_m), 2))
    on_ground = np.array(shadow) / np.array(px_per_m)
    longest = params.shadow_reach_m * np.array(
        [_LORRY_REACH if width > _LORRY_WIDTH_M else _CAR_REACH for _, width in params.sizes_m]
    )
    return np.asarray(longest[:, None] * (np.array(shadow) / np.linalg.norm(on_ground)))


def _parts(
    axis: NDArray[np.float64],
    size: tuple[float, float],
    px_per_m: tuple[float, float],
    shadow: tuple[float, float] | None,
    params: DetectionParams,
) -> list[NDArray[np.float64]]:
    """Return points (n, 2) along and across, in metres from the centre, of every part of one template."""
    length, width = size
    step = 1.0 / min(px_per_m)
    along = _spread(length, max(step, length / _MOST_ALONG))
    across = _spread(width, max(step, width / _MOST_ACROSS))
    rim = max(params.rim_m, 0.75 * step)
    ends, sides = length / 2 + rim, width / 2 + rim
    inside = _grid(along, across)
    return [
        inside,
        _grid(np.array([ends]), across),
        _grid(np.array([-ends]), across),
        _grid(along, np.array([-sides])),
        _grid(along, np.array([sides])),
        _cast(inside, axis, size, px_per_m, shadow, params) if shadow is not None else np.zeros((0, 2)),
    ]


def _cast(
    inside: NDArray[np.float64],
    axis: NDArray[np.float64],
    size: tuple[float, float],
    px_per_m: tuple[float, float],
    shadow: tuple[float, float],
    params: DetectionParams,
) -> NDArray[np.float64]:
    """Return the points of the box, moved along the shadow, that leave it."""
    on_ground = np.array(shadow) / np.array(px_per_m)
    on_ground *= params.shadow_reach_m / np.linalg.norm(on_ground)
    move = np.array([on_ground @ axis, on_ground @ np.array([-axis[1], axis[0]])])
    moved = inside + move
    # Pixels on the edge are a mixture, they show nothing.
    outside = (np.abs(moved[:, 0]) > size[0] / 2 + 0.2) | (np.abs(moved[:, 1]) > size[1] / 2 + 0.2)
    return np.asarray(moved[outside])


def _spread(extent: float, step: float) -> NDArray[np.float64]:
    count = max(2, round(extent / step))
    return np.asarray((np.arange(count) - (count - 1) / 2) * (extent / count))


def _grid(along: NDArray[np.float64], across: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack(np.meshgrid(along, across, indexing="ij"), axis=-1).reshape(-1, 2)


def _pixels(points: NDArray[np.float64], axis: NDArray[np.float64], px_per_m: tuple[float, float]) -> NDArray[np.int32]:
    x = points[:, 0] * axis[0] - points[:, 1] * axis[1]
    y = points[:, 0] * axis[1] + points[:, 1] * axis[0]
    return np.stack([np.rint(y * px_per_m[1]), np.rint(x * px_per_m[0])], axis=1).astype(np.int32)
