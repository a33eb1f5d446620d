"""The engine around the steps: what is due, what is published, what is kept, whatever happens to the archive.

Steps are those of ``stub``: they read every frame and write every table, but look for no vehicle.
"""

from __future__ import annotations

import itertools
import json
import os
import resource
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import stub
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from little import tree

import vtrack_batch as vt
from vtrack_batch.errors import CannotCreate, ConfigError, NoArchive, StorageError, VtrackError
from vtrack_batch.pipeline import run as run_module
from vtrack_batch.pipeline.explain import explain
from vtrack_batch.pipeline.glance import glance
from vtrack_batch.pipeline.prepare import prepare
from vtrack_batch.pipeline.run import Orders, RunReport, run_survey
from vtrack_batch.pipeline.upkeep import collect, repair, retry, verify

OLD_S = time.time() - 3600
NEXT_DAY = 24 * 3600


@pytest.fixture(autouse=True)
def stubbed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_module, "_work", stub.work)


@pytest.fixture(scope="module")
def one_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive of 24 frames in three units, and its results; never changed."""
    folder = stub.stub_archive(tmp_path_factory.mktemp("engine") / "survey")
    settled(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_module, "_work", stub.work)
        assert run(folder).published
    return folder


@pytest.fixture
def survey(one_run: Path, tmp_path: Path) -> Path:
    """A copy of it to change."""
    return Path(shutil.copytree(one_run, tmp_path / "survey", symlinks=True))


def settled(folder: Path) -> None:
    """Make all frames an hour old."""
    for path in (folder / "frames").iterdir():
        os.utime(path, (OLD_S, OLD_S))


def run(folder: Path, **orders: Any) -> RunReport:
    return run_survey(vt.load_survey(folder / "survey.yaml"), orders=Orders(**orders))


def load(folder: Path) -> Any:
    return vt.load_survey(folder / "survey.yaml")


def published(folder: Path) -> dict[str, str]:
    return tree(folder / "results" / "current")


def next_day(folder: Path, count: int = 3) -> list[Path]:
    """Add frames of the following day."""
    made = []
    for number in range(count):
        path = stub.write_frame(folder, number)
        made.append(path.rename(path.with_name(path.name.replace("20260517", "20260518"))))
        stub.write_frame(folder, number)
    settled(folder)
    return made


def test_a_run_without_change_looks_into_no_file(survey: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(survey)  # the copy lies elsewhere: looked into once
    monkeypatch.setattr(run_module, "prepare", None)
    report = run(survey)
    assert not report.published
    assert report.summary().startswith("nothing was due; 24 frames used, 0 quarantined\nunchanged:")


@pytest.mark.parametrize(
    "change",
    [
        lambda folder: stub.write_frame(folder, 24),
        lambda folder: (folder / "frames" / "20260517T060000.0.jpg").unlink(),
        lambda folder: os.utime(folder / "frames" / "20260517T060000.0.jpg", (OLD_S + 9, OLD_S + 9)),
        lambda folder: (folder / "survey.yaml").write_text(stub.SURVEY.replace("stub", "other")),
        lambda folder: shutil.rmtree(next((folder / "results" / "data" / "detect").iterdir())),
        lambda folder: (folder / "results" / "current").unlink(),
        lambda folder: (folder / "results" / "state" / "record.json").write_text("{"),
    ],
)
def test_a_glance_sees_every_change(survey: Path, change: Any) -> None:
    run(survey, survey_file=survey / "survey.yaml")
    record = glance(survey / "survey.yaml")
    assert record is not None
    assert record.frames == 24
    change(survey)
    assert glance(survey / "survey.yaml") is None


def test_a_glance_finds_the_output_however_it_is_written(survey: Path) -> None:
    for number, text in enumerate(("output: {root: elsewhere}\n", "output:\n  # where\n  root: 'else where' # so\n")):
        (survey / "survey.yaml").write_text(stub.SURVEY + text)
        run(survey, survey_file=survey / "survey.yaml")
        assert glance(survey / "survey.yaml") is not None, number
    assert glance(survey / "survey.yaml", survey / "results") is None


def test_young_files_are_looked_into_again(survey: Path) -> None:
    stub.write_frame(survey, 24)
    run(survey, survey_file=survey / "survey.yaml")
    assert glance(survey / "survey.yaml") is None, "it might change once more without a trace"
    settled(survey)
    assert not run(survey, survey_file=survey / "survey.yaml").published
    assert glance(survey / "survey.yaml") is not None


def test_a_replaced_frame_of_equal_size_redoes_its_unit(survey: Path) -> None:
    """Fault 29."""
    first, second = (survey / "frames" / f"20260517T0600{s}.0.jpg" for s in ("25", "30"))
    data = second.read_bytes().ljust(first.stat().st_size, b"\0")[: first.stat().st_size]
    first.write_bytes(data)
    assert run(survey).done["detect"] == 1


def test_an_unusable_new_file_is_told_as_what_it_is(survey: Path) -> None:
    (survey / "frames" / "20260517T060000.0.jpg.txt.jpg").write_text("no frame")
    report = run(survey)
    assert report.published
    assert not any(report.done.values())
    assert "nothing to compute, but files set aside or settings changed" in report.summary()


def test_a_date_whose_frames_were_moved_away_stays_published(survey: Path) -> None:
    """Fault 28."""
    first_day = published(survey)
    added = next_day(survey)
    assert run(survey).done["traffic"] == 1
    both = published(survey)
    assert set(first_day) - {"quarantine/quarantine.parquet"} < set(both)
    for path in added:
        path.unlink()
    report = run(survey)
    assert not any(report.done.values())
    assert published(survey) == both
    assert report.frames_used == 27
    assert prepare(load(survey)).up_to_date()
    assert run(survey, prune=True).frames_used == 24
    assert published(survey) == first_day


def test_dates_made_otherwise_are_not_mixed(survey: Path) -> None:
    """Fault 65."""
    added = next_day(survey)
    run(survey)
    both = published(survey)
    for path in added:
        path.unlink()
    (survey / "survey.yaml").write_text(stub.SURVEY + "traffic: {bin_s: 300}\n")
    report = run(survey)
    assert report.done["traffic"] == 1
    assert "run --prune" in report.withheld
    assert published(survey) == both
    assert run(survey, prune=True).published


def test_an_archive_that_is_not_mounted_changes_nothing(survey: Path) -> None:
    """Faults 43 and 44."""
    before = published(survey)
    for path in (survey / "frames").iterdir():
        path.unlink()
    with pytest.raises(NoArchive, match="0 of 24 known frames"):
        run(survey)
    assert published(survey) == before


def test_one_date_alone(survey: Path) -> None:
    next_day(survey)
    stub.write_frame(survey, 24)
    report = run(survey, only="2026-05-18")
    assert (report.done["detect"], report.done["traffic"]) == (1, 1)
    assert report.left == 5
    assert "2026-05-17 first" in report.withheld
    assert run(survey).left == 0
    with pytest.raises(ConfigError, match="there are frames of 2026-05-17, 2026-05-18"):
        run(survey, only="2026-05-19")


def test_complete_dates_are_published_while_others_wait(tmp_path: Path) -> None:
    folder = stub.stub_archive(tmp_path / "survey")
    next_day(folder)
    report = run(folder, only="2026-05-18")
    assert report.published
    assert report.frames_used == 3
    whole = run(folder)
    assert whole.published
    assert whole.frames_used == 27


def test_the_deadline_keeps_what_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = stub.stub_archive(tmp_path / "survey")
    report = run(folder, until=datetime.now() - timedelta(seconds=1))
    assert (report.exit_code, report.published, report.left) == (75, False, 6)
    assert "no date is complete yet" in report.summary()

    def slow(piece: Any, context: Any) -> None:
        stub.detect(piece, context)
        time.sleep(1.0)

    monkeypatch.setattr(run_module, "_work", lambda step: slow if step == "detect" else stub.work(step))
    report = run(folder, until=datetime.now() + timedelta(seconds=0.9))
    assert 0 < report.left < 6
    assert run(folder).exit_code == 0


@settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(order=st.permutations(range(24)), cuts=st.sets(st.integers(1, 23), max_size=3))
def test_order_of_arrival_and_splits_into_runs_leave_no_trace(
    one_run: Path, tmp_path_factory: pytest.TempPathFactory, order: list[int], cuts: set[int]
) -> None:
    """Faults 26, 27, 54 and 71."""
    folder = stub.stub_archive(tmp_path_factory.mktemp("split") / "survey", 0)
    for start, end in zip([0, *sorted(cuts)], [*sorted(cuts), 24], strict=True):
        for number in order[start:end]:
            stub.write_frame(folder, number)
        assert run(folder).exit_code == 0
    assert published(folder) == published(one_run)


def test_remembered_state_can_be_lost(survey: Path) -> None:
    """Fault 52."""
    before = published(survey)
    for damage in (b"", b"rubbish" * 1000):
        (survey / "results" / "state" / "files.sqlite").write_bytes(damage)
        (survey / "results" / "state" / "record.json").write_bytes(damage)
        assert not run(survey).published
    shutil.rmtree(survey / "results" / "state")
    report = run(survey)
    assert not any(report.done.values())
    assert published(survey) == before


def test_a_damaged_result_is_named_repaired_and_made_again(survey: Path) -> None:
    """Fault 53."""
    before = published(survey)
    assert verify(load(survey), data=True, inputs=True) == []
    victim = next(iter((survey / "results" / "current" / "frames").rglob("*.parquet")))
    victim.write_bytes(victim.read_bytes().replace(b"PAR1", b"PAR2"))
    part = next(iter((survey / "results" / "data" / "track").rglob("frames.parquet")))
    part.write_bytes(victim.read_bytes())
    assert [damage.what for damage in verify(load(survey))] == ["has another content than was written"]
    assert len(verify(load(survey), data=True)) == 2
    done = repair(load(survey))
    assert [name.split("/")[0] for name in done.dropped] == ["track"]
    assert done.snapshot_damaged
    report = run(survey)
    assert report.published
    assert report.done["detect"] == 0
    assert published(survey) == before
    assert verify(load(survey), data=True) == []


def test_a_snapshot_that_lost_a_file_is_published_anew(survey: Path) -> None:
    before = published(survey)
    next(iter((survey / "results" / "current" / "speeds").rglob("*.parquet"))).unlink()
    assert repair(load(survey)).snapshot_damaged
    assert run(survey).published
    assert published(survey) == before
    assert not run(survey).published


def test_bit_rot_in_the_archive_is_seen(survey: Path) -> None:
    """Fault 4."""
    run(survey)
    path = survey / "frames" / "20260517T060000.0.jpg"
    status = path.stat()
    data = bytearray(path.read_bytes())
    data[-20] ^= 4
    path.write_bytes(data)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert verify(load(survey)) == []
    assert [damage.place for damage in verify(load(survey), inputs=True)] == [path.name]


def test_gc_of_a_survey_leaves_what_is_published(survey: Path) -> None:
    first = (survey / "results" / "current").resolve()
    (survey / "survey.yaml").write_text(stub.SURVEY + "traffic: {bin_s: 300}\n")
    run(survey)
    for folder in (*survey.glob("results/snapshots/*"), *survey.glob("results/data/*/*")):
        os.utime(folder, (OLD_S - NEXT_DAY, OLD_S - NEXT_DAY))
    shown = collect(load(survey), dry_run=True)
    assert shown.snapshots == (first,)
    assert [path.parent.name for path in shown.parts] == ["picture", "traffic"]
    assert first.exists()
    assert collect(load(survey)) == shown
    assert not first.exists()
    assert verify(load(survey), data=True) == []
    assert not any(run(survey).done.values())


def test_frames_set_aside_for_the_machine_are_tried_again(survey: Path) -> None:
    """Faults 42 and 45."""
    before = published(survey)
    path = survey / "frames" / "20260517T060030.0.jpg"
    broken = survey / "frames" / "20260517T060032.5.jpg"
    data = broken.read_bytes()
    broken.write_bytes(data[:40])
    culprits = {path.name: {"sha256": sha256_of(survey, path.name), "reason": "worker_died", "detail": "once"}}
    (survey / "results" / "state" / "culprits.json").write_text(json.dumps(culprits))
    (survey / "results" / "state" / "record.json").unlink()
    assert run(survey).frames_used == 22
    lost = vt.open_results(survey / "results")["quarantine"].set_index("path")["reason"].astype(str)
    assert lost.to_dict() == {path.name: "worker_died", broken.name: "truncated"}
    assert retry(load(survey)) == [path.name]
    assert run(survey).frames_used == 23
    assert retry(load(survey), [broken.name]) == [broken.name]
    broken.write_bytes(data)
    assert run(survey).frames_used == 24
    assert published(survey) == before
    with pytest.raises(ConfigError, match="not in quarantine: nothing"):
        retry(load(survey), ["nothing"])


def sha256_of(survey: Path, path: str) -> str:
    frames = vt.open_results(survey / "results")["frames"].set_index("path")
    return str(frames.loc[path, "sha256"])


def test_explain_names_frames_and_parameters(survey: Path) -> None:
    assert explain(load(survey)) == []
    stub.write_frame(survey, 24)
    (survey / "frames" / "20260517T060000.0.jpg").unlink()
    (survey / "survey.yaml").write_text(stub.SURVEY + "traffic: {bin_s: 300}\n")
    found = {one.piece: one for one in explain(load(survey)) if one.step in ("detect", "traffic")}
    assert "traffic.bin_s: 900 → 300" in found["2026-05-17"].particulars
    told = [text for one in found.values() for text in one.particulars]
    assert any(text.startswith("new: 20260517T060100.0.jpg") for text in told) or any(
        one.reason == "new" for one in found.values()
    )
    assert explain(load(survey), "20260517T060030.0.jpg")
    with pytest.raises(ConfigError, match="no piece of work"):
        explain(load(survey), "nothing")


@contextmanager
def open_files_to_spare(count: int) -> Iterator[None]:
    """Let this process open so many files more."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    taken = {int(path.name) for path in Path("/proc/self/fd").iterdir()}
    free = (number for number in itertools.count() if number not in taken)
    resource.setrlimit(resource.RLIMIT_NOFILE, (next(itertools.islice(free, count, None)), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_limit_of_open_files_is_named_and_never_blamed_on_a_frame(survey: Path) -> None:
    """Fault 41: from not one more file that can be opened to just enough."""
    run(survey)
    before, told, report = published(survey), [], None
    next_day(survey)
    for spare in range(100):
        try:
            with open_files_to_spare(spare):
                report = run(survey)
            break
        except VtrackError as problem:
            told.append((problem.exit_code, "Too many open files" in str(problem), published(survey) == before))
    assert set(told) <= {(73, True, True), (74, True, True)}
    assert len(told) > 1
    assert report is not None
    assert (report.frames_used, report.frames_quarantined) == (27, 0)


def test_a_name_that_is_too_long_is_named(survey: Path) -> None:
    """Fault 41."""
    text = stub.SURVEY + f"output: {{root: {'o' * 300}}}\n"
    (survey / "survey.yaml").write_text(text)
    with pytest.raises(CannotCreate, match=r"ooo: .* cannot be written .*File name too long"):
        run(survey)


def test_files_grow_with_days_not_with_units(survey: Path) -> None:
    """Fault 41: three units and two tables of theirs are one file each."""
    found = published(survey)
    assert sum(name.startswith("frames/") for name in found) == 1
    assert sum(name.startswith("speeds/") for name in found) == 1
    assert len(list((survey / "results" / "data" / "detect").iterdir())) == 3


@pytest.mark.parametrize("force", [None, "detect"])
def test_frames_that_come_during_the_scan_are_the_next_run_s(
    survey: Path, monkeypatch: pytest.MonkeyPatch, force: Any
) -> None:
    """Fault 54: what the scan saw is what is worked on and remembered; what came a moment later is not forgotten."""
    from vtrack_batch.archive import walk

    run(survey)
    real, come = walk._names, iter((24, 25))

    def busy(directory: str | Path) -> list[str]:
        names = real(directory)
        for number in come:
            stub.write_frame(survey, number)
        settled(survey)
        return names

    with monkeypatch.context() as patch:
        patch.setattr(walk, "_names", busy)
        report = run(survey, force=force)
    assert (report.frames_used, report.done["detect"]) == (24, 3 if force else 0)
    assert run(survey).frames_used == 26


def test_a_dying_disk_stops_the_run(survey: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fault 42."""
    from vtrack_batch.archive import read
    from vtrack_batch.errors import UnusableFrame
    from vtrack_batch.pipeline import index

    before = published(survey)
    (survey / "results" / "state" / "files.sqlite").unlink()
    (survey / "results" / "state" / "record.json").unlink()

    def fail(*_: object) -> bytes:
        raise UnusableFrame("io_error", "Input/output error")

    monkeypatch.setattr(index, "read_bytes", fail)
    assert read.read_bytes is not fail
    with pytest.raises(StorageError, match="20 files in a row cannot be read"):
        run(survey)
    assert published(survey) == before


def test_each_run_leaves_a_log_of_json_lines(survey: Path) -> None:
    for _ in range(3):
        run(survey)
    with pytest.raises(ConfigError):
        run(survey, only="2000-01-01")
    logs = sorted((survey / "results" / "state" / "runs").glob("*.jsonl"))
    lines = [json.loads(line) for log in logs for line in log.read_text().splitlines()]
    assert {line["event"] for line in lines} >= {"started", "step", "done", "ended", "failed"}
    assert all(datetime.fromisoformat(line["time"]).tzinfo for line in lines)
    assert [line["exit_code"] for line in lines if line["event"] == "failed"] == [78]


def test_logs_are_kept_by_number(survey: Path) -> None:
    runs = survey / "results" / "state" / "runs"
    for number in range(80):
        (runs / f"20200101T0000{number:02d}Z-1.jsonl").write_text("")
    run(survey)
    assert len(list(runs.iterdir())) == 50


def test_a_log_that_cannot_be_written_stops_nothing(survey: Path) -> None:
    """Fault 40."""
    runs = survey / "results" / "state" / "runs"
    shutil.rmtree(runs)
    runs.write_text("a file in the way")
    stub.write_frame(survey, 24)
    assert run(survey).published


def test_the_machines_clock_leaves_no_trace(survey: Path, one_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fault 32."""
    shutil.rmtree(survey / "results")
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    monkeypatch.setattr(time, "time", lambda: 0.0)
    run(survey)
    assert published(survey) == published(one_run)


def test_state_of_another_version_is_not_trusted(survey: Path) -> None:
    """Fault 66."""
    run(survey, survey_file=survey / "survey.yaml")
    record = survey / "results" / "state" / "record.json"
    record.write_text(json.dumps({**json.loads(record.read_text()), "version": "99.0"}))
    assert glance(survey / "survey.yaml") is None
    assert not run(survey).published


def test_an_archive_is_never_written_to(survey: Path) -> None:
    """Fault 44."""
    before = {path: path.stat().st_mtime_ns for path in (survey / "frames").rglob("*")} | {
        survey / "frames": (survey / "frames").stat().st_mtime_ns
    }
    shutil.rmtree(survey / "results")
    run(survey)
    assert all(path.stat().st_mtime_ns == mtime for path, mtime in before.items())
    assert len(list((survey / "frames").iterdir())) == len(before) - 1
