"""A little archive of its own making for tests of the engine: textured ground, three vehicles, frames of 320 x 200."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import cv2
import numpy as np

SIZE = (320, 200)
EVERY_S = 2.5
SURVEY = """\
survey: {name: little}
archive: {root: frames, time_zone: UTC}
georeference: {gsd_m: 0.3}
zones: zones.geojson
execution: {unit_s: 20, halo_s: 5}
"""


def little_archive(folder: Path, frames: int = 24) -> Path:
    """Write *frames* frames, 2.5 s apart and eight to a unit, zones and survey.yaml into *folder*."""
    (folder / "frames").mkdir(parents=True)
    ground = _ground()
    for number in range(frames):
        write_frame(folder / "frames" / name_of(number), ground, number)
    (folder / "survey.yaml").write_text(SURVEY)
    (folder / "zones.geojson").write_text(json.dumps(_zones()))
    return folder


def name_of(number: int) -> str:
    """The file name of the frame with this number."""
    tenths = int(number * EVERY_S * 10)
    return f"20260517T06{tenths // 600:02d}{tenths // 10 % 60:02d}.{tenths % 10}.jpg"


def write_frame(path: Path, ground: np.ndarray, number: int) -> None:
    picture = ground.copy()
    for lane, (row, speed, colour) in enumerate(
        ((70, 14, (200, 30, 30)), (100, -11, (30, 40, 190)), (130, 9, (240,) * 3))
    ):
        col = (40 * lane + speed * number) % (SIZE[0] + 40) - 20
        cv2.rectangle(picture, (col, row), (col + 14, row + 6), colour, -1)
    path.write_bytes(cv2.imencode(".jpg", picture[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes())


def _ground() -> np.ndarray:
    rng = np.random.default_rng(5)
    coarse = cv2.resize(rng.integers(40, 200, (25, 40, 3)).astype(np.uint8), SIZE, interpolation=cv2.INTER_CUBIC)
    ground = cv2.add(coarse, rng.integers(0, 25, (*SIZE[::-1], 3)).astype(np.uint8))
    ground[60:145] = 105 + rng.integers(0, 10, (85, SIZE[0], 3)).astype(np.uint8)
    for _ in range(60):
        corner = rng.integers(0, (SIZE[0] - 20, SIZE[1] - 20))
        if not 40 < corner[1] < 150:
            cv2.rectangle(
                ground,
                corner.tolist(),
                (corner + rng.integers(5, 20, 2)).tolist(),
                rng.integers(0, 255, 3).tolist(),
                -1,
            )
    return ground


def _zones() -> dict[str, object]:
    def gate(name: str, x_m: float) -> dict[str, object]:
        line = {"type": "LineString", "coordinates": [[x_m, -15.0], [x_m, -45.0]]}
        return {"type": "Feature", "properties": {"id": name, "role": "gate"}, "geometry": line}

    return {"type": "FeatureCollection", "features": [gate("west", 12.0), gate("east", 84.0)]}


def tree(snapshot: Path) -> dict[str, str]:
    """Name → hash of every table file of a snapshot."""
    snapshot = snapshot.resolve()
    return {
        str(path.relative_to(snapshot)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(snapshot.rglob("*.parquet"))
    }
