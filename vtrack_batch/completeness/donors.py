"""Vehicles cut from frames, and painted into others: body, paint, windscreen and shadow as they are.

A donor is kept at the exposure of the background, and painted at that of its new place: the ratio of the frame to the
background around it. What it covers is replaced, what its shadow darkens is darkened in the same ratio.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model.homography import Array

Picture = NDArray[np.uint8]
Floats = NDArray[np.float32]

_FINE = 2
_SHADOW_REACH_M = 3.0
_EDGE_M = 0.12
_RING_M = (0.8, 2.5)
_DARKEST, _LIGHTEST = 0.3, 0.92


@dataclass(frozen=True, eq=False)
class Donor:
    """One vehicle: ``body`` (h, w, 3) levels at the background's exposure, ``cover`` (h, w) how much of the ground it
    hides, ``shade`` (h, w) what its shadow leaves of the light; columns run along it, two pixels for each of the frame.
    """

    body: Floats
    cover: Floats
    shade: Floats


@dataclass(frozen=True, eq=False)
class Canvas:
    """A frame to cut from or paint into: ``pixels`` (H, W, 3), the ``ground`` (H, W, 4) as seen there, 255 = unseen.

    ``shadow`` = unit vector in px towards cast shadows, None where none are cast.
    """

    pixels: Picture
    ground: Picture
    px_per_m: float
    shadow: tuple[float, float] | None


def cut(canvas: Canvas, box: Array) -> Donor | None:
    """Return the vehicle in *box* (6,), with what it casts; None beside unseen ground or over the border."""
    along, across = np.hypot(*box[2:4]), np.hypot(*box[4:6])
    axis = box[2:4] / along
    reach = _SHADOW_REACH_M * canvas.px_per_m
    size = (round(2 * _FINE * (along + reach)), round(2 * _FINE * (across + reach)))
    to_frame = _patch_to_frame(box[:2], axis, size)
    light = _light(canvas, box)
    if light is None:
        return None
    pixels, ground = (_pulled(image, to_frame, size) for image in (canvas.pixels, canvas.ground))
    if ground[:, :, 3].max() > 254:
        return None
    body = pixels / light
    cover = _soft_box(size, _FINE * along, _FINE * across, _FINE * _EDGE_M * canvas.px_per_m)
    shade = np.ones_like(cover)
    if canvas.shadow is not None:
        ratio = ((body + 2.0) / (ground[:, :, :3] + 2.0)).mean(axis=2)
        cast = _swept(cover, canvas, axis) & (ratio > _DARKEST) & (ratio < _LIGHTEST)
        shade = np.asarray(cv2.blur(np.where(cast, ratio, 1.0), (3, 3)), np.float32)
    return Donor(body.astype(np.float32), cover, shade)


def paint(canvas: Canvas, box: Array, donor: Donor) -> bool:
    """Paint *donor* over the middle of *box* (6,), front to front; return whether there was light to go by."""
    light = _light(canvas, box)
    if light is None:
        return False
    axis = box[2:4] / np.hypot(*box[2:4])
    size = (donor.cover.shape[1], donor.cover.shape[0])
    at, to_patch, roi = _window(canvas, box[:2], axis, size)
    if roi[0] <= 0 or roi[1] <= 0:
        return False
    body = _pushed(donor.body, to_patch, roi, 0.0)
    cover = _pushed(donor.cover, to_patch, roi, 0.0)[:, :, None]
    shade = _pushed(donor.shade, to_patch, roi, 1.0)[:, :, None]
    below = canvas.pixels[at].astype(np.float32)
    painted = cover * body * light.astype(np.float32) + (1 - cover) * below * shade
    canvas.pixels[at] = np.clip(np.rint(painted), 0, 255)
    return True


def erase(canvas: Canvas, box: Array, keep: NDArray[np.bool_], by_px: float) -> None:
    """Replace what stands in *box* (6,), and its shadow, by the ground; pixels to *keep* (H, W) stay."""
    light = _light(canvas, box)
    if light is None:
        return
    along, across = np.hypot(*box[2:4]) + by_px, np.hypot(*box[4:6]) + by_px
    axis = box[2:4] / np.hypot(*box[2:4])
    reach = _SHADOW_REACH_M * canvas.px_per_m
    size = (round(2 * _FINE * (along + reach)), round(2 * _FINE * (across + reach)))
    cover = _soft_box(size, _FINE * along, _FINE * across, _FINE * _EDGE_M * canvas.px_per_m)
    at, to_patch, roi = _window(canvas, box[:2], axis, size)
    if roi[0] <= 0 or roi[1] <= 0:
        return
    body = _pushed(cover, to_patch, roi, 0.0)
    swept = np.zeros(body.shape, np.float32)
    if canvas.shadow is not None:
        swept = _pushed(_swept(cover, canvas, axis).astype(np.float32), to_patch, roi, 0.0)
    share = np.where(keep[at], 0.0, np.maximum(body, swept))[:, :, None].astype(np.float32)
    ground = canvas.ground[at][:, :, :3] * light.astype(np.float32)
    mixed = share * ground + (1 - share) * canvas.pixels[at]
    canvas.pixels[at] = np.clip(np.rint(mixed), 0, 255)


# windows --------------------------------------------------------------------------------------------------------------


def _patch_to_frame(centre: Array, axis: Array, size: tuple[int, int]) -> Array:
    """Return the map (2, 3) from a patch's pixels to the frame's: columns along *axis*, rows to its right."""
    along, across = axis / _FINE, np.array([-axis[1], axis[0]]) / _FINE
    start = centre - along * (size[0] - 1) / 2 - across * (size[1] - 1) / 2
    return np.stack([along, across, start], axis=1)


def _window(
    canvas: Canvas, centre: Array, axis: Array, size: tuple[int, int]
) -> tuple[tuple[slice, slice], Array, tuple[int, int]]:
    """Return the part of the canvas that a patch covers, the map from it to the patch, and its (width, height)."""
    to_frame = _patch_to_frame(centre, axis, size)
    corners = np.array([[0, 0], [size[0], 0], [0, size[1]], [size[0], size[1]]], float)
    reached = corners @ to_frame[:, :2].T + to_frame[:, 2]
    height, width = canvas.pixels.shape[:2]
    left, top = (max(0, int(np.floor(low))) for low in reached.min(axis=0))
    right, bottom = (int(np.ceil(high)) + 1 for high in reached.max(axis=0))
    right, bottom = min(right, width), min(bottom, height)
    whole = np.vstack([to_frame, [0.0, 0.0, 1.0]])
    to_patch = (np.linalg.inv(whole) @ np.array([[1.0, 0, left], [0, 1.0, top], [0, 0, 1.0]]))[:2]
    return (slice(top, bottom), slice(left, right)), to_patch, (right - left, bottom - top)


def _pulled(image: Picture, to_frame: Array, size: tuple[int, int]) -> Floats:
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(image, to_frame, size, flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=(0, 0, 0, 255)),
        np.float32,
    )


def _pushed(patch: Floats, to_patch: Array, roi: tuple[int, int], beyond: float) -> Floats:
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    value = (beyond, beyond, beyond)
    return np.asarray(
        cv2.warpAffine(patch, to_patch, roi, flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=value), np.float32
    )


def _soft_box(size: tuple[int, int], along: float, across: float, edge: float) -> Floats:
    """Return how much of each pixel of a patch a box of these half axes covers, *edge* px soft."""
    columns = np.abs(np.arange(size[0]) - (size[0] - 1) / 2)
    rows = np.abs(np.arange(size[1]) - (size[1] - 1) / 2)
    inside = [np.clip((half - way) / (2 * edge) + 0.5, 0, 1) for half, way in ((along, columns), (across, rows))]
    return np.asarray(inside[1][:, None] * inside[0][None, :], np.float32)


def _swept(cover: Floats, canvas: Canvas, axis: Array) -> NDArray[np.bool_]:
    """Return where the shadow of a box may fall: what it sweeps on its way away from the sun, without the box."""
    assert canvas.shadow is not None
    shadow = np.array(canvas.shadow)
    way = np.array([shadow @ axis, shadow @ np.array([-axis[1], axis[0]])]) * _FINE
    reach = _SHADOW_REACH_M * canvas.px_per_m
    body = (cover > 0.05).astype(np.uint8)
    swept = np.zeros_like(body)
    for step in np.arange(1.0, reach):
        shift = np.array([[1.0, 0.0, way[0] * step], [0.0, 1.0, way[1] * step]])
        swept |= np.asarray(cv2.warpAffine(body, shift, body.shape[::-1], flags=cv2.INTER_NEAREST), np.uint8)
    return np.asarray((swept > 0) & (cover < 0.5))


def _light(canvas: Canvas, box: Array) -> Array | None:
    """Return what the levels around *box* are to the background's, per channel; None where too little is seen."""
    reach = np.abs(box[2:4]) + np.abs(box[4:6]) + _RING_M[1] * canvas.px_per_m
    height, width = canvas.pixels.shape[:2]
    left, top = (max(0, int(low)) for low in box[:2] - reach)
    right, bottom = min(width, int(box[0] + reach[0]) + 1), min(height, int(box[1] + reach[1]) + 1)
    if right - left < 4 or bottom - top < 4:
        return None
    ground = canvas.ground[top:bottom, left:right].astype(np.float32)
    pixels = canvas.pixels[top:bottom, left:right].astype(np.float32)
    rows, columns = np.mgrid[top:bottom, left:right]
    x, y = columns - box[0], rows - box[1]
    half = np.hypot(*box[2:4]), np.hypot(*box[4:6])
    away = np.maximum(
        np.abs(x * box[2] + y * box[3]) / half[0] - half[0], np.abs(x * box[4] + y * box[5]) / half[1] - half[1]
    )
    ring = (away > _RING_M[0] * canvas.px_per_m) & (away < _RING_M[1] * canvas.px_per_m) & (ground[:, :, 3] < 255)
    if ring.sum() < 20:
        return None
    return np.asarray(np.median((pixels[ring] + 2.0) / (ground[ring][:, :3] + 2.0), axis=0), float)
