"""Steps that decode every frame and write every table, but see no vehicle: quick, for tests of the engine alone."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from vtrack_batch.model.tables import TABLES
from vtrack_batch.pipeline.parts import Context, read, write
from vtrack_batch.pipeline.plan import Piece, Step
from vtrack_batch.pipeline.publish import OF_DATE
from vtrack_batch.pipeline.reading import FrameLog, Reader
from vtrack_batch.pipeline.unit_tables import _frames, _quarantine
from vtrack_batch.pipeline.workers import Work
from vtrack_batch.storage.parquet import empty_frame

SURVEY = """\
survey: {name: stub}
archive: {root: frames, time_zone: UTC, max_gap_s: 60}
georeference: {gsd_m: 0.3}
execution: {unit_s: 20, halo_s: 5, frame_limit_s: 4, memory_mb: 1500}
"""


def detect(piece: Piece, context: Context) -> None:
    assert piece.unit is not None
    log = FrameLog(piece.unit)
    reader = Reader(context.archive, context.survey.archive.max_pixels, log, context.take)
    for ref in piece.unit.frames:
        reader.pixels(ref)
    about: dict[str, object] = {}
    with context.new_part(piece, about) as folder:
        empty = {name: empty_frame(TABLES[name]) for name in ("registrations", "references", "detections")}
        write(folder, {"frames": _frames(log), "quarantine": _quarantine(log), **empty})
        about |= log.counts()


def track(piece: Piece, context: Context) -> None:
    parts = [context.part(need) for need in piece.needs]
    names = ("frames", "registrations", "references", "detections", "quarantine")
    tables = {name: read(parts, name) for name in names}
    used = int((tables["frames"]["status"].astype(str) == "used").sum())
    about = {"crs": None, "frames_used": used, "frames_lost": len(tables["frames"]) - used}
    with context.new_part(piece, about) as folder:
        empty = {name: empty_frame(TABLES[name]) for name in ("matches", "track_points", "trajectories")}
        write(folder, {**tables, **empty})


def traffic(piece: Piece, context: Context) -> None:
    with context.new_part(piece, {"crs": None, "proposed": False}) as folder:
        write(folder, {name: empty_frame(TABLES[name]) for name in OF_DATE})
        (folder / "zones.geojson").write_text('{"type": "FeatureCollection", "features": []}\n')


def picture(piece: Piece, context: Context) -> None:
    with context.new_part(piece, {}) as folder:
        (folder / "about.json").write_text("{}\n")


def work(step: Step) -> Work:
    """In place of ``run._work``."""
    return {"detect": detect, "track": track, "traffic": traffic, "picture": picture}[step]


def stub_archive(folder: Path, frames: int = 24) -> Path:
    """Write *frames* pictures of a few pixels, 2.5 s apart and eight to a unit, and survey.yaml into *folder*."""
    (folder / "frames").mkdir(parents=True)
    for number in range(frames):
        write_frame(folder, number)
    (folder / "survey.yaml").write_text(SURVEY)
    return folder


def write_frame(folder: Path, number: int) -> Path:
    """Write the frame with this number; each has a content of its own."""
    tenths = number * 25
    path = folder / "frames" / f"20260517T06{tenths // 600:02d}{tenths // 10 % 60:02d}.{tenths % 10}.jpg"
    pixels = np.random.default_rng(number).integers(0, 256, (12, 16, 3)).astype(np.uint8)
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "JPEG")
    path.write_bytes(out.getvalue())
    return path
