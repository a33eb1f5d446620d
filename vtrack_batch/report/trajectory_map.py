"""The reference frame with every trajectory over it, coloured by speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import pandas as pd
import shapely
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from vtrack_batch.model import homography
from vtrack_batch.model.zones import Zone
from vtrack_batch.report.canvas import MAX_SIDE_PX, Pixels, resized, to_png

_DPI = 100
_MARGIN_PX, _TITLE_PX, _BAR_PX = 16, 70, 140
_MIN_WIDTH_PX, _MIN_HEIGHT_PX = 1200, 500
_MAX_POINTS = 200_000
_MANY = 200
# Without its darkest end, which cannot be seen on a dark ground.
_SPEED_COLOURS = ListedColormap(colormaps["viridis"](np.linspace(0.12, 1.0, 256)))
_OUTLINE = [withStroke(linewidth=3, foreground="black")]
_ZONE_COLOURS = {
    "gate": "#ffffff",
    "zone": "#56b4e9",
    "approach": "#e69f00",
    "lane": "#f0e442",
    "exclusion": "#d55e00",
}


@dataclass(frozen=True)
class _View:
    """The part of the reference plane that is shown, in its pixels, and the picture's pixels for one of them."""

    left: float
    top: float
    right: float
    bottom: float
    scale: float

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the map in the picture."""
        return round((self.right - self.left) * self.scale), round((self.bottom - self.top) * self.scale)


def trajectory_map(
    reference_pixels: Pixels,
    reference_to_ground: NDArray[np.float64],
    track_points: pd.DataFrame,
    trajectories: pd.DataFrame,
    zones: Sequence[Zone] = (),
    *,
    title: str,
) -> bytes:
    """Return the map as PNG.

    *reference_pixels* (H, W, 3) uint8 RGB; *reference_to_ground* (3, 3), its pixels to ground metres; *track_points*
    and *trajectories* as the tables of these names (of the latter, only ``vehicle_id`` is read: which ones to show);
    *zones* in ground metres. Where trajectories leave the reference frame, the map goes on for up to half a frame.
    """
    to_reference = np.asarray(np.linalg.inv(reference_to_ground), np.float64)
    shown = track_points.loc[track_points["vehicle_id"].isin(trajectories["vehicle_id"])]
    points = _points(shown, to_reference)
    view = _view(reference_pixels.shape[1], reference_pixels.shape[0], points)
    width, height = view.size_px
    total = (width + 2 * _MARGIN_PX + _BAR_PX, height + 2 * _MARGIN_PX + _TITLE_PX)
    figure = Figure(figsize=(total[0] / _DPI, total[1] / _DPI), dpi=_DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    box = (_MARGIN_PX / total[0], _MARGIN_PX / total[1], width / total[0], height / total[1])
    axes = figure.add_axes(box, facecolor="#303030", xticks=[], yticks=[])
    _draw_ground(axes, reference_pixels, view)
    axes.set(xlim=(view.left, view.right), ylim=(view.bottom, view.top))
    fastest_kmh = _draw_lines(axes, points, view)
    _draw_zones(axes, zones, to_reference, view)
    _draw_graticule(axes, reference_to_ground, view)
    _draw_scale_and_north(axes, reference_to_ground, view)
    _draw_colour_bar(figure, fastest_kmh, box, total[0])
    _draw_title(figure, title, trajectories, shown, total)
    canvas.draw()
    return to_png(np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:, :, :3]))


def _font(points: float, width_px: int) -> float:
    """Return a font size that stays readable when a picture *width_px* wide is shown at a page's width."""
    return points * float(np.clip(width_px / 1400, 1.0, 1.6))


def _points(track_points: pd.DataFrame, to_reference: NDArray[np.float64]) -> pd.DataFrame:
    """Return vehicle_id, col_px, row_px on the reference frame and kmh, by vehicle and time."""
    ordered = track_points.sort_values(["vehicle_id", "t_utc"], kind="stable", ignore_index=True)
    place = homography.apply(to_reference, ordered[["x_m", "y_m"]].to_numpy(float))
    kmh = 3.6 * ordered["speed_mps"].to_numpy(float, na_value=np.nan)
    vehicle = ordered["vehicle_id"].astype(str).to_numpy(object)
    return pd.DataFrame({"vehicle_id": vehicle, "col_px": place[:, 0], "row_px": place[:, 1], "kmh": kmh})


def _view(width_px: int, height_px: int, points: pd.DataFrame) -> _View:
    limits = []
    for name, size in (("col_px", width_px), ("row_px", height_px)):
        values = points[name].to_numpy()
        values = values[np.isfinite(values)]
        low, high = (values.min() - 8, values.max() + 8) if len(values) else (0.0, 0.0)
        limits.append((max(-size / 2, min(-0.5, low)), min(1.5 * size, max(size - 0.5, high))))
    (left, right), (top, bottom) = limits
    wanted = max(_MIN_WIDTH_PX / (right - left), _MIN_HEIGHT_PX / (bottom - top), 1.0)
    scale = min(wanted, 4.0, MAX_SIDE_PX / (right - left), MAX_SIDE_PX / (bottom - top))
    return _View(left, top, right, bottom, scale)


def _draw_ground(axes: Axes, pixels: Pixels, view: _View) -> None:
    """Draw the frame grey and dark, so that colour means speed."""
    grey = cv2.cvtColor(resized(pixels, min(1.0, view.scale)), cv2.COLOR_RGB2GRAY)
    low, high = np.percentile(grey, (1, 99)) if grey.size else (0.0, 1.0)
    shades = np.clip(18 + 112 * (np.arange(256) - low) / max(high - low, 1.0), 0, 130).astype(np.uint8)
    dimmed = shades[grey]
    extent = (-0.5, pixels.shape[1] - 0.5, pixels.shape[0] - 0.5, -0.5)
    axes.imshow(dimmed, cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="bilinear", aspect="auto")


def _draw_lines(axes: Axes, points: pd.DataFrame, view: _View) -> float:
    """Draw all trajectories; return the speed at the top of the colour scale, km/h."""
    place = points[["col_px", "row_px"]].to_numpy()
    vehicle = points["vehicle_id"].to_numpy()
    kmh = points["kmh"].to_numpy()
    usable = kmh[np.isfinite(kmh)]
    fastest = 10 * np.ceil(max(20.0, float(np.percentile(usable, 98)) if len(usable) else 0.0) / 10)
    kept = _turning_points(place * view.scale, vehicle)
    place, vehicle, kmh = place[kept], vehicle[kept], kmh[kept]
    first = np.r_[True, vehicle[1:] != vehicle[:-1]] if len(place) else np.zeros(0, bool)
    joined = np.flatnonzero(~first)
    lines = np.stack([place[joined - 1], place[joined]], axis=1) if len(joined) else np.zeros((0, 2, 2))
    width = 2.0 if len(joined) < 20_000 else 1.2
    norm = Normalize(0, fastest)
    axes.add_collection(
        LineCollection(
            list(lines), array=kmh[joined], cmap=_SPEED_COLOURS, norm=norm, linewidths=width, capstyle="round"
        ),
        autolim=False,
    )
    last = np.r_[first[1:], True] if len(first) else first
    ends: dict[str, Any] = {"c": kmh[last], "cmap": _SPEED_COLOURS, "norm": norm, "edgecolors": "white"}
    ends |= {"s": 14, "linewidths": 0.6} if last.sum() < _MANY else {"s": 6, "linewidths": 0.4}
    axes.scatter(place[last, 0], place[last, 1], zorder=3, **ends)
    return float(fastest)


def _turning_points(place_px: NDArray[np.float64], vehicle: NDArray[np.object_]) -> NDArray[np.bool_]:
    """Return which points to draw (n,): a vehicle's first, and each that left the picture pixel of the one before.

    Where that leaves too many, the pixels are taken two, four, eight ... wide.
    """
    if not len(vehicle):
        return np.zeros(0, bool)
    first = np.r_[True, vehicle[1:] != vehicle[:-1]]
    for width_px in (1, 2, 4, 8, 16, 32):
        cell = np.floor(place_px / width_px)
        kept = first | np.r_[True, (cell[1:] != cell[:-1]).any(axis=1)]
        if kept.sum() <= _MAX_POINTS:
            break
    return kept


def _draw_zones(axes: Axes, zones: Sequence[Zone], to_reference: NDArray[np.float64], view: _View) -> None:
    window = shapely.box(view.left, view.top, view.right, view.bottom)
    for zone in sorted(zones, key=lambda zone: (zone.role, zone.id)):
        shape = shapely.transform(zone.geometry, lambda xy: homography.apply(to_reference, xy))
        seen = shape.intersection(window)
        if seen.is_empty:
            continue
        colour = _ZONE_COLOURS.get(zone.role, "#ffffff")
        line = shape.exterior if shape.geom_type == "Polygon" else shape
        cols, rows = np.asarray(line.coords).T
        if shape.geom_type == "Polygon":
            axes.fill(cols, rows, color=colour, alpha=0.12, linewidth=0, zorder=1)
        style = "--" if zone.role in ("exclusion", "lane") else "-"
        axes.plot(cols, rows, style, color=colour, linewidth=1.8, zorder=4, path_effects=_OUTLINE)
        at = _label_place(seen)
        font: dict[str, Any] = {"fontsize": _font(11, view.size_px[0]), "fontweight": "bold", "path_effects": _OUTLINE}
        axes.text(
            at.x,
            at.y,
            zone.id,
            color=colour,
            ha="center",
            va="center",
            zorder=5,
            clip_on=True,
            parse_math=False,
            **font,
        )


def _label_place(seen: shapely.Geometry) -> shapely.Point:
    """Return a point on the largest piece of what is seen of a zone: the middle of a line, the inside of an area."""
    piece = max(shapely.get_parts(seen), key=lambda part: (part.area, part.length))
    return piece.interpolate(0.5, normalized=True) if piece.geom_type == "LineString" else piece.representative_point()


def _draw_graticule(axes: Axes, reference_to_ground: NDArray[np.float64], view: _View) -> None:
    """Draw thin lines of equal x_m and y_m with their values, so that a reader can write down where a zone lies."""
    window = shapely.box(view.left, view.top, view.right, view.bottom)
    ground = homography.apply(reference_to_ground, shapely.get_coordinates(window))
    low, high = ground.min(axis=0), ground.max(axis=0)
    if not np.isfinite(ground).all():
        return
    to_reference = np.asarray(np.linalg.inv(reference_to_ground), np.float64)
    font: dict[str, Any] = {"color": "white", "alpha": 0.9, "fontsize": _font(7.5, view.size_px[0]), "zorder": 6}
    step_m = _round_down(float((high - low).max()) / 6)
    for axis, name in enumerate(("x", "y")):
        for value in np.arange(np.ceil(low[axis] / step_m), np.floor(high[axis] / step_m) + 1) * step_m:
            ends = np.array([low, high])
            ends[:, axis] = value
            line = shapely.LineString(homography.apply(to_reference, ends)).intersection(window)
            if line.geom_type != "LineString" or line.is_empty:
                continue
            (left, top), (right, bottom) = line.coords[0], line.coords[-1]
            axes.plot([left, right], [top, bottom], color="white", linewidth=0.6, alpha=0.35, zorder=2)
            # the label stands where the line enters: x along the upper border, y along the left one
            at = min(line.coords, key=lambda point: point[1 - axis])
            if axis == 0 or at[1] > view.top + 40 / view.scale:
                axes.text(at[0], at[1], f" {name} {value:.0f} m", va="top" if axis == 0 else "bottom", **font)


def _round_down(value: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, 50 ... and their tenths that is not above *value*."""
    power = float(10.0 ** np.floor(np.log10(value)))
    return power * max(step for step in (1, 2, 5) if step * power <= value)


def _draw_scale_and_north(axes: Axes, reference_to_ground: NDArray[np.float64], view: _View) -> None:
    """Draw a bar of round length at the lower left and an arrow to grid north at the upper right."""
    width, height = view.right - view.left, view.bottom - view.top
    unit = 1 / view.scale
    col, row = view.left + 24 * unit, view.bottom - 26 * unit
    forward = homography.jacobian(reference_to_ground, np.array([[col, row]]))[0]
    metre_px = 1 / max(float(np.hypot(*forward[:, 0])), 1e-12)
    length_m = _round_down(0.2 * min(width, 1.6 * height) / metre_px)
    axes.plot([col, col + length_m * metre_px], [row, row], color="white", linewidth=4, zorder=6, path_effects=_OUTLINE)
    text: dict[str, Any] = {
        "color": "white",
        "fontsize": _font(11, view.size_px[0]),
        "zorder": 6,
        "path_effects": _OUTLINE,
    }
    axes.text(col + length_m * metre_px / 2, row - 8 * unit, f"{length_m:g} m", ha="center", va="bottom", **text)
    at = np.array([view.right - 44 * unit, view.top + 56 * unit])
    north = np.linalg.inv(homography.jacobian(reference_to_ground, at[None])[0]) @ np.array([0.0, 1.0])
    north *= 26 * unit / max(float(np.hypot(*north)), 1e-12)
    arrow = {"arrowstyle": "-|>", "color": "white", "linewidth": 2.5, "path_effects": _OUTLINE}
    axes.annotate("", xy=at + north, xytext=at - north, arrowprops=arrow, zorder=6)
    label = at + 1.5 * north
    axes.text(label[0], label[1], "N", ha="center", va="center", fontweight="bold", **text)


def _draw_colour_bar(
    figure: Figure, fastest_kmh: float, box: tuple[float, float, float, float], total_width_px: int
) -> None:
    left = box[0] + box[2] + 22 / total_width_px
    axes = figure.add_axes((left, box[1] + 0.1 * box[3], 22 / total_width_px, 0.8 * box[3]))
    bar = figure.colorbar(ScalarMappable(Normalize(0, fastest_kmh), _SPEED_COLOURS), cax=axes, extend="max")
    bar.set_label("speed, km/h", fontsize=_font(11, total_width_px))
    bar.ax.tick_params(labelsize=_font(10, total_width_px))


def _draw_title(
    figure: Figure, title: str, trajectories: pd.DataFrame, shown: pd.DataFrame, total: tuple[int, int]
) -> None:
    text = f"{trajectories['vehicle_id'].nunique()} trajectories"
    if len(shown):
        start, end = shown["t_utc"].min(), shown["t_utc"].max()
        later = end.strftime("%H:%M:%S" if start.date() == end.date() else "%Y-%m-%d %H:%M:%S")
        text += f", {start.strftime('%Y-%m-%d %H:%M:%S')} to {later} UTC; dots mark their ends"
    left, top = _MARGIN_PX / total[0], 1 - 8 / total[1]
    figure.text(left, top, title, fontsize=_font(14, total[0]), fontweight="bold", va="top", parse_math=False)
    figure.text(
        left, top - _font(24, total[0]) / total[1], text, fontsize=_font(10.5, total[0]), va="top", color="#444444"
    )
