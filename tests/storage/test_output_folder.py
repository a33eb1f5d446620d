"""A result folder shows whole things or nothing."""

from __future__ import annotations

import errno
import json
import os
import socket
import sqlite3
from datetime import datetime
from pathlib import Path

import pytest

from vtrack_batch.errors import Busy, CannotCreate, NoArchive, StorageError
from vtrack_batch.model.known import KnownFile
from vtrack_batch.storage.hashes import FileStore
from vtrack_batch.storage.lock import at_work
from vtrack_batch.storage.output import Output, digest
from vtrack_batch.storage.results import open_results


@pytest.fixture
def output(tmp_path: Path) -> Output:
    made = Output(tmp_path / "out")
    made.create()
    return made


def test_a_part_appears_whole(output: Output) -> None:
    with output.new_part("detect", "k1", {"name": "a"}) as folder:
        (folder / "x.txt").write_text("hello")
        assert output.part("detect", "k1") is None
    part = output.part("detect", "k1")
    assert part is not None
    assert part.file("x.txt").read_text() == "hello"
    assert part.files["x.txt"]["bytes"] == 5


def test_a_part_that_failed_leaves_nothing(output: Output) -> None:
    def fail() -> None:
        with output.new_part("detect", "k1", {}) as folder:
            (folder / "x.txt").write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert output.part("detect", "k1") is None
    assert not list((output.state / "staging").iterdir())


def test_a_dropped_part_is_gone_and_can_be_made_again(output: Output) -> None:
    for text in ("first", "second"):
        output.drop_part("detect", "k1")
        assert output.part("detect", "k1") is None
        with output.new_part("detect", "k1", {}) as folder:
            (folder / "x.txt").write_text(text)
    part = output.part("detect", "k1")
    assert part is not None
    assert part.file("x.txt").read_text() == "second"
    assert not list((output.state / "staging").iterdir())


def test_the_pointer_leads_to_a_whole_snapshot_and_old_ones_stay(output: Output) -> None:
    with output.new_part("track", "k", {}) as folder:
        (folder / "t.parquet.txt").write_text("rows")
    part = output.part("track", "k")
    assert part is not None
    first = output.publish(
        {"od_pairs/date=2026-05-17/a.txt": part.file("t.parquet.txt")}, {"report/x.html": "<p>"}, {"n": 1}
    )
    assert output.current.resolve() == first.resolve()
    second = output.publish({}, {}, {"n": 2})
    assert output.current.resolve() == second.resolve()
    assert (first / "od_pairs/date=2026-05-17/a.txt").read_text() == "rows"
    assert json.loads((second / "manifest.json").read_text())["n"] == 2
    assert [path.name for path in sorted(output.snapshots.iterdir())] == ["000001", "000002"]


def test_a_second_holder_is_refused_with_the_name_of_the_first(output: Output) -> None:
    with output.locked(), pytest.raises(Busy, match=str(os.getpid())), Output(output.root).locked():
        pass
    with output.locked():
        pass


def test_an_output_that_cannot_be_made_is_told_at_once(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(CannotCreate, match="output"):
        Output(tmp_path / "file" / "out").create()


def test_an_output_over_two_file_systems_is_told_at_once(tmp_path: Path) -> None:
    """Fault 47: a rename from one to the other would be no rename."""
    memory = Path("/dev/shm")
    if not memory.is_dir() or memory.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("there is no second file system at hand")
    elsewhere = memory / f"vtrack-elsewhere-{os.getpid()}"
    elsewhere.mkdir()
    try:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "data").symlink_to(elsewhere)
        with pytest.raises(CannotCreate, match="own file system"):
            Output(tmp_path / "out").create()
    finally:
        elsewhere.rmdir()


def test_links_that_others_laid_lead_nowhere(output: Output, tmp_path: Path) -> None:
    """Fault 74: what is swept, dropped and collected is the link, never what it leads to."""
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "letter").write_text("dear")
    output.staging.rmdir()
    output.staging.symlink_to(victim)
    with output.locked():
        assert not output.staging.is_symlink()
        assert output.staging.stat().st_mode & 0o077 == 0, "others lay nothing here"
        (output.staging / "snapshot-000001").symlink_to(victim)
        with pytest.raises(StorageError):
            output.publish({}, {"letter": "mine"}, {})
    (output.data / "track").mkdir()
    (output.data / "track" / "k").symlink_to(victim)
    with output.locked():
        output.drop_part("track", "k")
    assert not list((output.data / "track").iterdir())
    assert [path.read_text() for path in victim.iterdir()] == ["dear"]


def test_a_file_system_without_kernel_locks_is_refused(output: Output, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fault 48: a lock that outlives its holder would stop every later run."""
    import filelock

    monkeypatch.setattr(filelock, "FileLock", filelock.SoftFileLock)
    with pytest.raises(CannotCreate, match="NFS 4"), output.locked():
        pass


def test_nothing_published_is_told(tmp_path: Path) -> None:
    with pytest.raises(NoArchive, match="vtrack-batch run"):
        open_results(tmp_path)


def test_digests_depend_on_content_not_on_order_of_keys() -> None:
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    assert digest([1, 2]) != digest([2, 1])


def test_files_are_remembered_by_path(tmp_path: Path) -> None:
    store = FileStore(tmp_path / "files.sqlite")
    assert store.get("a") is None
    files = {"a": KnownFile(1, 10, "h1", "2026"), "b\udcff": KnownFile(2, 11, "h2", None)}
    store.remember(files.items())
    again = FileStore(tmp_path / "files.sqlite")
    assert {path: again.get(path) for path in files} == files
    assert len(again) == 2
    again.remember([("a", KnownFile(3, 12, "h3"))])
    assert again.get("a") == KnownFile(3, 12, "h3", None)


def test_a_damaged_store_is_made_anew(tmp_path: Path) -> None:
    path = tmp_path / "files.sqlite"
    path.write_bytes(b"not a database" * 100)
    store = FileStore(path)
    assert store.get("a") is None
    store.remember([("a", KnownFile(1, 10, "h"))])
    assert FileStore(path).get("a") == KnownFile(1, 10, "h")


def test_a_store_in_use_elsewhere_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "files.sqlite"
    FileStore(path).remember([("a", KnownFile(1, 10, "h"))])
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda place, timeout: connect(place, timeout=0.01))
    holder = connect(path)
    holder.execute("begin exclusive")
    held = FileStore(path)
    assert held.get("a") is None
    held.remember([("a", KnownFile(1, 10, "lost"))])
    holder.close()
    assert FileStore(path).get("a") == KnownFile(1, 10, "h")


def test_a_store_without_a_place_remembers_nothing(tmp_path: Path) -> None:
    for store in (FileStore(None), FileStore(tmp_path / "nowhere" / "files.sqlite")):
        store.remember([("a", KnownFile(1, 10, "h"))])
        assert store.get("a") is None
        assert len(store) == 0


def test_many_folders_and_odd_manifests_are_published(output: Output) -> None:
    with output.new_part("track", "k", {}) as folder:
        (folder / "t").write_text("rows")
    part = output.part("track", "k")
    assert part is not None
    places = {f"t/date={n}/x": part.file("t") for n in range(100)}
    snapshot = output.publish(places, {}, {"survey": 'ä"\n', "files": {"é": {"bytes": 1}}, "none": None, "empty": {}})
    manifest = json.loads((snapshot / "manifest.json").read_text())
    assert manifest == {"survey": 'ä"\n', "files": {"é": {"bytes": 1}}, "none": None, "empty": {}, "snapshot": 1}
    assert sum(1 for path in snapshot.rglob("x")) == 100
    assert part.file("t").stat().st_nlink == 101


def test_a_file_system_without_links_gets_copies(output: Output, monkeypatch: pytest.MonkeyPatch) -> None:
    with output.new_part("track", "k", {}) as folder:
        (folder / "t").write_text("rows")
    part = output.part("track", "k")
    assert part is not None

    def refuse(*_: object) -> None:
        raise OSError(errno.EPERM, "no links here")

    monkeypatch.setattr(os, "link", refuse)
    snapshot = output.publish({"t/x": part.file("t")}, {}, {})
    assert (snapshot / "t/x").read_text() == "rows"
    assert (snapshot / "t/x").stat().st_nlink == 1


def test_two_workers_may_make_the_same_part(output: Output) -> None:
    with output.new_part("detect", "k", {}) as first, output.new_part("detect", "k", {}) as second:
        (first / "x").write_text("same")
        (second / "x").write_text("same")
    part = output.part("detect", "k")
    assert part is not None
    assert part.file("x").read_text() == "same"
    assert not list(output.staging.iterdir())


def test_what_a_killed_run_left_is_swept_by_the_next(output: Output) -> None:
    (output.staging / "detect-1" / "deep").mkdir(parents=True)
    (output.snapshots / ".removed-1").mkdir()
    (output.root / ".current-1").symlink_to("nowhere")
    with output.locked():
        assert not list(output.staging.iterdir())
    assert not list(output.snapshots.iterdir())
    assert not (output.root / ".current-1").is_symlink()


def test_a_worker_that_outlives_its_run_finishes_nothing(output: Output) -> None:
    def outlive() -> None:
        with output.new_part("detect", "k", {}) as folder:
            (folder / "x").write_text("whole")
            with output.locked():
                pass

    with pytest.raises(StorageError):
        outlive()
    assert output.part("detect", "k") is None


def test_the_holder_of_the_lock_is_known_and_a_dead_one_is_none(output: Output) -> None:
    assert at_work(output.state) is None
    with output.locked():
        found = at_work(output.state)
        assert found is not None
        assert (found.pid, found.host) == (os.getpid(), socket.gethostname())
        assert datetime.fromisoformat(found.since).tzinfo is not None
    assert at_work(output.state) is None
    dead = {"pid": 2**22 + 1, "host": socket.gethostname(), "since": "2026-05-17T06:00:00+00:00"}
    (output.state / "holder.json").write_text(json.dumps(dead))
    assert at_work(output.state) is None
    with output.locked():
        assert at_work(output.state) is not None
