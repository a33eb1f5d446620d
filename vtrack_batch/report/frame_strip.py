"""A few frames side by side, each vehicle boxed and numbered: the quickest way to see whether tracking holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.model import homography
from vtrack_batch.report.canvas import OKABE_ITO, Pixels, resized, to_png, write_texts

_PANEL_PX = (960, 620)
_GAP_PX, _CAPTION_PX, _TEXT_PX = 8, 28, 15
_CAR_LENGTH_PX = 24
_UNTRACKED = (255, 255, 255)
_SUB_PIXEL_BITS = 4


class Picture(Protocol):
    """A frame (H, W, 3) uint8 RGB that gives rows and columns when sliced: an array, or one that is read only then."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows, columns, 3."""

    def __getitem__(self, part: tuple[slice, slice], /) -> Pixels: ...


@dataclass(frozen=True)
class AnnotatedFrame:
    """A frame and what was found in it.

    ``pixels`` (H, W, 3); ``frame_to_ground`` (3, 3), its pixels to ground metres; ``detections``: col_px,
    row_px, length_m, width_m, heading_deg and vehicle_id (null = belongs to no track).
    """

    pixels: Picture
    frame_to_ground: NDArray[np.float64]
    t_utc: pd.Timestamp
    detections: pd.DataFrame


def frame_strip(frames: Sequence[AnnotatedFrame]) -> bytes:
    """Return the frames as PNG, two abreast, in their order.

    Of frames larger than a panel, the window that holds most detections is shown, the same in every panel. A vehicle
    has one number and one colour in all panels; detections of no track are white. Raises ValueError for no frame.
    """
    if not frames:
        raise ValueError("a strip needs a frame")
    boxes = [box_corners_px(frame.detections, frame.frame_to_ground) for frame in frames]
    window = _window(frames, boxes)
    numbers = _numbers(frames, window)
    panels = [_panel(frame, corners, window, numbers) for frame, corners in zip(frames, boxes, strict=True)]
    return to_png(_side_by_side(panels))


def box_corners_px(detections: pd.DataFrame, frame_to_ground: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners (n, 4, 2) of the oriented boxes in frame pixels, clockwise from the front left."""
    centre = detections[["col_px", "row_px"]].to_numpy(float)
    heading = np.radians(detections["heading_deg"].to_numpy(float))
    along = np.stack([np.sin(heading), np.cos(heading)], -1) * detections[["length_m"]].to_numpy(float) / 2
    across = np.stack([np.cos(heading), -np.sin(heading)], -1) * detections[["width_m"]].to_numpy(float) / 2
    offset_m = np.stack([along - across, along + across, -along + across, -along - across], axis=1)
    to_frame = np.linalg.inv(homography.jacobian(frame_to_ground, centre))
    return np.asarray(centre[:, None, :] + np.einsum("nij,nkj->nki", to_frame, offset_m))


class _Window(NamedTuple):
    """The part of each frame that is shown, and the panel's pixels for one of its pixels."""

    left: int
    top: int
    width: int
    height: int
    scale: float


def _window(frames: Sequence[AnnotatedFrame], boxes: Sequence[NDArray[np.float64]]) -> _Window:
    height, width = (min(frame.pixels.shape[axis] for frame in frames) for axis in (0, 1))
    centres = np.concatenate([corners.mean(axis=1) for corners in boxes] or [np.zeros((0, 2))])
    corners = np.concatenate(list(boxes))
    lengths = np.hypot(*(corners[:, 0] - corners[:, 3]).T) if len(corners) else np.zeros(0)
    typical = float(np.median(lengths)) if len(lengths) else _CAR_LENGTH_PX
    whole = min(_PANEL_PX[0] / width, _PANEL_PX[1] / height)
    scale = float(np.clip(_CAR_LENGTH_PX / max(typical, 1.0), max(whole, 0.25), 4.0))
    shown = min(width, int(_PANEL_PX[0] / scale)), min(height, int(_PANEL_PX[1] / scale))
    left, top = _fullest(centres, (width, height), shown)
    return _Window(left, top, shown[0], shown[1], scale)


def _fullest(centres: NDArray[np.float64], size: tuple[int, int], shown: tuple[int, int]) -> tuple[int, int]:
    """Return the top left of the window of size *shown* holding most of *centres* (of equals, nearest the middle)."""
    step = max(8, min(shown) // 8)
    lefts, tops = (np.unique(np.r_[0 : b - a + 1 : step, b - a]) for a, b in zip(shown, size, strict=True))
    across = (centres[:, 0] >= lefts[:, None]) & (centres[:, 0] < lefts[:, None] + shown[0])
    down = (centres[:, 1] >= tops[:, None]) & (centres[:, 1] < tops[:, None] + shown[1])
    held = across.astype(np.int64) @ down.astype(np.int64).T
    off_middle = np.hypot(
        (lefts + shown[0] / 2 - size[0] / 2)[:, None] / size[0], (tops + shown[1] / 2 - size[1] / 2)[None] / size[1]
    )
    best = np.lexsort((off_middle.ravel(), -held.ravel()))[0]
    col, row = np.unravel_index(best, held.shape)
    return int(lefts[col]), int(tops[row])


def _numbers(frames: Sequence[AnnotatedFrame], window: _Window) -> dict[str, int]:
    """Return a short number for every vehicle in the window, by first appearance, then from left to right."""
    seen = []
    for order, frame in enumerate(frames):
        found = frame.detections.dropna(subset=["vehicle_id"])
        inside = found["col_px"].between(window.left, window.left + window.width) & found["row_px"].between(
            window.top, window.top + window.height
        )
        seen.append(found.loc[inside, ["vehicle_id", "col_px", "row_px"]].assign(order=order))
    table = pd.concat(seen).sort_values(["order", "col_px", "row_px", "vehicle_id"]).drop_duplicates("vehicle_id")
    return {vehicle: number for number, vehicle in enumerate(table["vehicle_id"].astype(str), start=1)}


def _panel(frame: AnnotatedFrame, corners: NDArray[np.float64], window: _Window, numbers: dict[str, int]) -> Pixels:
    part = frame.pixels[window.top : window.top + window.height, window.left : window.left + window.width]
    picture = np.ascontiguousarray(resized(part, window.scale))
    # Pixel (0, 0) is the centre of the top-left pixel, before and after scaling.
    placed = (corners - (window.left, window.top) + 0.5) * window.scale - 0.5
    vehicles = frame.detections["vehicle_id"].astype(object)
    texts = []
    for box, vehicle in zip(placed, vehicles.where(vehicles.notna(), None), strict=True):
        number = numbers.get(str(vehicle)) if vehicle is not None else None
        colour = _UNTRACKED if number is None else OKABE_ITO[number % len(OKABE_ITO)]
        if not np.isfinite(box).all() or (np.abs(box) > 1e5).any():
            continue
        polygon = np.round(box * 2**_SUB_PIXEL_BITS).astype(np.int32).reshape(-1, 1, 2)
        thickness = 1 if number is None else 2
        cv2.polylines(picture, [polygon], True, colour, thickness, cv2.LINE_AA, _SUB_PIXEL_BITS)
        if number is not None:
            texts.append((float(box[:, 0].max()) + 3, float(box[:, 1].min()) - _TEXT_PX, str(number), colour))
    return _captioned(write_texts(picture, texts, _TEXT_PX), frame, window)


def _captioned(picture: Pixels, frame: AnnotatedFrame, window: _Window) -> Pixels:
    caption = f"{frame.t_utc.strftime('%Y-%m-%d %H:%M:%S.%f')[:-4]} UTC   {len(frame.detections)} detections"
    if picture.shape[1] > 500 and (window.height, window.width) != frame.pixels.shape[:2]:
        caption += f" in the frame, of which columns {window.left}-{window.left + window.width - 1}"
        caption += f", rows {window.top}-{window.top + window.height - 1}"
    strip = np.full((_CAPTION_PX, picture.shape[1], 3), 32, np.uint8)
    return np.concatenate([write_texts(strip, [(8, 5, caption, (235, 235, 235))], _TEXT_PX), picture])


def _side_by_side(panels: Sequence[Pixels]) -> Pixels:
    height, width = (max(panel.shape[axis] for panel in panels) for axis in (0, 1))
    # Wide, low panels read better one below the other.
    abreast = 1 if len(panels) == 1 or width > 3 * height else 2
    rows = -(-len(panels) // abreast)
    sheet = np.full((rows * (height + _GAP_PX) - _GAP_PX, abreast * (width + _GAP_PX) - _GAP_PX, 3), 255, np.uint8)
    for place, panel in enumerate(panels):
        row, col = (place // abreast) * (height + _GAP_PX), (place % abreast) * (width + _GAP_PX)
        sheet[row : row + panel.shape[0], col : col + panel.shape[1]] = panel
    return sheet
