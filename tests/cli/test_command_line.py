"""The command line starts fast, helps with examples, and never shows a traceback."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from PIL import Image

from vtrack_batch.cli import COMMANDS, group, options
from vtrack_batch.model.tables import TABLES

HEAVY = ("numpy", "pandas", "cv2", "pyarrow", "pydantic", "scipy", "numba", "matplotlib", "rasterio", "ruamel")


def vtrack(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "vtrack_batch", *arguments], capture_output=True, text=True, cwd=cwd, check=False
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_that_begins_with_an_example(name: str) -> None:
    result = CliRunner().invoke(group, [name, "-h"])
    assert result.exit_code == 0
    lines = [line.strip() for line in result.output.splitlines() if line.strip()]
    assert lines[1].startswith("Example")
    assert lines[2].startswith(f"vtrack-batch {name}")


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; from vtrack_batch.cli import group\n"
        "try: group(['--help'])\nexcept SystemExit: pass\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.splitlines()[-1] == "[]"


def test_every_table_has_its_columns_shown() -> None:
    for name, table in TABLES.items():
        output = CliRunner().invoke(group, ["schema", name]).output
        assert all(column in output for column in table.column_names)


def test_a_misspelt_command_is_suggested() -> None:
    result = vtrack("rnu")
    assert result.returncode == 2
    assert "run" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("run", "missing.yaml"), 78),
        (("check", "missing.yaml"), 78),
        (("schema", "no_such_table"), 78),
        (("evaluate", "nowhere", "nothing"), 78),
        (("run", "empty.yaml"), 66),
        (("run", "unmounted.yaml"), 66),
        (("run", "wrong.yaml"), 78),
        (("init", "site", "--from", "nowhere"), 66),
        (("match", "a.parquet", "b.parquet", "--out", "o"), 78),
    ],
)
def test_mistakes_have_their_exit_code_and_no_traceback(tmp_path: Path, arguments: tuple[str, ...], code: int) -> None:
    (tmp_path / "frames").mkdir()
    (tmp_path / "empty.yaml").write_text("archive: {root: frames}\n")
    (tmp_path / "unmounted.yaml").write_text("archive: {root: elsewhere}\n")
    (tmp_path / "wrong.yaml").write_text("archiv: {}\n")
    result = vtrack(*arguments, cwd=tmp_path)
    assert result.returncode == code, result.stderr
    assert result.stderr.strip()
    assert "Traceback" not in result.stderr
    assert result.stdout == ""


def test_init_writes_a_survey_that_check_accepts_once_there_are_frames(tmp_path: Path) -> None:
    assert vtrack("init", "site", cwd=tmp_path).returncode == 0
    assert {path.name for path in (tmp_path / "site").iterdir()} == {
        "survey.yaml",
        "survey.schema.json",
        "zones-template.geojson",
    }
    again = vtrack("init", "site", cwd=tmp_path)
    assert again.returncode == 78
    assert "exists already" in again.stderr
    assert vtrack("check", "site/survey.yaml", cwd=tmp_path).returncode == 66


def test_check_tells_by_its_code_that_the_ground_cannot_be_found(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    Image.fromarray(np.zeros((40, 60, 3), np.uint8)).save(tmp_path / "frames" / "20260517T060000Z.png")
    (tmp_path / "survey.yaml").write_text("georeference: {source: world_file}\n")
    told = vtrack("check", "survey.yaml", "--json", cwd=tmp_path)
    assert told.returncode == 78
    assert "world_file" in json.loads(told.stdout)["problems"][0]


def test_check_tells_of_frames_taken_at_one_time(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    for name in ("a_20260517T060000Z.png", "b_20260517T060000Z.png", "a_20260517T060001Z.png"):
        Image.fromarray(np.zeros((40, 60, 3), np.uint8)).save(tmp_path / "frames" / name)
    (tmp_path / "survey.yaml").write_text("georeference: {gsd_m: 0.3}\n")
    told = vtrack("check", "survey.yaml", "--json", cwd=tmp_path)
    assert told.returncode == 0
    assert [text for text in json.loads(told.stdout)["problems"] if text.startswith("2 files share their time")]


def test_answers_in_json_are_json(capsys: pytest.CaptureFixture[str]) -> None:
    when = pd.Timestamp("2026-05-17T06:00:00Z")
    given = {
        "n": np.int32(7),
        "x": np.float64("nan"),
        "t": when,
        "none": [pd.NaT, pd.NA, float("inf")],
        "of": Path("a"),
    }
    options.answer(given, "", as_json=True)
    found = json.loads(capsys.readouterr().out, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert found == {"n": 7, "x": None, "t": "2026-05-17T06:00:00+00:00", "none": [None, None, None], "of": "a"}


def test_a_stop_by_the_system_unwinds() -> None:
    code = (
        "import sys, time\n"
        "from vtrack_batch import cli\n"
        "def wait(arguments):\n"
        "    try:\n"
        "        print('ready', flush=True); time.sleep(60)\n"
        "    finally:\n"
        "        print('tidied', flush=True)\n"
        "cli._outcome = wait\n"
        "cli.main()\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGTERM)
        assert process.stdout.read() == "tidied\n"
    assert process.returncode == 143


def test_init_finds_the_index_beside_the_frames(tmp_path: Path) -> None:
    (tmp_path / "flight" / "frames").mkdir(parents=True)
    for name in ("001.png", "002.png"):
        (tmp_path / "flight" / "frames" / name).write_bytes(b"frame")
    (tmp_path / "flight" / "notes.csv").write_text("what,else\n1,2\n")
    lines = "file,time\n001.png,2026-05-17T06:00:00Z\n002.png,2026-05-17T06:00:01Z\n"
    (tmp_path / "flight" / "times.csv").write_text(lines)
    made = vtrack("init", "new/site", "--from", "flight/frames", cwd=tmp_path)
    assert "guessed: 2 frames" in made.stderr
    assert 'index: "../../flight/times.csv"' in (tmp_path / "new" / "site" / "survey.yaml").read_text()
