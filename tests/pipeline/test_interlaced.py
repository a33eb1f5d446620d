"""A run on interlaced frames sees vehicles where the first field has them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from little import EVERY_S, SIZE, little_archive, name_of

import vtrack_batch as vt
from vtrack_batch.archive.decode import decode
from vtrack_batch.pipeline.check import check_survey

TIMES, BETWEEN_FIELDS_PX = 2, 6


@pytest.fixture
def interlaced(tmp_path: Path) -> Path:
    """A little archive, twice as large, with second fields taken when all had gone on by some pixels."""
    little_archive(tmp_path, frames=16)
    survey = tmp_path / "survey.yaml"
    survey.write_text(survey.read_text().replace("gsd_m: 0.3", "gsd_m: 0.15"))
    frames = [tmp_path / "frames" / name_of(number) for number in range(16)]
    for path in frames:
        little = decode(path.read_bytes(), max_pixels=10**6).pixels
        first = cv2.resize(little, None, fx=TIMES, fy=TIMES, interpolation=cv2.INTER_LINEAR)
        later = np.roll(first, BETWEEN_FIELDS_PX, axis=1)
        frame = first.copy()
        frame[1::2] = later[1::2]
        # colours of every pixel: else those of both fields are mixed before they can be told apart
        kept = [cv2.IMWRITE_JPEG_QUALITY, 95, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
        path.write_bytes(cv2.imencode(".jpg", frame[:, :, ::-1], kept)[1].tobytes())
    return tmp_path


def _offsets_px(folder: Path) -> np.ndarray:
    """How far each vehicle found lies right of where the first field has the one of its lane."""
    found = vt.open_results(folder / "results")["detections"]
    seconds = (found["t_utc"] - pd.Timestamp("2026-05-17T06:00Z")).dt.total_seconds()
    number = (seconds / EVERY_S).round().to_numpy()
    offsets = []
    for lane, (row, speed) in enumerate(((73, 14), (103, -11), (133, 9))):
        of_lane = (np.abs(found["row_px"] - TIMES * row) < 8).to_numpy()
        centre = (40 * lane + speed * number[of_lane]) % (SIZE[0] + 40) - 20 + 7
        offsets.append(found["col_px"].to_numpy()[of_lane] - TIMES * centre - (TIMES - 1) / 2)
    return np.concatenate(offsets)


def test_vehicles_are_found_where_the_first_field_has_them(interlaced: Path) -> None:
    vt.run_survey(vt.load_survey(interlaced / "survey.yaml"))
    parts = [json.loads(path.read_bytes()) for path in (interlaced / "results/data/detect").glob("*/part.json")]
    assert [part["interlaced"] for part in parts] == [True, True]
    near = _offsets_px(interlaced)
    near = near[np.abs(near) < 10]
    assert len(near) >= 12
    assert -0.5 < np.median(near) < 1.0, "the middle of both fields lies 3 px on"


def test_check_tells_and_the_survey_file_may_know_better(interlaced: Path) -> None:
    survey = vt.load_survey(interlaced / "survey.yaml")
    assert "interlaced" in check_survey(survey).facts
    woven = survey.model_copy(update={"archive": survey.archive.model_copy(update={"interlaced": False})})
    assert "interlaced" not in check_survey(woven).facts
