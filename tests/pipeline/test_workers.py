"""A frame that kills its worker costs itself and nothing else, on this machine and on a cluster."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import poison
import pytest
import stub
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


@pytest.fixture
def cluster() -> Iterator[Any]:
    """A scheduler and two workers in processes of their own."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, memory_limit=0
    ) as made:
        yield made


@needs_dask
def test_a_cluster_gives_the_same_bytes_and_names_the_culprit(
    survey: Path, cluster: Any, golden: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, stub.detect)
    run_survey(vt.load_survey(survey / "survey.yaml"), orders=Orders(cluster=cluster.scheduler_address))
    assert published(survey) == golden
    other = stub.stub_archive(tmp_path / "other", FRAMES)
    use(monkeypatch, poisoned_by(other, {9: "exit"}))
    run_survey(vt.load_survey(other / "survey.yaml"), orders=Orders(cluster=cluster.scheduler_address))
    names = [path.name for path in sorted((other / "frames").iterdir())]
    assert quarantine(other).to_dict() == {names[9]: "worker_died"}
    assert published(other) == without(other, [9], tmp_path, monkeypatch)


@needs_dask
def test_losing_the_scheduler_loses_nothing_that_was_done(
    survey: Path, cluster: Any, golden: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def close_at_first(event: str, **_: Any) -> None:
        if event == "done":
            cluster.close()

    use(monkeypatch, stub.detect)
    with pytest.raises(StorageError, match="scheduler"):
        run_survey(
            vt.load_survey(survey / "survey.yaml"),
            orders=Orders(cluster=cluster.scheduler_address),
            tell=close_at_first,
        )
    report = run_survey(vt.load_survey(survey / "survey.yaml"))
    assert report.done["detect"] < 4
    assert published(survey) == golden


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
