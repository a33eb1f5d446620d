"""gc removes what nobody needs and nothing else; verify names each file that is not what was written."""

from __future__ import annotations

import os
import shutil
import threading
import time
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


def test_readers_see_whole_snapshots_while_500_are_published(tmp_path: Path) -> None:
    """Fault 51: whoever resolves `current` once reads one whole snapshot, also while others go."""
    memory = Path("/dev/shm")
    root = memory / f"vtrack-readers-{os.getpid()}" if memory.is_dir() else tmp_path / "out"
    output, rounds = Output(root), 500
    output.create()
    seen: list[int] = []
    stop = threading.Event()

    def read() -> None:
        while not stop.is_set():
            snapshot = output.current.resolve()
            rows = [pq.read_table(path).num_rows for path in sorted(snapshot.glob("t/*/*.parquet"))]
            seen.append(len(rows) and rows[0] if len(set(rows)) == 1 and len(rows) == 3 else -1)

    try:
        reader = threading.Thread(target=read)
        for number in range(1, rounds + 1):
            with output.new_part("track", f"k{number}", {}) as folder:
                pq.write_table(pa.table({"a": list(range(number))}), folder / "t.parquet")
            part = output.part("track", f"k{number}")
            assert part is not None
            links = {f"t/date={day}/x.parquet": part.file("t.parquet") for day in range(3)}
            output.publish(links, {}, {"files": {}, "parts": {"track": {"x": f"k{number}"}}})
            if number == 1:
                reader.start()
        age(output.snapshots / "000499", 100)
        for folder in output.snapshots.iterdir():
            if folder.name < "000490":
                age(folder, 100)
        remove(find_rubbish(output, {}))
        stop.set()
        reader.join()
    finally:
        stop.set()
        shutil.rmtree(root)
    assert seen, "the reader came to read"
    assert -1 not in seen
    assert seen == sorted(seen)
    assert len(set(seen)) > 5
