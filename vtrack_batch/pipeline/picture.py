"""Step ``picture``: what a person judges a sequence by, and its ground mosaic."""

from __future__ import annotations

import json
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
from vtrack_batch.report.pictures import AnnotatedFrame, frame_strip, trajectory_map
from vtrack_batch.report.summary import page_picture
from vtrack_batch.storage.geotiff import merge_geotiffs
from vtrack_batch.traffic.zones import parse_zones

STRIP_FRAMES = 4


def draw_sequence(piece: Piece, context: Context) -> None:
    """Draw the trajectories over the reference frame, a strip of annotated frames, and join the ground pictures."""
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
        if len(references):
            first = references.sort_values("reference_frame_id", ignore_index=True).iloc[:1]
            pixels = _pixels(refs[first["reference_frame_id"].iloc[0]], context)
            if pixels is not None:
                title = f"{context.survey.survey.name}: {piece.name}"
                to_ground = matrices_of("g", first)[0]
                picture = trajectory_map(pixels, to_ground, points, trajectories, zones, title=title)
                _keep(folder, "trajectories", picture)
            strip = _strip(part_tables(part), points, refs, context)
            if strip:
                _keep(folder, "frames", frame_strip(strip))
        grounds = [context.part(need).file("ground.tif") for need in tracked.needs]
        merge_geotiffs([path for path in grounds if path.exists()], folder / "ground.tif")
        summary = {"trajectories": len(trajectories), "track_points": len(points)}
        (folder / "about.json").write_text(json.dumps(summary, sort_keys=True) + "\n")


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
        pixels = _pixels(refs[frame["frame_id"]], context)
        if pixels is None:
            continue
        pose = poses.loc[[frame["frame_id"]]]
        found = seen["detections"].loc[seen["detections"]["frame_id"] == frame["frame_id"]]
        found = found.assign(vehicle_id=found["detection_id"].map(vehicle))
        strip.append(
            AnnotatedFrame(pixels, (matrices_of("g", pose) @ matrices_of("h", pose))[0], frame["t_utc"], found)
        )
    return strip


def _pixels(ref: FrameRef, context: Context) -> NDArray[np.uint8] | None:
    """Return the frame's pixels; a frame that vanished since it was processed costs its picture only."""
    try:
        return decode(read_bytes(context.archive, ref.path), max_pixels=context.survey.archive.max_pixels).pixels
    except UnusableFrame:
        return None
