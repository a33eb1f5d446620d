"""Frames as columns: a million of them fit where a million objects would not."""

from __future__ import annotations

from array import array

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.archive.stamps import Stamp
from vtrack_batch.archive.walk import File

CHUNK_ROWS = 10_000
_TEXTS = ("path", "stamp", "platform", "sha256")
_NO_OFFSET = -(2**31)


class FrameColumns:
    """Grows by one frame at a time; texts are packed chunk by chunk."""

    def __init__(self) -> None:
        self._numbers = {name: array("q") for name in ("size_bytes", "mtime_ns", "clock_us")}
        self._offset_s = array("l")
        self._texts: dict[str, list[str | None]] = {name: [] for name in _TEXTS}
        self._packed: list[pd.DataFrame] = []

    def __len__(self) -> int:
        return len(self._offset_s)

    def append(self, path: str, file: File, text: str, stamp: Stamp, platform: str, sha256: str | None) -> None:
        """Add one frame: *text* is its time as written, *stamp* as understood."""
        self._numbers["size_bytes"].append(file.size_bytes)
        self._numbers["mtime_ns"].append(file.mtime_ns)
        self._numbers["clock_us"].append(stamp.clock_us)
        self._offset_s.append(_NO_OFFSET if stamp.offset_s is None else stamp.offset_s)
        for name, value in zip(_TEXTS, (path, text, platform, sha256), strict=True):
            self._texts[name].append(value)
        if len(self._texts["path"]) >= CHUNK_ROWS:
            self._pack()

    def clock_us(self) -> NDArray[np.int64]:
        """Return microseconds since 1970 by each frame's own clock."""
        return np.array(self._numbers["clock_us"], np.int64)

    def offset_s(self) -> NDArray[np.float64]:
        """Return each clock's offset from UTC, NaN where the stamp says none."""
        offsets = np.array(self._offset_s, float)
        return np.where(offsets == _NO_OFFSET, np.nan, offsets)

    def first_naive(self) -> str | None:
        """Return the time as written of the first frame whose stamp says no offset, None if all say one."""
        table = self.table()
        naive = np.flatnonzero(np.isnan(self.offset_s()))
        return str(table["stamp"].iloc[naive[0]]) if len(naive) else None

    def table(self) -> pd.DataFrame:
        """Return path, stamp, platform, sha256, size_bytes and mtime_ns of all frames, in the order they came in."""
        self._pack()
        texts = pd.concat(self._packed, ignore_index=True) if len(self._packed) > 1 else self._packed[0]
        self._packed = [texts]
        numbers = {name: np.array(self._numbers[name], np.int64) for name in ("size_bytes", "mtime_ns")}
        return texts.assign(**numbers)

    def _pack(self) -> None:
        if self._texts["path"] or not self._packed:
            chunk = {name: pd.array(values, dtype="str") for name, values in self._texts.items()}
            self._packed.append(pd.DataFrame(chunk))
            for values in self._texts.values():
                values.clear()
