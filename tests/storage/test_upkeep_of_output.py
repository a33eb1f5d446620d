"""gc removes what nobody needs and nothing else; verify names each file that is not what was written."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from vtrack_batch.storage.collect import find_rubbish, remove
from vtrack_batch.storage.output import Output
from vtrack_batch.storage.verify import check_parts, check_snapshot, is_confined

DAY_S = 86_400


def publish(output: Output, *keys: str) -> Path:
    """Publish a snapshot of parts with these keys."""
    links, files = {}, {}
    for key in keys:
        if output.part("track", key) is None:
            with output.new_part("track", key, {}) as folder:
                (folder / "t.parquet.txt").write_text(f"rows of {key}")
        part = output.part("track", key)
        assert part is not None
        links[f"od_pairs/{key}"] = part.file("t.parquet.txt")
        files[f"od_pairs/{key}"] = dict(part.files["t.parquet.txt"])
    return output.publish(links, {}, {"files": files, "parts": {"track": {key: key for key in keys}}})


def age(folder: Path, hours: float) -> None:
    then = time.time() - hours * 3600
    os.utime(folder, (then, then))


@pytest.fixture
def output(tmp_path: Path) -> Output:
    made = Output(tmp_path / "out")
    made.create()
    return made


def test_superseded_snapshots_stay_a_day_and_then_go_with_their_parts(output: Output) -> None:
    first, second = publish(output, "a", "b"), publish(output, "b", "c")
    for key in "abc":
        age(output.data / "track" / key, 100)
    age(first, 100)
    age(second, 23)
    assert not find_rubbish(output, {}).snapshots, "it was superseded 23 hours ago"
    age(second, 25)
    rubbish = find_rubbish(output, {})
    assert rubbish.snapshots == (first,)
    assert rubbish.parts == (output.data / "track" / "a",)
    remove(rubbish)
    assert not first.exists()
    assert output.keys("track") == {"b", "c"}
    assert not list(check_snapshot(output.current.resolve()))
    assert sorted(path.name for path in output.snapshots.iterdir()) == ["000002"]
    assert find_rubbish(output, {}) == find_rubbish(output, {}).__class__((), (), 0)


def test_the_published_snapshot_never_goes(output: Output) -> None:
    only = publish(output, "a")
    age(only, 10_000)
    age(output.data / "track" / "a", 10_000)
    assert find_rubbish(output, {}).snapshots == ()
    assert find_rubbish(output, {}).parts == ()


def test_parts_of_the_last_run_and_young_ones_stay(output: Output) -> None:
    publish(output, "a")
    for key, hours in (("live", 100), ("young", 1), ("old", 100)):
        with output.new_part("detect", key, {}):
            pass
        age(output.data / "detect" / key, hours)
    assert find_rubbish(output, {"detect": ["live"]}).parts == (output.data / "detect" / "old",)


def test_a_snapshot_that_never_became_current_goes(output: Output) -> None:
    publish(output, "a")
    orphan = output.snapshots / "000007"
    orphan.mkdir()
    age(orphan, 100)
    assert find_rubbish(output, {}).snapshots == (orphan,)


def test_a_folder_that_is_not_ours_is_left_alone(output: Output) -> None:
    first = publish(output, "a")
    age(first, 100)
    age(publish(output, "b"), 100)
    (output.root / "VTRACK_OUTPUT").unlink()
    assert find_rubbish(output, {}).snapshots == ()


def test_freed_bytes_are_those_that_no_other_name_holds(output: Output) -> None:
    first, second = publish(output, "aaa", "b"), publish(output, "b")
    for folder in (first, second, output.data / "track" / "aaa"):
        age(folder, 100)
    rubbish = find_rubbish(output, {})
    own = len("rows of aaa") + sum((output.data / "track/aaa/part.json").stat().st_size for _ in "1")
    assert rubbish.bytes == own + (first / "manifest.json").stat().st_size


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (lambda path: path.unlink(), "is missing"),
        (lambda path: path.write_text("rows of A"), "another content"),
        (lambda path: path.write_text("longer than it was"), "has 18 bytes, not 9"),
    ],
)
def test_verify_names_the_file_that_differs(output: Output, harm: object, told: str) -> None:
    snapshot = publish(output, "a", "b")
    assert not list(check_snapshot(snapshot))
    harm(snapshot / "od_pairs" / "a")  # type: ignore[operator]
    found = list(check_snapshot(snapshot))
    assert [damage.place for damage in found] == ["000001/od_pairs/a"]
    assert told in found[0].what


def test_verify_looks_into_parts_too(output: Output) -> None:
    publish(output, "a", "b")
    assert not list(check_parts(output))
    (output.data / "track" / "a" / "t.parquet.txt").unlink()
    (output.data / "track" / "b" / "part.json").write_text("{")
    found = {(step, key): damage.what for step, key, damage in check_parts(output)}
    assert set(found) == {("track", "a"), ("track", "b")}
    assert "missing" in found["track", "a"]
    assert "repair" in found["track", "b"]


def test_names_in_manifests_are_not_trusted(output: Output) -> None:
    """Fault 73."""
    snapshot = output.publish({}, {}, {"files": {"../../../etc/passwd": {"bytes": 1, "sha256": ""}}})
    assert [damage.what for damage in check_snapshot(snapshot)] == ["names a file outside the snapshot"]
    assert [is_confined(place) for place in ("a/b", "/a", "a/../b", "", "a\0")] == [True, False, False, False, False]


def test_a_part_is_flushed_before_and_after_it_gets_its_name(output: Output, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fault 38: file, folder, name, folder above, in this order."""
    calls: list[tuple[str, str]] = []
    fsync, rename = os.fsync, os.rename

    def flushed(handle: int) -> None:
        calls.append(("flush", str(Path(f"/proc/self/fd/{handle}").readlink())))
        fsync(handle)

    def named(source: Path, target: Path) -> None:
        calls.append(("name", str(target)))
        rename(source, target)

    (output.data / "track").mkdir()
    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(os, "rename", named)
    with output.new_part("track", "k", {}) as folder:
        (folder / "x").write_text("rows")
    short = [(what, Path(place).name) for what, place in calls]
    assert short[-2:] == [("name", "k"), ("flush", "track")]
    before = short[:-2]
    assert ("flush", "x") in before
    assert ("flush", "part.json") in before
    assert before[-1][1].startswith("track-k"), "the folder itself comes last"


READER = """
import sys
from pathlib import Path
import pandas as pd

current, stop = Path(sys.argv[1]), Path(sys.argv[2])
while not stop.exists():
    snapshot = current.resolve()
    try:
        rows = len(pd.read_parquet(snapshot / "t"))
    except Exception:
        rows = -1
    print(int(snapshot.name), rows, flush=True)
"""


@pytest.fixture
def quick_folder(tmp_path: Path) -> Iterator[Path]:
    """A folder in memory, where flushing costs nothing; on the disk where there is none."""
    memory = Path("/dev/shm")
    folder = memory / f"vtrack-readers-{os.getpid()}" if memory.is_dir() else tmp_path / "quick"
    folder.mkdir()
    yield folder
    shutil.rmtree(folder)


class Reads(list[tuple[int, int]]):
    """What a reader has read: number of the snapshot, and its rows."""

    ended = False

    def until(self, come: Callable[[tuple[int, int]], bool]) -> tuple[int, int]:
        """Wait for a read, from now on, that is what is wanted, and return it."""
        at = len(self)
        while not any(map(come, self[at:])):
            assert not self.ended, "the reader died"
            time.sleep(0.005)
        return next(filter(come, self[at:]))


@contextmanager
def reading(output: Output) -> Iterator[Reads]:
    """Have pandas read the newest table t again and again in a process of its own; gives what it reads."""
    stop, reads = output.root / "stop", Reads()
    command = [sys.executable, "-c", READER, str(output.current), str(stop)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as reader:
        assert reader.stdout is not None
        lines = reader.stdout

        def listen() -> None:
            for number, rows in map(str.split, lines):
                reads.append((int(number), int(rows)))
            reads.ended = True

        listener = threading.Thread(target=listen)
        listener.start()
        try:
            yield reads
        finally:
            stop.touch()
            listener.join()


def links_to_rows(output: Output, number: int) -> dict[str, Path]:
    """Make a part with *number* rows; returns the places of three dates that lead to it."""
    with output.new_part("track", f"k{number}", {}) as folder:
        pq.write_table(pa.table({"a": list(range(number))}), folder / "t.parquet")
    part = output.part("track", f"k{number}")
    assert part is not None
    return {f"t/date=2026-05-1{day}/x.parquet": part.file("t.parquet") for day in range(3)}


def test_readers_see_whole_snapshots_while_500_are_published(quick_folder: Path) -> None:
    """Fault 51: whoever resolves `current` once reads one whole snapshot, also while older ones are collected."""
    output, collected = Output(quick_folder), 0
    output.create()
    output.publish(links_to_rows(output, 1), {}, {"files": {}, "parts": {"track": {"x": "k1"}}})
    with reading(output) as reads:
        reads.until(lambda read: read[0] == 1)
        for number in range(2, 501):
            manifest = {"files": {}, "parts": {"track": {"x": f"k{number}"}}}
            output.publish(links_to_rows(output, number), {}, manifest)
            if number % 100 == 0:
                nobody_reads_any_more, _ = reads.until(lambda _: True)
                for folder in output.snapshots.iterdir():
                    if int(folder.name) < nobody_reads_any_more:
                        age(folder, 100)
                rubbish = find_rubbish(output, {})
                remove(rubbish)  # while the next is read
                collected += len(rubbish.snapshots)
        reads.until(lambda read: read[0] == 500)
    assert [rows for _, rows in reads] == [3 * number for number, _ in reads]
    assert reads == sorted(reads)
    assert len(set(reads)) > 5
    assert collected > 100


def test_a_reader_would_see_a_snapshot_that_was_filled_in_place(quick_folder: Path) -> None:
    """What the test above rests on: the same reader, and `current` that leads to a folder still to be filled."""
    output = Output(quick_folder)
    output.create()
    output.publish(links_to_rows(output, 1), {}, {})
    with reading(output) as reads:
        reads.until(lambda read: read == (1, 3))
        output.lead_to("000002")
        reads.until(lambda read: read == (2, -1))
        for files, (place, source) in enumerate(links_to_rows(output, 2).items(), start=1):
            name = output.snapshots / "000002" / place
            name.parent.mkdir(parents=True)
            name.hardlink_to(source)
            reads.until(lambda read, files=files: read == (2, 2 * files))
