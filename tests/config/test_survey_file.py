"""A survey file says everything at once, with line and column, and refuses what it does not know."""

from __future__ import annotations

from pathlib import Path

import pytest
from ruamel.yaml import YAML

from vtrack_batch.config.example import example_yaml, schema_json
from vtrack_batch.config.load import load_survey
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import ConfigError

PROJECT = Path(__file__).resolve().parents[2]


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "survey.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def refusal(tmp_path: Path, text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_survey(written(tmp_path, text))
    return str(caught.value)


def test_the_example_is_complete_and_equals_the_defaults() -> None:
    assert load_survey(PROJECT / "configs" / "example.yaml").model_dump() == Survey().model_dump()
    text = (PROJECT / "configs" / "example.yaml").read_text(encoding="utf-8")
    for section, field in Survey.model_fields.items():
        assert f"\n{section}:" in text
        inner = getattr(field.annotation, "model_fields", {})
        assert all(f"\n  {key}:" in text for key in inner)


@pytest.mark.parametrize("name", ["stratospheric", "helicopter-hdtv", "aircraft", "drone"])
def test_presets_state_only_what_differs(name: str) -> None:
    path = PROJECT / "configs" / f"{name}.yaml"
    survey, default = load_survey(path).model_dump(), Survey().model_dump()
    for section, values in YAML(typ="safe").load(path).items():
        for key in values:
            assert survey[section][key] != default[section][key], f"{section}.{key} states the default"


def test_an_empty_file_is_the_default_survey(tmp_path: Path) -> None:
    assert load_survey(written(tmp_path, "")).model_dump() == Survey().model_dump()


def test_an_unknown_key_is_told_with_line_and_suggestion(tmp_path: Path) -> None:
    text = refusal(tmp_path, "survey:\n  name: x\ngeoreference:\n  gsd: 0.2\n")
    assert 'survey.yaml:4:3: unknown key "gsd" in "georeference"; did you mean "gsd_m"?' in text


def test_an_unknown_section_is_told(tmp_path: Path) -> None:
    assert 'survey.yaml:1:1: unknown key "archiv"; did you mean "archive"?' in refusal(tmp_path, "archiv: {}\n")


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    text = refusal(tmp_path, "execution:\n  workers: 0\n  halo: 3\noutput:\n  quarantine_tolerance: 7\n")
    assert "survey.yaml:2:3: execution.workers:" in text
    assert "survey.yaml:3:3:" in text
    assert "survey.yaml:5:3: output.quarantine_tolerance:" in text
    assert "3 errors" in text


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("survey: {name: a}\nsurvey: {name: b}\n", "duplicate"),
        ("survey: &a {name: a}\narchive: *a\n", "aliases"),
        ("survey: !!python/object:os.system {name: a}\n", "tags"),
        ("survey:\n\tname: a\n", "survey.yaml:2:1"),
        ("- a\n- b\n", "expected keys such as `survey:`, found a list"),
        ("survey: {time_zone: Mars/Base}\n", "IANA"),
        ('survey: {start: "2026-05-17T06:00:00"}\n', "survey.start"),
        ('survey: {start: "2026-05-17T06:00:00Z", end: "2026-05-16T06:00:00Z"}\n', "not before"),
    ],
)
def test_yaml_traps_are_refused_with_a_reason(tmp_path: Path, text: str, told: str) -> None:
    assert told in refusal(tmp_path, text)


def test_plain_words_stay_text(tmp_path: Path) -> None:
    assert load_survey(written(tmp_path, "survey: {name: NO}\n")).survey.name == "NO"
    assert load_survey(written(tmp_path, "survey: {name: 12:30}\n")).survey.name == "12:30"


def test_a_missing_file_says_how_to_get_one(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="vtrack-batch init"):
        load_survey(tmp_path / "none.yaml")


def test_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    survey = load_survey(written(tmp_path, "archive: {root: deep/frames}\n"))
    assert survey.resolve(survey.archive.root) == (tmp_path / "deep/frames").resolve()


def test_the_schema_knows_every_section() -> None:
    text = schema_json()
    assert all(f'"{section}"' in text for section in Survey.model_fields)


def test_the_example_takes_choices(tmp_path: Path) -> None:
    text = example_yaml({"archive": {"root": "here"}, "georeference": {"gsd_m": 0.12}})
    survey = load_survey(written(tmp_path, text))
    assert survey.archive.root == "here"
    assert survey.georeference.gsd_m == 0.12


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("georeference: {gsd_m: 33cm}", "expected a number of metres, without the unit or a list, found '33cm'"),
        ("archive: {max_gap_s: abc}", "expected a number of seconds, without the unit, found 'abc'"),
        ("survey: {start: 2026-05-17T06:00:00}", "expected a time with its offset from UTC"),
        ("survey: {time_zone: Europe/Berln}", 'did you mean "Europe/Berlin"?'),
        ("matching: {method: colours}", "found 'colours'; did you mean \"colour\"?"),
        ("matching: {max_speed_mps: -3}", "expected more than 0.0, found -3"),
        ("execution: {workers: 1.5}", "expected a whole number, found 1.5"),
        ("tracking: []", "expected keys of its own below it: motion, "),
        ("archive: {exif: 7}", "expected true or false, found 7"),
    ],
)
def test_a_wrong_value_is_told_in_words(tmp_path: Path, text: str, told: str) -> None:
    refused = refusal(tmp_path, text + "\n")
    assert told in refused
    assert refused.splitlines()[1].startswith("1 error")
    assert "constrained" not in refused
    assert "pydantic" not in refused
