"""Samples of a background are the same wherever they wait."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vtrack_batch.background.learn import learn_background
from vtrack_batch.background.params import BackgroundParams
from vtrack_batch.background.stacks import Sample
from vtrack_batch.pipeline import samples
from vtrack_batch.pipeline.samples import sample_store


def frames(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    ground = rng.integers(60, 200, (331, 210, 3), dtype=np.uint8)
    seen = []
    for i in range(count):
        frame = ground.copy()
        frame[40 : 60 + i, 20 * i : 20 * i + 15] = 250
        seen.append(frame)
    return seen


@pytest.mark.parametrize("rows", [slice(None), slice(None, None, 3), slice(7, 300), slice(330, 331), slice(5, 5)])
def test_rows_come_back_from_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: slice) -> None:
    monkeypatch.setattr(samples, "IN_MEMORY_BYTES", 0)
    with sample_store(tmp_path, 1) as keep:
        pairs = [(frame, keep(frame)) for frame in frames(3)]
        for frame, kept in pairs:
            assert not isinstance(kept, np.ndarray)
            assert kept.shape == frame.shape
            np.testing.assert_array_equal(kept[rows], frame[rows])
    assert not list(tmp_path.iterdir())


def test_background_does_not_tell_where_its_samples_waited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pose = np.array([[1.0, 0.01, -3.0], [-0.01, 1.0, 2.5], [0.0, 0.0, 1.0]])
    poses = [np.eye(3), pose, np.linalg.inv(pose), np.eye(3), pose]
    in_memory = learn_background(
        [Sample(frame, h) for frame, h in zip(frames(5), poses, strict=True)], params=BackgroundParams()
    )
    monkeypatch.setattr(samples, "IN_MEMORY_BYTES", 0)
    with sample_store(tmp_path, 1) as keep:
        kept = [Sample(keep(frame), h) for frame, h in zip(frames(5), poses, strict=True)]
        on_disk = learn_background(kept, params=BackgroundParams())
    np.testing.assert_array_equal(on_disk.levels, in_memory.levels)
