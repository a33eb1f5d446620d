"""A run from cron: silent when all is well, one clear line when not, and codes that tell."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from vtrack_batch.storage.output import Output

SLOW = ("numpy", "pandas", "cv2", "pyarrow", "pydantic", "scipy", "numba", "ruamel", "pyproj", "PIL")
SURVEY = "archive: {root: frames, time_zone: UTC}\ngeoreference: {gsd_m: 0.3}\n"
PAGE = (Path(__file__).parents[2] / "docs" / "how-to" / "schedule.md").read_text(encoding="utf-8")


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


@pytest.mark.parametrize("workers", [1, 2])
def test_a_night_s_work_is_done_in_silence(survey: Path, tmp_path: Path, workers: int) -> None:
    """Fault 59: also where there is something to do, and processes that do it."""
    folder = Path(shutil.copytree(survey, tmp_path / "survey", ignore=shutil.ignore_patterns("results")))
    (folder / "survey.yaml").write_text(SURVEY + "output: {quarantine_tolerance: 1.0}\n")
    done = cron(folder, f"run survey.yaml -q --workers {workers}")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert (folder / "results" / "current" / "manifest.json").is_file()


def test_losses_are_told_in_a_few_plain_lines(survey: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(survey, tmp_path / "survey", ignore=shutil.ignore_patterns("results")))
    (folder / "survey.yaml").write_text(SURVEY)
    done = cron(folder, "run survey.yaml -q")
    assert (done.returncode, done.stdout) == (3, "")
    assert "1 frames used, 1 quarantined" in done.stderr
    assert "\x1b" not in done.stderr
    assert "\r" not in done.stderr


@pytest.mark.parametrize(
    ("change", "code", "told"),
    [
        (lambda frames: shutil.rmtree(frames), 66, "no such folder"),
        (lambda frames: [path.unlink() for path in frames.iterdir()], 66, "no "),
        (lambda frames: [path.write_bytes(b"x" * 99) for path in frames.iterdir()], 65, "none of 2 frames can be used"),
    ],
)
def test_an_archive_that_gives_nothing_has_a_code_of_its_own(
    survey: Path, tmp_path: Path, change: Callable[[Path], object], code: int, told: str
) -> None:
    folder = Path(shutil.copytree(survey, tmp_path / "survey", ignore=shutil.ignore_patterns("results")))
    change(folder / "frames")
    done = cron(folder, "run survey.yaml -q")
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (code, "", 1), done.stderr
    assert told in done.stderr
    assert "\x1b" not in done.stderr


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


def scheduled() -> list[str]:
    """The commands of the schedule page that run by the clock: those of its crontab, and that of its unit."""
    crontab = re.search(r"```crontab\n(.*?)```", PAGE, re.DOTALL)
    assert crontab is not None
    lines = [line.split(maxsplit=5)[5] for line in crontab[1].splitlines()]
    return lines + re.findall(r"^ExecStart=(.*)$", PAGE, re.MULTILINE)


@pytest.mark.parametrize("line", scheduled())
def test_what_the_schedule_page_shows_runs_as_it_stands(survey: Path, tmp_path: Path, line: str) -> None:
    """Fault 59: but for the places, which are each user's own."""
    folder = Path(shutil.copytree(survey, tmp_path / "survey", symlinks=True))
    (folder / "survey.yaml").write_text(SURVEY + "output: {quarantine_tolerance: 1.0}\n")
    (folder / ".venv" / "bin").mkdir(parents=True)
    program = folder / ".venv" / "bin" / "vtrack-batch"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m vtrack_batch "$@"\n')
    program.chmod(0o755)
    here = line.replace("/srv/surveys/ring-road", str(folder)).replace("/var/lib/node_exporter", str(tmp_path))
    assert here != line
    clean = ["env", "-i", "LANG=C", "PATH=/usr/bin:/bin", "sh", "-c", here]
    done = subprocess.run(clean, cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_the_units_of_the_schedule_page_are_such(tmp_path: Path) -> None:
    service, timer = re.findall(r"```ini\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "ring-road.service").write_text(
        re.sub(r"^ExecStart=\S+", "ExecStart=/bin/true", service, flags=re.MULTILINE)
    )
    (tmp_path / "ring-road.timer").write_text(timer)
    command = ["systemd-analyze", "verify", "--man=no", str(tmp_path / "ring-road.timer")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "ring-road" not in done.stderr
    assert done.returncode == 0


def test_the_schedule_page_names_what_is_needed() -> None:
    for needed in ("[Timer]", "SuccessExitStatus=75", "--deadline", "--metrics-file", "gc "):
        assert needed in PAGE
