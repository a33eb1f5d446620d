"""Frames: the ground seen from the platform, traffic and its shadows on it, light, blur and noise of the camera."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtri

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.simulation.canvas import Float32
from vtrack_batch.simulation.fleet import Looks
from vtrack_batch.simulation.flight import Flight
from vtrack_batch.simulation.ground import Ground
from vtrack_batch.simulation.paint import SHADOW_RATIO, Sun, cast_shadows, dimmed, paint_vehicles, sprites
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.stage import Stage, directions

_CLOUD_CELL_M = 60.0
_CLOUD_STEP_PX = 16


@dataclass(frozen=True)
class Camera:
    """What all frames of an archive share: ground, geometry, light and the flight of the platform."""

    ground: Ground
    stage: Stage
    flight: Flight
    light: Sun
    scenario: Scenario


def render(camera: Camera, frame: int, table: Array, *, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return frame number *frame* (H, W, 3) uint8 RGB with the vehicles of *table* (see :func:`place`)."""
    scenario, stage = camera.scenario, camera.stage
    size = (stage.width_px, stage.height_px)
    to_frame = camera.flight.poses[frame] @ camera.ground.to_reference
    warped = cv2.warpPerspective(
        camera.ground.rgba, to_frame, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
    )
    seen = np.asarray(warped, np.uint8)
    image: Float32 = seen[..., :3].astype(np.float32)
    if scenario.shadow:
        shade = np.zeros((stage.height_px, stage.width_px), np.float32)
        cast_shadows(shade, table)
        _darken(image, shade, seen[..., 3], 1 - SHADOW_RATIO)
    paint_vehicles(image, _in_static_shadow(table, seen[..., 3]))
    if scenario.blur_px:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), scenario.blur_px), np.float32)
    # a byte of chance per value, looked up among 256 quantiles, costs a fiftieth of a normal deviate
    chance = np.frombuffer(rng.bytes(image.size), np.uint8).reshape(image.shape)
    return _expose(image, chance, _noise_levels(scenario.noise_dn), _light_field(camera, frame))


def place(camera: Camera, frame: int, looks: Looks, *, xy_m: Array, forward: Array) -> Array:
    """Return the painter's table of vehicles at scene points *xy_m* (n, 2) with unit vectors *forward* (n, 2)."""
    to_frame = camera.stage.scene_to_frame(camera.flight.poses[frame])
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    axes = np.stack([directions(to_frame, xy_m, forward), directions(to_frame, xy_m, left)], axis=2)
    on_ground = directions(camera.stage.scene_to_ground, xy_m, forward)
    return sprites(looks, centre_px=apply(to_frame, xy_m), axes_px=axes, forward=on_ground, light=camera.light)


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
    scenario, stage = camera.scenario, camera.stage
    rows, cols = stage.height_px // _CLOUD_STEP_PX + 2, stage.width_px // _CLOUD_STEP_PX + 2
    exposure = float(camera.flight.exposure[frame])
    if not scenario.cloud:
        return np.full((rows, cols), exposure, np.float32)
    # a periodic field, the same for all frames, seen through a window that drifts with the wind
    field = np.random.default_rng([scenario.seed, 77]).standard_normal((64, 64)).astype(np.float32)
    field = np.asarray(cv2.GaussianBlur(np.tile(field, (3, 3)), (0, 0), 1.2), np.float32)[64:128, 64:128]
    field /= field.std()
    cell_px = _CLOUD_CELL_M / stage.gsd_m
    shift = camera.flight.cloud_m[frame] / stage.gsd_m
    x = (np.arange(cols) * _CLOUD_STEP_PX + shift[0]) / cell_px
    y = (np.arange(rows) * _CLOUD_STEP_PX + shift[1]) / cell_px
    across, down = np.meshgrid(np.mod(x, 64).astype(np.float32), np.mod(y, 64).astype(np.float32))
    shade = cv2.remap(np.pad(field, ((0, 1), (0, 1)), mode="wrap"), across, down, interpolation=cv2.INTER_LINEAR)
    return np.asarray(exposure * (1 + np.float32(scenario.cloud) * np.clip(shade, -2, 2)), np.float32)


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
def _expose(image, chance, levels, gain):  # type: ignore[no-untyped-def]
    """Multiply by the coarse *gain* grid (bilinear), add the noise ``levels[chance]``, round to uint8."""
    height, width = image.shape[:2]
    result = np.empty((height, width, 3), np.uint8)
    for row in range(height):
        r = row // _CLOUD_STEP_PX
        fr = np.float32((row % _CLOUD_STEP_PX) / _CLOUD_STEP_PX)
        for col in range(width):
            c = col // _CLOUD_STEP_PX
            fc = np.float32((col % _CLOUD_STEP_PX) / _CLOUD_STEP_PX)
            upper = gain[r, c] + fc * (gain[r, c + 1] - gain[r, c])
            lower = gain[r + 1, c] + fc * (gain[r + 1, c + 1] - gain[r + 1, c])
            g = upper + fr * (lower - upper)
            for k in range(3):
                value = image[row, col, k] * g + levels[chance[row, col, k]] + np.float32(0.5)
                result[row, col, k] = np.uint8(min(max(value, np.float32(0.0)), np.float32(255.0)))
    return result
