"""A run from cron: silent when all is well, one clear line when not, and codes that tell."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from vtrack_batch.storage.output import Output

SLOW = ("numpy", "pandas", "cv2", "pyarrow", "pydantic", "scipy", "numba", "ruamel", "pyproj", "PIL")
SURVEY = "archive: {root: frames, time_zone: UTC}\ngeoreference: {gsd_m: 0.3}\n"


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two plain frames of an hour ago with little to see, and their results."""
    folder = tmp_path_factory.mktemp("cron") / "survey"
    (folder / "frames").mkdir(parents=True)
    noise = Image.effect_noise((160, 120), 60).convert("RGB")
    for second in range(2):
        noise.save(folder / "frames" / f"20260517T06000{second}Z.png")
    (folder / "survey.yaml").write_text(SURVEY)
    assert cron(folder, "run survey.yaml -q").returncode in (0, 3)
    return folder


def cron(folder: Path, command: str, *, python: str = sys.executable) -> subprocess.CompletedProcess[str]:
    """Run as cron does: no terminal, no input, nearly no environment."""
    shell = f"{python} -m vtrack_batch {command}"
    clean = ["env", "-i", "LANG=C", "PATH=/usr/bin:/bin", "sh", "-c", shell]
    return subprocess.run(clean, cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)


def test_nothing_is_said_when_all_is_well(survey: Path) -> None:
    """Fault 59: LANG=C, no HOME, no terminal."""
    (survey / "survey.yaml").write_text(SURVEY + "output: {quarantine_tolerance: 1.0}\n")
    done = cron(survey, "run survey.yaml -q")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    done = cron(survey, "run survey.yaml -q --metrics-file m.prom")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    text = (survey / "m.prom").read_text()
    assert 'vtrack_last_run_exit_code{survey="survey"} 0.000' in text
    assert 'vtrack_pieces_done{survey="survey",step="detect"} 0.000' in text


@pytest.mark.parametrize(
    ("command", "code", "told"),
    [
        ("run missing.yaml -q", 78, "no such file"),
        ("run survey.yaml -q --deadline 25:00", 2, "--deadline"),
        ("run survey.yaml -q --only 2026-01-01", 78, "2026-05-17"),
        ("run survey.yaml -q --out /proc/none", 73, "cannot be written"),
        ("run survey.yaml -q --cluster tcp://nowhere.invalid:1", 78, ""),
    ],
)
def test_what_is_wrong_is_one_plain_line(survey: Path, command: str, code: int, told: str) -> None:
    done = cron(survey, command + (" --force detect" if "cluster" in command else ""))
    assert done.returncode == code, done.stderr
    assert told in done.stderr
    assert done.stdout == ""
    assert "\x1b" not in done.stderr
    assert "Traceback" not in done.stderr


def test_a_second_run_says_who_holds_the_output_since_when(survey: Path) -> None:
    """Fault 49."""
    with Output(survey / "results").locked():
        done = cron(survey, "run survey.yaml -q")
        waited = cron(survey, "run survey.yaml -q --wait 0.2")
    assert (done.returncode, waited.returncode) == (75, 75)
    assert "another run holds it (process " in done.stderr
    assert " since 20" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_status_loads_nothing_slow_when_nothing_changed(survey: Path) -> None:
    cron(survey, "run survey.yaml -q")
    code = (
        "import sys; from vtrack_batch.cli import _outcome\n"
        "code = _outcome(['status', 'survey.yaml'])\n"
        f"print(code, [m for m in {SLOW!r} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=survey, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["snapshot 1; 2 frames, 0 files set aside", "due: nothing", "0 []"] or (
        done.stdout.splitlines()[-1] == "0 []"
    )


def test_a_reader_that_goes_away_is_no_error(survey: Path) -> None:
    """Fault 37: as in `status | head -0`."""
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "vtrack_batch", "status", "survey.yaml"]
    done = subprocess.run(command, cwd=survey, stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writing)
    assert done.stderr == ""


def test_commands_of_upkeep_answer(survey: Path) -> None:
    assert json.loads(cron(survey, "gc survey.yaml --dry-run --json").stdout)["snapshots"] == 0
    assert cron(survey, "verify survey.yaml --data --inputs -q").returncode == 0
    assert json.loads(cron(survey, "explain survey.yaml --json").stdout) == []
    assert cron(survey, "quarantine list survey.yaml").returncode == 0
    facts = json.loads(cron(survey, "doctor survey.yaml --json").stdout)
    assert facts["vtrack-batch"]
    assert facts["links"] in (True, False)
    assert json.loads(cron(survey, "repair survey.yaml --json").stdout) == {"dropped": [], "snapshot_damaged": False}
    assert cron(survey, "gc survey.yaml --keep-hours 3").returncode == 2


def test_the_schedule_page_is_ready_to_copy() -> None:
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "schedule.md").read_text()
    for needed in ("```crontab", "[Service]", "[Timer]", "SuccessExitStatus=75", "--deadline", "--metrics-file", "gc "):
        assert needed in page
