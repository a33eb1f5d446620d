"""Frames that wait, as samples of a background, to be asked for a few rows at a time: in memory, or in a file."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.background.stacks import Rows
from vtrack_batch.errors import StorageError
from vtrack_batch.pipeline.plan import FrameRef

IN_MEMORY_BYTES = 400_000_000
"""What a process keeps of decoded samples in memory; more of them wait in a file without a name."""

_CHUNK_ROWS = 96
_REMEDY = "make room where `output.root` lies, or take a smaller `background.samples`"


Keep = Callable[[NDArray[np.uint8]], Rows]
"""Takes the pixels (H, W, 3) of a frame, gives what stands for them."""


def seconds(ref: FrameRef) -> float:
    """Return when a frame was taken, in seconds."""
    return float((ref.t_utc - np.datetime64(0, "s")) / np.timedelta64(1, "s"))


@contextmanager
def sample_store(folder: Path, expected_bytes: int) -> Iterator[Keep]:
    """Give a way to keep frames of *expected_bytes* in all, until the context is left.

    Keeping raises ``StorageError`` where the disk is full.
    """
    if expected_bytes <= IN_MEMORY_BYTES:
        yield lambda pixels: pixels
        return
    with tempfile.TemporaryFile(dir=folder, buffering=0) as file:
        yield partial(_write, file)


def _write(file: IO[bytes], pixels: NDArray[np.uint8]) -> Rows:
    try:
        start = file.seek(0, os.SEEK_END)
        for top in range(0, len(pixels), _CHUNK_ROWS):
            part = np.ascontiguousarray(pixels[top : top + _CHUNK_ROWS])
            if file.write(part.data) != part.nbytes:
                raise StorageError(f"samples of the background cannot be kept on disk: it is full; {_REMEDY}")
    except OSError as problem:
        raise StorageError(
            f"samples of the background cannot be kept on disk ({problem.strerror}); {_REMEDY}"
        ) from None
    return KeptRows(file, start, pixels.shape)


@dataclass(frozen=True)
class KeptRows:
    """A frame (H, W, 3) uint8 in a file, from byte ``start`` on; slices of it are read."""

    file: IO[bytes]
    start: int
    shape: tuple[int, ...]

    def __getitem__(self, rows: slice, /) -> NDArray[np.uint8]:
        wanted = range(*rows.indices(self.shape[0]))
        if wanted.step < 1:
            raise ValueError("rows are read downwards")
        found = np.empty((len(wanted), *self.shape[1:]), np.uint8)
        done = 0
        for top in range(wanted.start, wanted.stop, _CHUNK_ROWS * wanted.step):
            bottom = min(wanted.stop, top + _CHUNK_ROWS * wanted.step)
            part = self._read(top, bottom)[:: wanted.step]
            found[done : done + len(part)] = part
            done += len(part)
        return found

    def _read(self, top: int, bottom: int) -> NDArray[np.uint8]:
        row = int(np.prod(self.shape[1:]))
        data = os.pread(self.file.fileno(), (bottom - top) * row, self.start + top * row)
        if len(data) != (bottom - top) * row:
            raise StorageError("samples of the background on disk are cut short")
        return np.frombuffer(data, np.uint8).reshape(bottom - top, *self.shape[1:])
