"""Archives beside the project, made ready to run with default parameters."""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.page import SHARED

CITY = SHARED / "rendered" / "city"
CITY_GSD_M = 0.33
MUNICH = SHARED / "kit-ais" / "MunichStreet02"
MUNICH_GSD_M = 0.12


def survey_of(archive: Path, gsd_m: float, folder: Path) -> Path:
    """Make *folder* and write there a survey file of *archive*, which names nothing but frames, times and scale."""
    folder.mkdir()
    sections = {
        "archive": {"root": str(archive / "frames"), "index": str(archive / "times.csv")},
        "georeference": {"gsd_m": gsd_m},
    }
    path = folder / "survey.yaml"
    path.write_text(json.dumps(sections))
    return path
