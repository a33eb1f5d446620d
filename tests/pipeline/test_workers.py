"""A frame that kills its worker costs itself and nothing else, on this machine and on a cluster."""

from __future__ import annotations

import importlib.util
import itertools
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import poison
import pytest
import stub
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from little import tree

import vtrack_batch as vt
from vtrack_batch.errors import ConfigError, StorageError
from vtrack_batch.pipeline import run as run_module
from vtrack_batch.pipeline.run import Orders, run_survey

HERE = Path(__file__).parent
FRAMES = 32
POISON = {4: "abort", 12: "hang", 20: "memory", 28: "exit"}
needs_dask = pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="Dask is not installed")


def use(monkeypatch: pytest.MonkeyPatch, work: Any) -> None:
    """Have the detect step do *work*, and the others what ``stub`` does."""
    monkeypatch.setattr(run_module, "_work", lambda step: work if step == "detect" else stub.work(step))


def published(folder: Path) -> dict[str, str]:
    found = tree(folder / "results" / "current")
    return {name: value for name, value in found.items() if not name.startswith("quarantine")}


@pytest.fixture(scope="module")
def golden(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The tables of an undisturbed run in one process."""
    folder = stub.stub_archive(tmp_path_factory.mktemp("golden") / "survey", FRAMES)
    with pytest.MonkeyPatch.context() as patch:
        use(patch, stub.detect)
        run_survey(vt.load_survey(folder / "survey.yaml"))
    return published(folder)


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    return stub.stub_archive(tmp_path / "survey", FRAMES)


def poisoned_by(survey: Path, harms: dict[int, str]) -> Any:
    frames = sorted((survey / "frames").iterdir())
    contents = {frames[number].read_bytes(): harm for number, harm in harms.items()}
    return partial(poison.poisoned, contents, stub.detect)


def without(survey: Path, numbers: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """The tables of an archive that never had these frames."""
    folder = stub.stub_archive(tmp_path / "without", FRAMES)
    for number in numbers:
        (folder / "frames" / sorted((survey / "frames").iterdir())[number].name).unlink()
    use(monkeypatch, stub.detect)
    run_survey(vt.load_survey(folder / "survey.yaml"))
    return published(folder)


def quarantine(survey: Path) -> pd.Series:
    return vt.open_results(survey / "results")["quarantine"].set_index("path")["reason"].astype(str)


def test_poisoned_frames_are_set_aside_and_no_other(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Faults 8 to 11: a decoder that aborts, hangs, takes all memory, or just ends."""
    use(monkeypatch, poisoned_by(survey, POISON))
    report = run_survey(vt.load_survey(survey / "survey.yaml"), orders=Orders(workers=2))
    names = [path.name for path in sorted((survey / "frames").iterdir())]
    wanted = {names[4]: "worker_died", names[12]: "timeout", names[20]: "out_of_memory", names[28]: "worker_died"}
    assert quarantine(survey).to_dict() == wanted
    assert (report.frames_used, report.exit_code) == (FRAMES - 4, 3)
    assert published(survey) == without(survey, POISON, tmp_path, monkeypatch)
    use(monkeypatch, stub.detect)
    again = run_survey(vt.load_survey(survey / "survey.yaml"), orders=Orders(workers=1))
    assert not any(again.done.values()), "a culprit is remembered"


def once_dead(flag: Path, piece: Any, context: Any) -> None:
    """Die at the third frame, the first time only, as for want of memory that is there a moment later."""
    if piece.unit.frames and not flag.exists():
        context.take(piece.unit.frames[2])
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    stub.detect(piece, context)


def test_a_death_that_does_not_come_again_is_nobodys_fault(
    survey: Path, golden: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, partial(once_dead, tmp_path / "flag"))
    events: list[str] = []
    report = run_survey(
        vt.load_survey(survey / "survey.yaml"), orders=Orders(workers=2), tell=lambda event, **_: events.append(event)
    )
    assert events.count("died") == 1
    assert report.frames_quarantined == 0
    assert published(survey) == golden


def always_dead(piece: Any, context: Any) -> None:
    """Die before any frame."""
    os._exit(3)


def test_a_worker_that_dies_of_no_frame_ends_the_run_with_advice(survey: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, always_dead)
    with pytest.raises(StorageError, match=r"not of one frame.*code 3.*fewer workers"):
        run_survey(vt.load_survey(survey / "survey.yaml"), orders=Orders(workers=1))


def test_a_stop_in_mid_run_loses_no_finished_piece(survey: Path, golden: dict[str, str]) -> None:
    """Faults 36, 37 and 72: SIGTERM leaves no worker, no note, no half part; the next run goes on from there."""
    command = [sys.executable, str(HERE / "slow_run.py"), str(survey)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "done\n"
        workers = children_of(process.pid)
        process.send_signal(signal.SIGHUP)
        process.send_signal(signal.SIGTERM)
        error = process.communicate()[1]
    assert process.returncode == 143, error
    assert "Traceback" not in error
    assert "what is finished is kept" in error
    end_s = time.monotonic() + 20
    while any(lives(pid) for pid in workers) and time.monotonic() < end_s:
        time.sleep(0.1)
    assert not [pid for pid in workers if lives(pid)]
    done = list((survey / "results" / "data" / "detect").iterdir())
    assert 0 < len(done) < 4
    with pytest.MonkeyPatch.context() as patch:
        use(patch, stub.detect)
        report = run_survey(vt.load_survey(survey / "survey.yaml"))
    assert report.done["detect"] == 4 - len(done)
    assert published(survey) == golden


def lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def children_of(pid: int) -> list[int]:
    found = subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True, check=False).stdout
    return [int(line) for line in found.split()]


# many machines ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """The address of a scheduler with two workers, all in processes of their own; workers that die are replaced."""
    with dask_processes() as (address, _):
        yield address


@contextmanager
def dask_processes() -> Iterator[tuple[str, list[subprocess.Popen[str]]]]:
    """Start a scheduler and two workers under a nanny; gives the address, and the processes, the scheduler first."""
    # a task is given up at its worker's first death, or a culprit takes minutes to find
    environment = {**os.environ, "PYTHONPATH": str(HERE), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    begun: list[subprocess.Popen[str]] = []

    def begin(module: str, *more: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", f"distributed.cli.{module}", "--no-dashboard", *more]
        begun.append(
            subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True)
        )
        return begun[-1]

    try:
        scheduler = begin("dask_scheduler", "--host", "127.0.0.1", "--port", "0")
        address = told(scheduler, r"Scheduler at:\s+(tcp://\S+)")
        for _ in range(2):
            worker = begin("dask_worker", address, "--nthreads", "1", "--nworkers", "1", "--memory-limit", "0")
            told(worker, r"Registered to:\s+(tcp://\S+)")
        yield address, begun
    finally:
        for process in reversed(begun):
            os.killpg(process.pid, signal.SIGKILL)  # and the workers of a nanny
        for process in begun:
            process.wait()
            assert process.stderr is not None
            process.stderr.close()


def told(process: subprocess.Popen[str], pattern: str) -> str:
    """Return what *process* says of itself; what it says afterwards is read and thrown away."""
    assert process.stderr is not None
    for line in process.stderr:
        found = re.search(pattern, line)
        if found:
            threading.Thread(target=process.stderr.read, daemon=True).start()
            return found[1]
    raise AssertionError(f"{process.args} ended")


@needs_dask
def test_a_cluster_gives_the_same_bytes(
    survey: Path, cluster: str, golden: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, stub.detect)
    run_survey(vt.load_survey(survey / "survey.yaml"), orders=Orders(cluster=cluster))
    assert published(survey) == golden


@needs_dask
@pytest.mark.slow
@pytest.mark.parametrize("harm", list(poison.HARM))
def test_a_cluster_sets_poisoned_frames_aside_and_no_other(
    survey: Path, cluster: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, harm: str
) -> None:
    """Faults 9 to 11 on many machines."""
    use(monkeypatch, poisoned_by(survey, {9: harm}))
    report = run_survey(vt.load_survey(survey / "survey.yaml"), orders=Orders(cluster=cluster))
    names = [path.name for path in sorted((survey / "frames").iterdir())]
    assert list(quarantine(survey).index) == [names[9]]
    assert (report.frames_used, report.exit_code) == (FRAMES - 1, 0)  # one of so many is within the tolerance
    assert published(survey) == without(survey, [9], tmp_path, monkeypatch)


def at_leisure(piece: Any, context: Any) -> None:
    """Take so long that others can be killed meanwhile."""
    time.sleep(0.5)
    stub.detect(piece, context)


@needs_dask
@pytest.mark.slow
def test_a_worker_killed_from_outside_costs_nothing(
    survey: Path, golden: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, at_leisure)
    with dask_processes() as (address, (_, nanny, _)):

        def kill_at_first(event: str, **_: Any) -> None:
            victims = children_of(nanny.pid) if event == "done" and not killed else []
            for pid in victims:
                os.kill(pid, signal.SIGKILL)
            killed.extend(victims)

        killed: list[int] = []
        report = run_survey(vt.load_survey(survey / "survey.yaml"), orders=Orders(cluster=address), tell=kill_at_first)
    assert killed
    assert report.frames_quarantined == 0
    assert published(survey) == golden


@needs_dask
@pytest.mark.slow
def test_losing_the_scheduler_loses_nothing_that_was_done(
    survey: Path, golden: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, at_leisure)
    with dask_processes() as (address, (scheduler, *_)):

        def kill_at_first(event: str, **_: Any) -> None:
            if event == "done":
                scheduler.kill()

        with pytest.raises(StorageError, match=r"scheduler .* is gone .* run again"):
            run_survey(vt.load_survey(survey / "survey.yaml"), orders=Orders(cluster=address), tell=kill_at_first)
    done = len(list((survey / "results" / "data" / "detect").iterdir()))
    assert done > 0
    report = run_survey(vt.load_survey(survey / "survey.yaml"))
    assert report.done["detect"] == 4 - done
    assert published(survey) == golden


@pytest.mark.slow
@pytest.mark.parametrize("crew", [1, 2, 4, pytest.param("cluster", marks=needs_dask)])
@settings(max_examples=4, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(order=st.permutations(range(FRAMES)), cuts=st.sets(st.integers(1, FRAMES - 1), max_size=2))
def test_workers_orders_and_splits_leave_no_trace(
    request: pytest.FixtureRequest,
    golden: dict[str, str],
    tmp_path_factory: pytest.TempPathFactory,
    crew: int | str,
    order: list[int],
    cuts: set[int],
) -> None:
    """Faults 26, 27 and 71: any order of arrival, any split into runs, any workers, one tree of tables."""
    folder = stub.stub_archive(tmp_path_factory.mktemp("crew") / "survey", 0)
    orders = Orders(workers=crew) if isinstance(crew, int) else Orders(cluster=request.getfixturevalue("cluster"))
    with pytest.MonkeyPatch.context() as patch:
        use(patch, stub.detect)
        for start, end in itertools.pairwise([0, *sorted(cuts), FRAMES]):
            for number in order[start:end]:
                stub.write_frame(folder, number)
            assert run_survey(vt.load_survey(folder / "survey.yaml"), orders=orders).exit_code == 0
    assert published(folder) == golden


@needs_dask
def test_a_cluster_that_does_not_answer_is_told(survey: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from vtrack_batch.pipeline import cluster

    monkeypatch.setattr(cluster, "CONNECT_S", 1)
    with pytest.raises(ConfigError, match=r"no Dask scheduler answers at tcp://127"):
        run_survey(vt.load_survey(survey / "survey.yaml"), orders=Orders(cluster="tcp://127.0.0.1:1"))


def test_without_dask_it_is_told_how_to_get_it(survey: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # as if it were not installed
    with pytest.raises(ConfigError, match=r"pip install 'vtrack-batch\[cluster\]'"):
        run_survey(vt.load_survey(survey / "survey.yaml"), orders=Orders(cluster="tcp://127.0.0.1:1"))
