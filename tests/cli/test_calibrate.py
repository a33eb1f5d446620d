"""``calibrate`` end to end, on a street of its own."""

import json
from pathlib import Path

import pytest

from vtrack_batch.cli import _outcome
from vtrack_batch.config.load import load_survey
from vtrack_batch.matching.score import Model
from vtrack_batch.pipeline.calibrate import METHODS

SURVEY = """\
survey: {name: a street, time_zone: Europe/Berlin}
archive: {root: frames, pattern: "{time:%Y%m%dT%H%M%SZ}.jpg"}
georeference: {gsd_m: 0.33}
output: {root: results}
"""


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    (tmp_path / "frames").mkdir()
    (tmp_path / "survey.yaml").write_text(SURVEY)
    (tmp_path / "street.yaml").write_text("scene: street\nwarm_up_s: 60\n")
    return tmp_path / "survey.yaml"


def calibrate(survey: Path, *more: str) -> int:
    return _outcome(["calibrate", str(survey), "--scenario", str(survey.parent / "street.yaml"), "--pairs", "8", *more])


def test_its_lines_are_a_survey_s_own_and_the_demand_follows_the_wish(survey: Path, capsys) -> None:
    model = survey.parent / "site.json"
    assert calibrate(survey, "--interval-s", "1.5", "--vehicles", "16", "--train", str(model), "--json") == 0
    spoken = capsys.readouterr()
    found = json.loads(spoken.out)
    assert found["interval_s"] == 1.5
    assert 10 < found["vehicles_per_frame"] < 24  # 8 at the street's own demand
    rates = {row["method"]: row for row in found["label_rates_percent"]}
    assert set(rates) == {*METHODS, "proposed, calibrated", "default, retrained"}
    assert all(0 <= row["lo"] <= row["rate"] <= row["hi"] <= 100 for row in rates.values())
    assert rates["default"]["rate"] > 90
    assert rates["default"]["rate"] - 5 < rates["default, retrained"]["rate"] <= 100
    assert len(Model.parse(model.read_text(), "site").rounds) == 2
    assert found["matching"]["model"] == (str(model) if found["best_method"] == "default, retrained" else None)
    assert rates["proposed, calibrated"]["rate"] > rates["proposed"]["rate"] - 5
    assert "drive 4 of 4" in spoken.err
    section = json.dumps(found["matching"])
    survey.write_text(SURVEY + f"matching: {section}\n")
    paper = load_survey(survey).matching.paper
    assert {name: getattr(paper, name) for name in found["matching"]["paper"]} == found["matching"]["paper"]


def test_an_empty_archive_tells_no_interval(survey: Path, capsys) -> None:
    assert calibrate(survey) in (66, 78)
    assert capsys.readouterr().err
