"""``check`` says what reads well but can hardly be meant."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from vtrack_batch.config.load import load_survey
from vtrack_batch.model.zones import TEMPLATE_NAME
from vtrack_batch.pipeline.check import Check, check_survey


def gate(zone_id: str, x_m: float, **properties: object) -> dict[str, object]:
    line = {"type": "LineString", "coordinates": [[x_m, -2.0], [x_m, -9.0]]}
    return {"type": "Feature", "properties": {"id": zone_id, "role": "gate", **properties}, "geometry": line}


def checked(folder: Path, *zones: dict[str, object], gsd_m: float = 0.3) -> Check:
    """Check an archive of one frame that shows 60 m x 24 m at 0.3 m a pixel."""
    (folder / "frames").mkdir()
    Image.fromarray(np.zeros((80, 200, 3), np.uint8)).save(folder / "frames" / "20260517T060000Z.png")
    (folder / "survey.yaml").write_text(f"georeference: {{gsd_m: {gsd_m}}}\nzones: z.geojson\n")
    collection = {"type": "FeatureCollection", "vtrack_coordinates": "local_m", "features": zones}
    (folder / "z.geojson").write_text(json.dumps(collection))
    return check_survey(load_survey(folder / "survey.yaml"))


def photographed(folder: Path, taken: list[str], zone: str = "Europe/Berlin") -> list[str]:
    """Return the problems of frames named 06:00:00, 06:00:01 … UTC whose EXIF says *taken*."""
    (folder / "frames").mkdir()
    for second, text in enumerate(taken):
        tags = Image.Exif()
        tags.get_ifd(0x8769)[0x9003] = f"2026:05:17 {text}"
        path = folder / "frames" / f"20260517T06000{second}Z.jpg"
        Image.fromarray(np.zeros((80, 200, 3), np.uint8)).save(path, exif=tags)
    text = f"archive: {{root: frames, time_zone: {zone}}}\ngeoreference: {{gsd_m: 0.3}}\n"
    (folder / "survey.yaml").write_text(text)
    return [problem for problem in check_survey(load_survey(folder / "survey.yaml")).problems if "EXIF" in problem]


@pytest.mark.parametrize(
    ("taken", "told"),
    [
        (["08:00:00", "08:00:01", "08:00:03"], None),  # Berlin in summer, and a second of rounding
        (["07:00:00", "07:00:01", "07:00:02"], "3 of 3 frames .*-3600 s.*time zone or summer time"),
        (["08:00:00", "08:00:01", "08:10:02"], "1 of 3 frames .*clocks is wrong"),
        (["08:01:40", "08:01:41", "08:01:42"], r"3 of 3 frames .*\+100 s.*clocks is wrong"),
    ],
)
def test_clocks_that_disagree_are_told(tmp_path: Path, taken: list[str], told: str | None) -> None:
    """Fault 21."""
    found = photographed(tmp_path, taken)
    assert len(found) == (told is not None)
    assert told is None or re.search(told, found[0])


def test_zones_in_view_are_no_problem(tmp_path: Path) -> None:
    found = checked(tmp_path, gate("west", 1.0), gate("east", 59.0, lanes=2))
    assert found.problems == ()
    assert found.exit_code == 0
    assert found.facts["ground"]["frame_m"] == [60.0, 24.0]
    assert found.facts["ground"]["car_px"] == 15.0


@pytest.mark.parametrize(
    ("zone", "told"),
    [
        (gate("far", 61.0), "zone far: lies at x 61, y -6, outside of the first frame (x 0 to 60, y -24 to 0)"),
        (gate("old", 10.0, name=TEMPLATE_NAME), "zone old: is still that of the template"),
        (
            gate("typo", 10.0, junktion="main"),
            'zone typo: the property "junktion" is not read; did you mean "junction"?',
        ),
    ],
)
def test_doubtful_zones_are_told(tmp_path: Path, zone: dict[str, object], told: str) -> None:
    found = checked(tmp_path, gate("west", 1.0), zone)
    assert len(found.problems) == 1
    assert found.problems[0].startswith(told)


@pytest.mark.parametrize("gsd_m", [0.01, 17.0])
def test_a_pixel_that_cannot_be_meant_is_told(tmp_path: Path, gsd_m: float) -> None:
    found = checked(tmp_path, gsd_m=gsd_m)
    assert [problem for problem in found.problems if "is georeference.gsd_m in metres?" in problem]
