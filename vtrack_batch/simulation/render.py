"""Frames: the ground seen from the platform, traffic on it, what hides it, light, blur and noise of the camera."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtri

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation.canvas import Float32
from vtrack_batch.simulation.fleet import Looks
from vtrack_batch.simulation.flight import Flight
from vtrack_batch.simulation.paint import (
    SHADOW_RATIO,
    body_points,
    cast_shadows,
    dimmed,
    moved_up,
    paint_vehicles,
    sprites,
)
from vtrack_batch.simulation.scenery import Scenery, sun_of
from vtrack_batch.simulation.stage import Stage, compass_deg, directions
from vtrack_batch.simulation.standing import in_frame, paint_patches, uncovered
from vtrack_batch.simulation.view import CLOUD_SEED, SWAY_SEED, View

BAND_ROWS = 256
_HALO_ROWS = 8
_AIR_RGB = (176.0, 182.0, 194.0)
"""Colour of the light that the air between ground and camera scatters."""
_CLOUD_CELL_M = 60.0
_CLOUD_STEP_PX = 16


@dataclass(frozen=True)
class Camera:
    """What all frames of an archive share: the scenario, geometry, the flight of the platform and the scenery."""

    view: View
    stage: Stage
    flight: Flight
    scenery: Scenery

    def scene_to_frame(self, frame: int) -> Array:
        """Return the homography from scene metres to the pixels of a frame."""
        return self.stage.scene_to_frame(self.flight.poses[frame])


def render(camera: Camera, frame: int, table: Array, *, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return frame number *frame* (H, W, 3) uint8 RGB with the vehicles of *table* (see :func:`place`).

    It is made in bands of rows, so that large frames need little memory beside the result.
    """
    stage = camera.stage
    result = np.empty((stage.height_px, stage.width_px, 3), np.uint8)
    everyone = np.vstack([table, *_others(camera, frame)])
    above = _above(camera, frame)
    light, levels = _light_field(camera, frame), _noise_levels(camera.view.camera.noise_dn)
    # a photograph has its haze already
    air = camera.view.light.haze if camera.scenery.standing is not None else 0.0
    haze = np.append(np.array(_AIR_RGB) * air, 1 - air).astype(np.float32)
    for first in range(0, stage.height_px, BAND_ROWS):
        last = min(first + BAND_ROWS, stage.height_px)
        begin, end = max(0, first - _HALO_ROWS), min(stage.height_px, last + _HALO_ROWS)
        image = _band(camera, frame, everyone, above, (begin, end))[first - begin : last - begin]
        # a byte of chance per value, looked up among 256 quantiles, costs a fiftieth of a normal deviate
        chance = np.frombuffer(rng.bytes(image.size), np.uint8).reshape(image.shape)
        _expose(image, chance, levels, light, haze, first, result[first:last])
    return result


def place(camera: Camera, frame: int, looks: Looks, *, xy_m: Array, forward: Array) -> Array:
    """Return the painter's table of vehicles at scene points *xy_m* (n, 2) with unit vectors *forward* (n, 2)."""
    to_frame = camera.scene_to_frame(frame)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    axes = np.stack([directions(to_frame, xy_m, forward), directions(to_frame, xy_m, left)], axis=2)
    on_ground = directions(camera.stage.scene_to_ground, xy_m, forward)
    centre = apply(to_frame, xy_m)
    return sprites(looks, centre_px=centre, axes_px=axes, forward=on_ground, light=sun_of(camera.view))


def visible_share(camera: Camera, frame: int, table: Array) -> Array:
    """Return the share (n,) of each body of the painter's *table* that no crown, roof or bridge hides in that frame."""
    above = _above(camera, frame)
    if camera.scenery.standing is None or not len(table):
        return np.ones(len(table))
    atlas = camera.scenery.standing.atlas
    return np.asarray(uncovered(body_points(table), atlas.rgba, atlas.index, above), np.float64)


def shadow_share(camera: Camera, frame: int, table: Array) -> Array:
    """Return the share (n,) of each body of the painter's *table* that lies in the shadow of what stands around."""
    points = body_points(table)
    ground = camera.scenery.ground
    to_image = np.asarray(np.linalg.inv(camera.flight.poses[frame] @ ground.to_reference), np.float64)
    shade = _at(ground.rgba, apply(to_image, points.reshape(-1, 2)))[:, 3] / 255.0
    return np.asarray(shade.reshape(points.shape[:2]).mean(axis=1))


def ground_colour(camera: Camera, xy_m: Array) -> Array:
    """Return the colour (n, 3) of the ground at scene points *xy_m* (n, 2), in its static light."""
    ground = camera.scenery.ground
    to_image = np.linalg.inv(ground.to_reference) @ camera.stage.scene_to_frame(np.eye(3))
    return _at(ground.rgba, apply(to_image, xy_m))[:, :3]


def others(camera: Camera, frame: int) -> pd.DataFrame:
    """Return what moves in a frame and is no traffic: kind, place, size and heading, those in view alone."""
    rows = []
    for kind, xy, forward, looks in _moving(camera, frame):
        px = apply(camera.scene_to_frame(frame), xy)
        ground = apply(camera.stage.scene_to_ground, xy)
        heading = compass_deg(directions(camera.stage.scene_to_ground, xy, forward))
        sizes = {"length_m": looks.length_m, "width_m": looks.width_m, "heading_deg": heading}
        places = {"x_m": ground[:, 0], "y_m": ground[:, 1], "col_px": px[:, 0], "row_px": px[:, 1]}
        rows.append(pd.DataFrame({"kind": np.full(len(xy), kind), **places, **sizes}))
    names = ["kind", "x_m", "y_m", "col_px", "row_px", "length_m", "width_m", "heading_deg"]
    found = pd.concat(rows, ignore_index=True) if rows else pd.DataFrame(columns=names)
    within = found["col_px"].between(-0.5, camera.stage.width_px - 0.5)
    within &= found["row_px"].between(-0.5, camera.stage.height_px - 0.5)
    return found[within].reset_index(drop=True)


def _at(rgba: NDArray[np.uint8], px: Array) -> Array:
    """Return the pixels (n, 4) of an image nearest to the points *px* (n, 2), as floats."""
    col, row = np.round(px).astype(int).T
    height, width = rgba.shape[:2]
    return rgba[np.clip(row, 0, height - 1), np.clip(col, 0, width - 1)].astype(np.float64)


def _moving(camera: Camera, frame: int) -> list[tuple[str, Array, Array, Looks]]:
    """Return people and trams: kind, places (n, 2), directions (n, 2) in the scene, looks."""
    scenery, t_s = camera.scenery, float(camera.view.t_s[frame])
    found = [("pedestrian", *scenery.people.at(t_s), scenery.people.looks)]
    if scenery.tram is not None:
        xy, forward = scenery.tram.at(t_s)
        sections = np.zeros(len(xy), np.int64)
        found.append(("tram", xy, forward, scenery.tram.looks.take(sections)))
    return found


def _others(camera: Camera, frame: int) -> list[Array]:
    """Return the painter's tables of people and trams."""
    return [
        place(camera, frame, looks, xy_m=xy, forward=forward)
        for _, xy, forward, looks in _moving(camera, frame)
        if len(xy)
    ]


def _above(camera: Camera, frame: int) -> Array:
    """Return the table of what stands above the ground as the platform sees it in a frame."""
    things, view = camera.scenery.standing, camera.view
    if things is None:
        return np.zeros((0, 8))
    to_scene = np.asarray(np.linalg.inv(camera.stage.scene_to_ground), np.float64)
    nadir = apply(to_scene, (camera.stage.centre_m + camera.flight.nadir_m[frame])[None])[0]
    sway = None
    if view.ground.sway_m:
        sway = view.rng(SWAY_SEED, frame).standard_normal((len(things.crown), 4))
        sway *= [view.ground.sway_m, view.ground.sway_m, 0.02, 0.02]
    return in_frame(
        things,
        camera.scene_to_frame(frame),
        nadir=nadir,
        altitude_m=view.camera.altitude_m,
        sway=sway,
        size_px=(camera.stage.width_px, camera.stage.height_px),
    )


def _band(camera: Camera, frame: int, everyone: Array, above: Array, rows: tuple[int, int]) -> Float32:
    """Return the rows *begin* to *end* of a frame as light falls through the lens: no noise, no exposure yet."""
    begin, end = rows
    view, ground = camera.view, camera.scenery.ground
    up = np.array([[1, 0, 0], [0, 1, -float(begin)], [0, 0, 1]])
    to_band = up @ camera.flight.poses[frame] @ ground.to_reference
    size = (camera.stage.width_px, end - begin)
    seen = np.asarray(
        cv2.warpPerspective(ground.rgba, to_band, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT), np.uint8
    )
    image: Float32 = _colours(seen)
    table = moved_up(everyone, begin)
    if view.light.shadow:
        shade = np.zeros(seen.shape[:2], np.float32)
        cast_shadows(shade, table)
        _darken(image, shade, seen[..., 3], 1 - SHADOW_RATIO)
    paint_vehicles(image, _in_static_shadow(table, seen[..., 3]))
    if camera.scenery.standing is not None:
        atlas = camera.scenery.standing.atlas
        paint_patches(image, atlas.rgba, atlas.index, above, begin)
    if view.camera.blur_px:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), view.camera.blur_px), np.float32)
    return image


def _in_static_shadow(table: Array, shade: NDArray[np.uint8]) -> Array:
    """Return *table* with each vehicle's light dimmed by the static shadow at its centre."""
    row = np.clip(np.round(table[:, 1]).astype(int), 0, shade.shape[0] - 1)
    col = np.clip(np.round(table[:, 0]).astype(int), 0, shade.shape[1] - 1)
    return dimmed(table, 1 - (1 - float(SHADOW_RATIO.mean())) * shade[row, col] / 255)


def _noise_levels(sigma: float) -> Float32:
    """Return 256 equally likely values (256,) of a normal distribution with spread *sigma*."""
    levels = ndtri((np.arange(256) + 0.5) / 256)
    return np.asarray(sigma * levels / levels.std(), np.float32)


def _light_field(camera: Camera, frame: int) -> NDArray[np.float32]:
    """Return the gain of the whole frame on a coarse grid: exposure times drifting cloud shade."""
    stage, cloud = camera.stage, camera.view.light.cloud
    rows, cols = stage.height_px // _CLOUD_STEP_PX + 2, stage.width_px // _CLOUD_STEP_PX + 2
    exposure = float(camera.flight.exposure[frame])
    if not cloud:
        return np.full((rows, cols), exposure, np.float32)
    # a periodic field, the same for all frames, seen through a window that drifts with the wind
    field = camera.view.rng(CLOUD_SEED).standard_normal((64, 64)).astype(np.float32)
    field = np.asarray(cv2.GaussianBlur(np.tile(field, (3, 3)), (0, 0), 1.2), np.float32)[64:128, 64:128]
    field /= field.std()
    cell_px = _CLOUD_CELL_M / stage.gsd_m
    shift = camera.flight.cloud_m[frame] / stage.gsd_m
    x = (np.arange(cols) * _CLOUD_STEP_PX + shift[0]) / cell_px
    y = (np.arange(rows) * _CLOUD_STEP_PX + shift[1]) / cell_px
    across, down = np.meshgrid(np.mod(x, 64).astype(np.float32), np.mod(y, 64).astype(np.float32))
    shade = cv2.remap(np.pad(field, ((0, 1), (0, 1)), mode="wrap"), across, down, interpolation=cv2.INTER_LINEAR)
    return np.asarray(exposure * (1 + np.float32(cloud) * np.clip(shade, -2, 2)), np.float32)


@njit(cache=True, nogil=True)
def _colours(rgba):  # type: ignore[no-untyped-def]
    """Return red, green and blue (H, W, 3) as float32; numpy is slow to cast three channels of four."""
    image = np.empty((rgba.shape[0], rgba.shape[1], 3), np.float32)
    for row in range(rgba.shape[0]):
        for col in range(rgba.shape[1]):
            for c in range(3):
                image[row, col, c] = rgba[row, col, c]
    return image


@njit(cache=True, nogil=True)
def _darken(image, shade, static, loss):  # type: ignore[no-untyped-def]
    """Take the sun from where moving shadows fall, but not twice where a static shadow lies already."""
    for row in range(image.shape[0]):
        for col in range(image.shape[1]):
            if shade[row, col] > 0.0:
                part = shade[row, col] * (1.0 - static[row, col] / 255.0)
                for c in range(3):
                    image[row, col, c] *= 1.0 - part * loss[c]


@njit(cache=True, nogil=True)
def _expose(image, chance, levels, gain, haze, first, result):  # type: ignore[no-untyped-def]
    """Add *haze*, multiply by the coarse *gain* grid (bilinear), add the noise ``levels[chance]``, round to uint8.

    *haze* (4,) is what is added to red, green and blue, and what is left of the ground's light. Row 0 of *image* and
    of *result* is row *first* of the frame.
    """
    height, width = image.shape[:2]
    for row in range(height):
        r = (row + first) // _CLOUD_STEP_PX
        fr = np.float32(((row + first) % _CLOUD_STEP_PX) / _CLOUD_STEP_PX)
        for col in range(width):
            c = col // _CLOUD_STEP_PX
            fc = np.float32((col % _CLOUD_STEP_PX) / _CLOUD_STEP_PX)
            upper = gain[r, c] + fc * (gain[r, c + 1] - gain[r, c])
            lower = gain[r + 1, c] + fc * (gain[r + 1, c + 1] - gain[r + 1, c])
            g = upper + fr * (lower - upper)
            for k in range(3):
                value = (image[row, col, k] * haze[3] + haze[k]) * g + levels[chance[row, col, k]] + np.float32(0.5)
                result[row, col, k] = np.uint8(min(max(value, np.float32(0.0)), np.float32(255.0)))
