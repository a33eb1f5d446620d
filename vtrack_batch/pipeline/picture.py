"""Step ``picture``: what a person judges a sequence by, and its ground mosaic."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.archive.decode import decode
from vtrack_batch.archive.read import read_bytes
from vtrack_batch.errors import UnusableFrame
from vtrack_batch.pipeline.parts import Context, matrices_of, read
from vtrack_batch.pipeline.plan import FrameRef, Piece
from vtrack_batch.pipeline.publish import ON_PAGE
from vtrack_batch.report.canvas import MAX_SIDE_PX
from vtrack_batch.report.pictures import AnnotatedFrame, frame_strip, trajectory_map
from vtrack_batch.report.summary import page_picture
from vtrack_batch.storage.geotiff import merge_geotiffs, read_reduced
from vtrack_batch.traffic.zones import parse_zones

STRIP_FRAMES = 4


def draw_sequence(piece: Piece, context: Context) -> None:
    """Join the ground pictures, draw the trajectories over the ground, and a strip of annotated frames."""
    tracked, measured = piece.needs
    part, whole = context.part(tracked), context.part(measured)
    refs = {ref.frame_id: ref for need in tracked.needs if need.unit for ref in need.unit.frames}
    zones = parse_zones(
        whole.file("zones.geojson").read_text(encoding="utf-8"), crs=part.about["crs"], source="zones.geojson"
    )
    trajectories = read([whole], "trajectories")
    trajectories = trajectories.loc[trajectories["sequence"].astype(str) == piece.name]
    points, references = read([part], "track_points"), read([part], "references")
    with context.new_part(piece, {}) as folder:
        grounds = [context.part(need).file("ground.tif") for need in tracked.needs]
        merge_geotiffs([path for path in grounds if path.exists()], folder / "ground.tif")
        backdrop = _backdrop(references, refs, folder / "ground.tif", context)
        if backdrop is not None:
            title = f"{context.survey.survey.name}: {piece.name}"
            _keep(folder, "trajectories", trajectory_map(*backdrop, points, trajectories, zones, title=title))
        del backdrop
        strip = _strip(part_tables(part), points, refs, context)
        if strip:
            _keep(folder, "frames", frame_strip(strip))
        summary = {"trajectories": len(trajectories), "track_points": len(points)}
        (folder / "about.json").write_text(json.dumps(summary, sort_keys=True) + "\n")


def _backdrop(
    references: pd.DataFrame, refs: dict[str, FrameRef], mosaic: Path, context: Context
) -> tuple[NDArray[np.uint8], NDArray[np.float64]] | None:
    """Return what trajectories are drawn on, and where it lies: the only reference frame, else the ground mosaic."""
    if len(references) != 1:
        return read_reduced(mosaic, MAX_SIDE_PX) if mosaic.exists() else None
    pixels = _pixels(refs[references["reference_frame_id"].iloc[0]], context)
    return None if pixels is None else (pixels, matrices_of("g", references)[0])


def _keep(folder: Path, name: str, picture: bytes) -> None:
    """Write a picture, and how the report shows it: made here, where many sequences are drawn at once."""
    (folder / f"{name}.png").write_bytes(picture)
    (folder / f"{name}{ON_PAGE}").write_bytes(page_picture(picture))


def part_tables(part: object) -> dict[str, pd.DataFrame]:
    """Return the tables of a tracked sequence that pictures need."""
    return {name: read([part], name) for name in ("frames", "registrations", "references", "detections")}  # type: ignore[list-item]


def _strip(
    seen: dict[str, pd.DataFrame], points: pd.DataFrame, refs: dict[str, FrameRef], context: Context
) -> list[AnnotatedFrame]:
    """Return consecutive frames from the middle of the sequence, with their detections and the vehicles of these."""
    used = seen["frames"].loc[seen["frames"]["status"].astype(str) == "used"].sort_values("t_utc", ignore_index=True)
    if used.empty:
        return []
    poses = seen["registrations"].merge(seen["references"], on="reference_frame_id").set_index("frame_id")
    vehicle = points.dropna(subset=["detection_id"]).set_index("detection_id")["vehicle_id"]
    strip = []
    first = max(0, (len(used) - STRIP_FRAMES) // 2)
    for _, frame in used.iloc[first : first + STRIP_FRAMES].iterrows():
        pixels = _Late(refs[frame["frame_id"]], context, (int(frame["height_px"]), int(frame["width_px"]), 3))
        pose = poses.loc[[frame["frame_id"]]]
        found = seen["detections"].loc[seen["detections"]["frame_id"] == frame["frame_id"]]
        found = found.assign(vehicle_id=found["detection_id"].map(vehicle))
        strip.append(
            AnnotatedFrame(pixels, (matrices_of("g", pose) @ matrices_of("h", pose))[0], frame["t_utc"], found)
        )
    return strip


@dataclass(frozen=True)
class _Late:
    """A frame whose pixels are read when a part is asked for: of large ones, one at a time; black where it vanished."""

    ref: FrameRef
    context: Context
    shape: tuple[int, ...]

    def __getitem__(self, part: tuple[slice, slice], /) -> NDArray[np.uint8]:
        pixels = _pixels(self.ref, self.context)
        if pixels is None or pixels.shape != self.shape:
            pixels = np.zeros(self.shape, np.uint8)
        return pixels[part].copy()


def _pixels(ref: FrameRef, context: Context) -> NDArray[np.uint8] | None:
    """Return the frame's pixels; a frame that vanished since it was processed costs its picture only."""
    try:
        return decode(read_bytes(context.archive, ref.path), max_pixels=context.survey.archive.max_pixels).pixels
    except UnusableFrame:
        return None
