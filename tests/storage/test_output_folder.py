"""A result folder shows whole things or nothing."""

from __future__ import annotations

import json
import os
import sqlite3
from pathlib import Path

import pytest

from vtrack_batch.errors import Busy, CannotCreate, NoArchive
from vtrack_batch.storage.hashes import HashStore
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


def test_nothing_published_is_told(tmp_path: Path) -> None:
    with pytest.raises(NoArchive, match="vtrack-batch run"):
        open_results(tmp_path)


def test_digests_depend_on_content_not_on_order_of_keys() -> None:
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    assert digest([1, 2]) != digest([2, 1])


def test_hashes_are_asked_for_once(tmp_path: Path) -> None:
    store, asked = HashStore(tmp_path / "files.sqlite"), []

    def hash_of(name: str) -> str | None:
        asked.append(name)
        return None if name == "bad" else f"h{len(name)}"

    files = [("a", 1, 10), ("b\udcff", 1, 10), ("bad", 1, 10)]
    assert store.fill(files, hash_of) == {"a": "h1", "b\udcff": "h2"}
    assert asked == ["a", "b\udcff", "bad"]
    asked.clear()
    store.fill([("a", 1, 10), ("b\udcff", 2, 10), ("bad", 1, 10)], hash_of)
    assert asked == ["b\udcff", "bad"]


def test_a_damaged_hash_store_is_made_anew(tmp_path: Path) -> None:
    path = tmp_path / "files.sqlite"
    path.write_bytes(b"not a database" * 100)
    assert HashStore(path).fill([("a", 1, 10)], lambda name: "h") == {"a": "h"}


def test_a_hash_store_in_use_elsewhere_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "files.sqlite"
    store = HashStore(path)
    store.fill([("a", 1, 10)], lambda name: "h")
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda place: connect(place, timeout=0.01))
    holder = connect(path)
    holder.execute("begin exclusive")
    assert store.fill([("a", 1, 10)], lambda name: "again") == {"a": "again"}
    holder.close()
    assert store.fill([("a", 1, 10)], lambda name: "lost") == {"a": "h"}
