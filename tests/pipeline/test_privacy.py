"""What cameras write about their owners stays where it was."""

from __future__ import annotations

from pathlib import Path

from little import EVERY_S, SURVEY, little_archive
from PIL import Image

import vtrack_batch as vt
from vtrack_batch.model.tables import TABLES
from vtrack_batch.pipeline.run import run_survey

OWNER, SERIAL, HOME = "Jane Roe 4711", "SN-0815-4711", "home 52N13E"


def sign(path: Path, number: int) -> None:
    """Write owner, serial number, a description and a position into the frame, and its time."""
    seconds = EVERY_S * number
    tags = Image.Exif()
    tags[0x010E], tags[0x013B] = HOME, OWNER
    tags.get_ifd(0x8769).update(
        {
            0x9003: f"2026:05:17 06:00:{int(seconds):02d}",
            0x9291: f"{seconds % 1:.1f}"[2:],
            0xA430: OWNER,
            0xA431: SERIAL,
        }
    )
    tags.get_ifd(0x8825).update({1: "N", 2: (52.0, 13.0, 47.11), 3: "E", 4: (13.0, 8.0, 15.0)})
    with Image.open(path) as image:
        image.load()
    image.save(path, exif=tags, quality=92)


def test_nothing_personal_in_exif_reaches_the_results(tmp_path: Path) -> None:
    """Fault 81: no table, picture, page, log or state holds it."""
    folder = little_archive(tmp_path / "survey", 8)
    for number, path in enumerate(sorted((folder / "frames").iterdir())):
        sign(path, number)
        assert all(word.encode() in path.read_bytes() for word in (OWNER, SERIAL, HOME))
    (folder / "survey.yaml").write_text(SURVEY.replace("time_zone: UTC", "time_zone: UTC, exif: true"))
    assert run_survey(vt.load_survey(folder / "survey.yaml")).frames_used == 8
    results = vt.open_results(folder / "results")
    files = [path for path in (folder / "results").rglob("*") if path.is_file()]
    told = [path.read_bytes() for path in files] + [results[name].to_csv().encode() for name in TABLES]
    assert any(path.suffix == ".png" for path in files)
    for word in (OWNER, SERIAL, HOME):
        assert not [len(text) for text in told if word.encode() in text], word
