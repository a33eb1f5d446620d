"""Small frames are decoded once however often they are looked at; large ones are let go each time."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from vtrack_batch.archive.read import content_hash
from vtrack_batch.pipeline import reading
from vtrack_batch.pipeline.plan import FrameRef, Unit
from vtrack_batch.pipeline.reading import FrameLog, Reader


@pytest.mark.parametrize(("size", "turns"), [((60, 80), 1), ((2000, 2000), 2)])
def test_a_small_frame_is_read_once_and_a_large_one_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: tuple[int, int], turns: int
) -> None:
    picture = np.random.default_rng(1).integers(0, 256, (*size, 3)).astype(np.uint8)
    assert cv2.imwrite(str(tmp_path / "a.png"), picture)
    ref = FrameRef("a.png", np.datetime64(0, "s"), content_hash((tmp_path / "a.png").read_bytes()))
    taken: list[FrameRef] = []
    log = FrameLog(Unit("main", "2026-05-17", 0.0, (ref,), (), (ref,)))
    reader = Reader(tmp_path, 10_000_000, log, taken.append)
    reads = 0

    def counted(root: Path, path: str) -> bytes:
        nonlocal reads
        reads += 1
        return (root / path).read_bytes()

    monkeypatch.setattr(reading, "read_bytes", counted)
    looks = [reader.pixels(ref) for _ in range(2)]
    assert all(look is not None and (look == picture[:, :, ::-1]).all() for look in looks)
    assert reads == turns
    assert len(taken) == 2, "what a worker dies of is found by what it looked at last"
    assert reader.pixels(ref, (size[1] + 1, size[0])) is None
    assert log.refused[ref.frame_id].reason == "geometry_changed"
