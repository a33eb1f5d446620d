"""What registration leaves at parked vehicles of a real clip: ``python -m benchmarks.road_residual``.

A parked vehicle of the reference frame is looked for in every other frame by normalised cross-correlation around its
true box; what registration leaves is the distance of the two in the reference. Boxes take no part in registration. A
dense flow sees the vehicles' pixels, though, and a roof 1.5 m above the road leans by a pixel or two of its own: so all
is done a second time with the parked vehicles painted over in the frames that are registered.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.page import SHARED, markdown_table
from vtrack_batch.archive.decode import decode
from vtrack_batch.model import homography
from vtrack_batch.pipeline.laying import Laid, lay_samples
from vtrack_batch.registration.alignment import register
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.reference import prepare_reference

CLIP = SHARED / "kit-ais" / "MunichStreet02"
MAX_PIXELS = 10_000_000
REACH_PX, MARGIN_PX, LEAST_CORRELATION = 5, 3, 0.8
PAINTED_PX = 2
BENDS: tuple[Literal["never", "auto"], ...] = ("never", "auto")
HEADS = ("frames registered", "straightened", "median frame, px", "worst frame, px", "by patches, px", "ms a megapixel")

Pixels = NDArray[np.uint8]
Points = NDArray[np.float64]


@dataclass(frozen=True)
class Pairs:
    """Places (n, 2) of parked vehicles in a frame and in the reference frame."""

    frame_px: Points
    reference_px: Points


def main() -> None:
    """Print a table."""
    frames = [decode(path.read_bytes(), max_pixels=MAX_PIXELS).pixels for path in sorted((CLIP / "frames").iterdir())]
    boxes = parked_boxes(CLIP)
    reference = len(frames) // 2
    pairs = {i: places(frames[i], i, frames[reference], reference, boxes) for i in range(len(frames)) if i != reference}
    painted = [paint_over(frame, boxes[boxes["frame"] == i + 1]) for i, frame in enumerate(frames)]
    rows = []
    for name, shown in (("as they are", frames), ("parked vehicles painted over", painted)):
        for bend in BENDS:
            params = RegistrationParams(bend=bend)
            laid, spent_ms = lay_all(shown, reference, params)
            residual = np.array([np.median(left_px(laid[i], laid[reference], pair)) for i, pair in pairs.items()])
            patches = np.median([one.registration.residual_px for one in laid])
            figures = f"{np.median(residual):.2f}", f"{residual.max():.2f}", f"{patches:.2f}", f"{spent_ms:.1f}"
            rows.append((name, bend, *figures))
    print(markdown_table(HEADS, rows))


def parked_boxes(clip: Path) -> pd.DataFrame:
    """Return the true boxes of vehicles that never move: frame, id, left, top, width, height."""
    boxes = pd.read_csv(clip / "tracks.csv")
    motion = pd.read_csv(clip / "vehicles.csv").set_index("id")["motion"]
    return boxes[boxes["id"].map(motion) == "parked"]


def places(frame: Pixels, number: int, reference: Pixels, there: int, boxes: pd.DataFrame) -> Pairs:
    """Find the vehicles of the reference frame with number *there* in the frame with *number*, to a part of a pixel."""
    here, found = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), []
    picture = cv2.cvtColor(reference, cv2.COLOR_RGB2GRAY)
    joined = boxes[boxes["frame"] == number + 1].merge(boxes[boxes["frame"] == there + 1], on="id", suffixes=("", "_r"))
    sides = joined[["left_r", "top_r", "width_r", "height_r"]].to_numpy(float)
    shift = joined[["left", "top"]].to_numpy() + joined[["width", "height"]].to_numpy() / 2
    shift = shift - sides[:, :2] - sides[:, 2:] / 2
    for (left_px, top_px, width, height), way in zip(sides, shift, strict=True):
        left, top = round(left_px) - MARGIN_PX, round(top_px) - MARGIN_PX
        right, bottom = round(left_px + width) + MARGIN_PX, round(top_px + height) + MARGIN_PX
        across, down = round(way[0]) - REACH_PX, round(way[1]) - REACH_PX
        if min(left, top, left + across, top + down) < 0:
            continue
        window = here[top + down : bottom + down + 2 * REACH_PX, left + across : right + across + 2 * REACH_PX]
        patch = picture[top:bottom, left:right]
        if patch.shape != (bottom - top, right - left) or min(np.subtract(window.shape, patch.shape)) < 2 * REACH_PX:
            continue
        found_at = peak(np.asarray(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED)))
        if found_at is not None:
            middle = np.array([left + right - 1, top + bottom - 1]) / 2
            offset = np.array([across, down]) + found_at
            found.append((middle + offset, middle))
    seen, at = np.array(found).reshape(-1, 2, 2).transpose(1, 0, 2)
    return Pairs(seen, at)


def peak(surface: NDArray[np.float32]) -> Points | None:
    """Return where (x, y) a correlation is largest, by parabolas; None on the rim, or where it is low."""
    row, column = np.unravel_index(surface.argmax(), surface.shape)
    inner = 0 < row < surface.shape[0] - 1 and 0 < column < surface.shape[1] - 1
    if not inner or surface[row, column] < LEAST_CORRELATION:
        return None
    x = vertex(*surface[row, column - 1 : column + 2])
    y = vertex(*surface[row - 1 : row + 2, column])
    return np.array([column + x, row + y], float)


def vertex(before: float, middle: float, after: float) -> float:
    """Return where a parabola through three values, one apart, has its peak."""
    return (before - after) / (2 * (before - 2 * middle + after))


def paint_over(frame: Pixels, boxes: pd.DataFrame) -> Pixels:
    """Return *frame* with *boxes* filled in from around."""
    mask = np.zeros(frame.shape[:2], np.uint8)
    for left, top, width, height in boxes[["left", "top", "width", "height"]].to_numpy(float):
        rows = slice(max(0, int(top) - PAINTED_PX), int(top + height) + PAINTED_PX + 1)
        mask[rows, max(0, int(left) - PAINTED_PX) : int(left + width) + PAINTED_PX + 1] = 255
    return np.asarray(cv2.inpaint(frame, mask, 5, cv2.INPAINT_TELEA), np.uint8)


def lay_all(frames: list[Pixels], reference: int, params: RegistrationParams) -> tuple[list[Laid], float]:
    """Lay all frames as a run does; also return the milliseconds a megapixel of the second look."""
    rough = prepare_reference(frames[reference], params=params)
    others = [frame for i, frame in enumerate(frames) if i != reference]
    first = [register(frame, rough, params=params) for frame in others]
    _, references = lay_samples([frames[reference], *others], first, rough, keep=lambda pixels: pixels, params=params)
    start = time.process_time()
    laid = [references.lay(frame, params) for frame in frames]
    seconds = time.process_time() - start
    return laid, 1e9 * seconds / sum(frame.shape[0] * frame.shape[1] for frame in frames)


def left_px(frame: Laid, reference: Laid, pairs: Pairs) -> Points:
    """Return how far (n,) vehicles are from their place after registration."""
    seen, at = (
        points if one.bend is None else one.bend.to_straight(points)
        for one, points in ((frame, pairs.frame_px), (reference, pairs.reference_px))
    )
    pose = frame.registration.frame_to_reference
    return np.asarray(np.linalg.norm(homography.apply(pose, seen) - at, axis=1))


if __name__ == "__main__":
    main()
