"""The command line starts fast, helps with examples, and never shows a traceback."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from vtrack_batch.cli import COMMANDS, group
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
