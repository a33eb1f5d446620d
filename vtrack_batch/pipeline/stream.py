"""Tables of detections that are longer than memory: surveyed once, then read again in order of time, run by run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.errors import UnusableData
from vtrack_batch.model.views import Views
from vtrack_batch.tracking.sightings import (
    Sightings,
    hull,
    outermost,
    read_detections,
    sightings_of,
    usual_interval_s,
)

Part = Callable[[], pd.DataFrame]
RUN_SIGHTINGS = 50_000  # a run of frames holds about so many
PARTS_HELD = 2  # parts of the table that are kept for the next run


@dataclass
class Course:
    """What a first reading tells of a sequence: its frames, how many sightings each has, its outline, and where it is.

    ``times`` (f,) datetime64[us], increasing, ``counts`` (f,); ``spans`` holds number, first and last time of the parts
    of the table that tell of it.
    """

    name: str
    times: NDArray[np.datetime64] = field(default_factory=lambda: np.zeros(0, "datetime64[us]"))
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    outline: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    spans: list[tuple[int, np.datetime64, np.datetime64]] = field(default_factory=list)

    def add(self, part: int, rows: pd.DataFrame) -> None:
        """Take note of the rows of a part."""
        times = _times(rows)
        self.spans.append((part, times.min(), times.max()))
        seen, count = np.unique(times, return_counts=True)
        self.times, at = np.unique(np.concatenate([self.times, seen]), return_inverse=True)
        self.counts = np.bincount(at, weights=np.concatenate([self.counts, count])).astype(np.int64)
        self.outline = outermost(np.vstack([self.outline, outermost(rows[["x_m", "y_m"]].to_numpy(float))]))

    def runs(self) -> list[NDArray[np.datetime64]]:
        """Return the times of frames, run by run."""
        run = (np.cumsum(self.counts) - self.counts) // RUN_SIGHTINGS
        return np.split(self.times, np.flatnonzero(np.diff(run)) + 1)


def survey(parts: list[Part]) -> list[Course]:
    """Read all *parts* of a table once, check them, and return what sequences they hold, by name: one at least.

    Raises ``UnusableData`` as ``read_detections`` does, ids that repeat from one part to another included.
    """
    found: dict[str, Course] = {}
    marks: list[NDArray[np.uint64]] = []
    for number, part in enumerate(parts):
        rows = read_detections(part())
        marks.append(pd.util.hash_array(rows["detection_id"].to_numpy(), categorize=False))
        for name, of in rows.groupby("sequence", sort=True, observed=True):
            found.setdefault(str(name), Course(str(name))).add(number, of)
    together = np.concatenate(marks) if marks else np.zeros(0, np.uint64)
    together.sort()
    if len(parts) > 1 and (together[1:] == together[:-1]).any():
        _refuse_repeated(parts)
    return [found[name] for name in sorted(found)] or [Course("all")]


def runs_of(course: Course, parts: list[Part], position_sigma_m: float) -> Iterator[Sightings]:
    """Yield the sightings of one sequence in runs of successive frames; what is read is dropped when it has passed."""
    if not len(course.times):
        yield sightings_of(read_detections(parts[0]()), course.name, None, position_sigma_m)
        return
    held: dict[int, pd.DataFrame] = {}
    border, interval_s = hull(course.outline), usual_interval_s(course.times)
    for times in course.runs():
        needed = [number for number, low, high in course.spans if low <= times[-1] and high >= times[0]]
        held = {number: rows for number, rows in held.items() if number in needed}
        found = []
        for number in needed:
            rows = held.get(number)
            if rows is None:
                rows = read_detections(parts[number]())
            if len(held) < PARTS_HELD:
                held[number] = rows
            at = _times(rows)
            found.append(rows[(rows["sequence"] == course.name) & (at >= times[0]) & (at <= times[-1])])
        corners = np.broadcast_to(border, (len(times), *border.shape))
        views = Views(course.name, times, corners, np.zeros(len(times)))
        yield sightings_of(pd.concat(found), course.name, views, position_sigma_m, interval_s=interval_s)


def _times(rows: pd.DataFrame) -> NDArray[np.datetime64]:
    return np.asarray(rows["t_utc"].dt.tz_localize(None).to_numpy("datetime64[us]"))


def _refuse_repeated(parts: list[Part]) -> None:
    """Raise ``UnusableData`` where ids repeat, and not only the marks that stand for them."""
    ids = pd.concat([part()["detection_id"] for part in parts], ignore_index=True)
    repeated = int(ids.duplicated().sum())
    if repeated:
        first = ids[ids.duplicated()].iloc[0]
        raise UnusableData(f"detections: detection_id is repeated in {repeated} rows, first {first!r}")
