"""Where the reference frame lies on the ground, from whatever is known about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.errors import ConfigError
from vtrack_batch.georeference.crs import crs_title, is_projected_metric, projected_crs, same_crs, transformed, utm_crs
from vtrack_batch.georeference.params import GeoreferenceParams
from vtrack_batch.georeference.plane import agreeing, distances, fit_affine, fit_homography, rms
from vtrack_batch.model import homography
from vtrack_batch.model.geotags import GeoTags

Fit = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]

_BLUNDER_PX = 3.0
_PERSPECTIVE_PX = 2.0
_GRID_POINTS = 9
# A pixel of 0.1 mm does not exist; one of 0.0001 degrees is 10 m.
_SMALLEST_PIXEL_M = 1e-4


@dataclass(frozen=True, eq=False)
class GroundFix:
    """Where a reference frame lies: ``reference_to_ground`` (3, 3), reference px -> ground metres.

    ``residual_m``: root mean square distance of control points, or of the change of CRS; None where nothing was left
    over to tell. ``crs``: None = local metres. ``gsd_m``: metres per pixel along columns and rows at the centre.
    ``left_out``: indices of control points that contradict the others.
    """

    reference_to_ground: NDArray[np.float64]
    method: str
    residual_m: float | None
    crs: str | None
    gsd_m: tuple[float, float]
    left_out: tuple[int, ...] = ()


@dataclass(frozen=True)
class WorldFile:
    """The text of a world file, and its name for messages."""

    name: str
    text: str


def find_fix(
    params: GeoreferenceParams,
    width_px: int,
    height_px: int,
    *,
    tags: GeoTags | None = None,
    world_file: WorldFile | None = None,
) -> GroundFix:
    """Fix the reference frame of *width_px* x *height_px* by ``params.source``.

    ``auto`` takes the first there is: control points, *tags* of a GeoTIFF, *world_file*, scale. Raises `ConfigError`
    where the demanded source is missing, or where what it says cannot be used.
    """
    size = (width_px, height_px)
    if params.control_points is not None:
        return fix_from_control_points(params, *size)
    # An origin is a statement about the frame, and goes before what a file happens to carry.
    stated = params.source == "scale" or (params.source == "auto" and params.origin is not None)
    if tags is not None and not stated and params.source != "world_file":
        return fix_from_geotags(tags, params, *size)
    if params.source == "geotiff":
        raise ConfigError(
            "georeference.source is geotiff, but the reference frame carries no georeference; set source to auto, or "
            "give GeoTIFF frames"
        )
    if world_file is not None and not stated:
        return fix_from_world_file(world_file, params, *size)
    if params.source == "world_file":
        raise ConfigError(
            "georeference.source is world_file, but there is none beside the reference frame; put one there under the "
            "frame's name, or set source to auto"
        )
    return fix_from_scale(params, *size)


def fix_from_scale(params: GeoreferenceParams, width_px: int, height_px: int) -> GroundFix:
    """Fix by ground sampling distance, origin of the frame's top-left corner, and rotation.

    Without rotation, x = x0 + (col + 0.5) gsd_x and y = y0 - (row + 0.5) gsd_y; x0 = y0 = 0 in the local frame.
    """
    if params.crs is not None and params.origin is None:
        raise ConfigError(
            f"georeference.crs is {params.crs}, but nothing says where in it the frames lie: "
            "give origin or control_points, or frames with a georeference or a world file"
        )
    origin = (params.origin.x_m, params.origin.y_m) if params.origin else (0.0, 0.0)
    turn = np.deg2rad(params.rotation_deg)
    right = params.gsd_xy_m[0] * np.array([np.cos(turn), -np.sin(turn)])
    down = -params.gsd_xy_m[1] * np.array([np.sin(turn), np.cos(turn)])
    matrix = _from_corner(np.column_stack([right, down, np.array(origin)]))
    return GroundFix(matrix, "scale", None, params.crs, scale_at(matrix, width_px, height_px))


def fix_from_control_points(params: GeoreferenceParams, width_px: int, height_px: int) -> GroundFix:
    """Fix by control points: an affine map, or from 4 points on a homography where it predicts better.

    From 6 points on, those that contradict the others are left out first. Raises `ConfigError` where the points
    describe a mirrored ground, as they do with x and y exchanged.
    """
    points = params.control_points or ()
    pixels = np.array([(point.col_px, point.row_px) for point in points], float).reshape(-1, 2)
    ground = np.array([(point.x_m, point.y_m) for point in points], float).reshape(-1, 2)
    rough = fit_affine(pixels, ground)
    if np.linalg.det(rough[:2, :2]) >= 0:
        raise ConfigError(
            "the control points describe a mirrored ground: are x_m and y_m exchanged, or rows counted upwards?"
        )
    metres_per_px = float(np.sqrt(-np.linalg.det(rough[:2, :2])))
    kept = np.ones(len(points), bool)
    if len(points) >= 6:
        kept = agreeing(pixels, ground, _BLUNDER_PX * metres_per_px)
    matrix, residual_m = _best_plane(pixels[kept], ground[kept], _PERSPECTIVE_PX * metres_per_px)
    _require_view(matrix, width_px, height_px)
    left_out = tuple(int(index) for index in np.flatnonzero(~kept))
    scale = scale_at(matrix, width_px, height_px)
    return GroundFix(matrix, "control_points", residual_m, params.crs, scale, left_out)


def fix_from_world_file(world_file: WorldFile, params: GeoreferenceParams, width_px: int, height_px: int) -> GroundFix:
    """Fix by the six numbers of a world file, which place the centre of the first pixel; its CRS is ``params.crs``."""
    across_x, across_y, down_x, down_y, x, y = _six_numbers(world_file)
    matrix = np.array([[across_x, down_x, x], [across_y, down_y, y], [0, 0, 1]])
    _require_plane(matrix, world_file.name)
    if max(abs(across_x), abs(across_y)) < _SMALLEST_PIXEL_M:
        raise ConfigError(
            f"{world_file.name}: pixels of {max(abs(across_x), abs(across_y)):g} are degrees, not metres; "
            "project the frames, or give control_points in metres"
        )
    return GroundFix(matrix, "world_file", None, params.crs, scale_at(matrix, width_px, height_px))


def fix_from_geotags(tags: GeoTags, params: GeoreferenceParams, width_px: int, height_px: int) -> GroundFix:
    """Fix by the tags of a GeoTIFF; where they are in another CRS than ``params.crs``, its points are transformed."""
    x, across_x, down_x, y, across_y, down_y = tags.geotransform
    matrix = _from_corner(np.array([[across_x, down_x, x], [across_y, down_y, y]]))
    _require_plane(matrix, "the GeoTIFF's georeference")
    found = GroundFix(matrix, "geotiff", None, tags.crs or params.crs, scale_at(matrix, width_px, height_px))
    if tags.crs is None:
        return found
    if params.crs is not None and not same_crs(tags.crs, params.crs):
        return _reprojected(found, tags.crs, params.crs, (width_px, height_px))
    if is_projected_metric(tags.crs):
        return replace(found, crs=projected_crs(tags.crs))
    centre = homography.apply(matrix, np.array([[(width_px - 1) / 2, (height_px - 1) / 2]]))[0]
    raise ConfigError(
        f"the GeoTIFF is in {crs_title(tags.crs)}, which is not in metres; "
        f"set georeference.crs to a projected one, such as {utm_crs(centre, tags.crs)}"
    )


def scale_at(reference_to_ground: NDArray[np.float64], width_px: int, height_px: int) -> tuple[float, float]:
    """Return the metres per pixel, along columns and along rows, at the centre of a frame."""
    centre = np.array([[(width_px - 1) / 2, (height_px - 1) / 2]])
    along = np.linalg.norm(homography.jacobian(reference_to_ground, centre)[0], axis=0)
    return float(along[0]), float(along[1])


def _from_corner(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn a map (2, 3) of coordinates that are 0 at the first pixel's corner into one for 0 at its centre."""
    matrix = np.vstack([linear, [0, 0, 1]])
    matrix[:2, 2] += 0.5 * (matrix[:2, 0] + matrix[:2, 1])
    return matrix


def _best_plane(
    pixels: NDArray[np.float64], ground: NDArray[np.float64], perspective_m: float
) -> tuple[NDArray[np.float64], float | None]:
    """Return the better of an affine map and a homography, and its residual in metres; None if none is left over."""
    affine = fit_affine(pixels, ground)
    if len(pixels) == 3:
        return affine, None
    affine_m = rms(distances(affine, pixels, ground))
    if len(pixels) == 4:
        return (fit_homography(pixels, ground), None) if affine_m > perspective_m else (affine, affine_m)
    if _left_out_error(fit_homography, pixels, ground) < _left_out_error(fit_affine, pixels, ground):
        curved = fit_homography(pixels, ground)
        return curved, rms(distances(curved, pixels, ground))
    return affine, affine_m


def _left_out_error(fit: Fit, pixels: NDArray[np.float64], ground: NDArray[np.float64]) -> float:
    """Return how well, root mean square, *fit* predicts each point from the others."""
    errors = []
    for index in range(len(pixels)):
        others = np.arange(len(pixels)) != index
        matrix = fit(pixels[others], ground[others])
        errors.append(distances(matrix, pixels[[index]], ground[[index]])[0])
    return rms(np.array(errors))


def _reprojected(found: GroundFix, source: str, target: str, size: tuple[int, int]) -> GroundFix:
    """Return *found* in the CRS *target*: a grid of points is transformed and a homography fitted to it."""
    columns, rows = (np.linspace(-0.5, side - 0.5, _GRID_POINTS) for side in size)
    pixels = np.column_stack([axis.ravel() for axis in np.meshgrid(columns, rows)])
    ground = transformed(homography.apply(found.reference_to_ground, pixels), source, target)
    matrix = fit_homography(pixels, ground)
    residual_m = rms(distances(matrix, pixels, ground))
    return GroundFix(matrix, found.method, residual_m, projected_crs(target), scale_at(matrix, *size))


def _six_numbers(world_file: WorldFile) -> list[float]:
    lines = [line.strip() for line in world_file.text.splitlines()]
    while lines and not lines[-1]:
        lines.pop()
    numbers = []
    for at, line in enumerate(lines[:6], start=1):
        try:
            number = float(line.replace(",", "."))
        except ValueError:
            raise ConfigError(f"{world_file.name}, line {at}: expected a number, found {line!r}") from None
        if not np.isfinite(number):
            raise ConfigError(f"{world_file.name}, line {at}: expected a finite number, found {line!r}")
        numbers.append(number)
    if len(lines) != 6:
        raise ConfigError(f"{world_file.name}: a world file has 6 lines of one number each, this one has {len(lines)}")
    return numbers


def _require_plane(matrix: NDArray[np.float64], name: str) -> None:
    area = abs(float(np.linalg.det(matrix[:2, :2])))
    size = float(np.abs(matrix[:2, :2]).max())
    if not np.isfinite(matrix).all() or area <= 1e-9 * size * size:
        raise ConfigError(
            f"{name}: its pixels have no area (a column leads to {matrix[0, 0]:g}, {matrix[1, 0]:g}, a row to "
            f"{matrix[0, 1]:g}, {matrix[1, 1]:g}); correct it"
        )


def _require_view(matrix: NDArray[np.float64], width_px: int, height_px: int) -> None:
    depth = homography.corners(width_px, height_px) @ matrix[2, :2] + matrix[2, 2]
    if (depth <= 0).any():
        raise ConfigError(
            "the control points put part of the frame beyond the horizon: check each point's col_px, row_px, x_m and "
            "y_m, or give more of them near the frame's corners"
        )
