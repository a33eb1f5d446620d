"""Reading the frames of a unit: what became of each, and its pixels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.archive.decode import decode
from vtrack_batch.archive.fields import are_interlaced, turns, upper_field
from vtrack_batch.archive.read import content_hash, read_bytes
from vtrack_batch.errors import UnusableFrame
from vtrack_batch.pipeline.plan import FrameRef, Unit
from vtrack_batch.registration.alignment import Registration


@dataclass
class FrameLog:
    """What became of every frame of the unit."""

    unit: Unit
    size: dict[str, tuple[int, int]] = field(default_factory=dict)
    pose: dict[str, Registration] = field(default_factory=dict)
    refused: dict[str, UnusableFrame] = field(default_factory=dict)

    def counts(self) -> dict[str, Any]:
        """Return how many frames of the unit were used, and how many were refused for which reason."""
        refused = [self.refused[ref.frame_id].reason for ref in self.unit.frames if ref.frame_id in self.refused]
        return {"frames_used": len(self.unit.frames) - len(refused), "quarantined": dict(Counter(sorted(refused)))}

    def refuse_all(self, refs: Sequence[FrameRef], problem: UnusableFrame) -> None:
        """Note that none of the frames can be used, for want of a way to the ground."""
        for ref in refs:
            self.refuse(ref, problem)

    def refuse_repeats(self) -> None:
        """Note that a frame with the bytes of the one before it cannot be used: a frozen camera sees no traffic."""
        in_time = sorted((*self.unit.frames, *self.unit.halo), key=lambda ref: (ref.t_utc, ref.path))
        for before, ref in pairwise(in_time):
            if ref.sha256 == before.sha256:
                self.refuse(ref, UnusableFrame("frozen", f"the same bytes as the frame before it, {before.path}"))

    def refuse(self, ref: FrameRef, problem: UnusableFrame) -> None:
        """Note that a frame cannot be used; for frames of the halo this is their own unit's concern to report."""
        self.refused.setdefault(ref.frame_id, problem)


_HELD_FRAMES, _HELD_BYTES = 34, 8_000_000
"""So many frames of at most this size are kept decoded: all samples of a block and its looks, in less than 300 MB."""


@dataclass(frozen=True)
class Reader:
    """Reads and decodes frames; a frame that cannot be used is logged, and None is returned.

    The first frames that are read are read again: as probes, as samples of the background, and then one after the
    other. Small ones are held, for others to look at, not to change.
    """

    root: Path
    max_pixels: int
    log: FrameLog
    take: Callable[[FrameRef], None]
    """Told of each frame before it is read."""
    one_field: bool = False
    """Whether frames are interlaced, so that the rows of their second field are drawn from the first."""
    held: dict[str, NDArray[np.uint8]] = field(default_factory=dict)

    def data(self, ref: FrameRef) -> bytes:
        """Return the bytes of the file."""
        return read_bytes(self.root, ref.path)

    def pixels(self, ref: FrameRef, expected: tuple[int, int] | None = None) -> NDArray[np.uint8] | None:
        """Return the pixels (H, W, 3), or None; *expected* = (width, height) that the frame must have."""
        if ref.frame_id in self.log.refused:
            return None
        self.take(ref)
        try:
            pixels = self.held.get(ref.frame_id)
            if pixels is None:
                pixels = self._decoded(ref)
                if len(self.held) < _HELD_FRAMES and pixels.nbytes <= _HELD_BYTES:
                    self.held[ref.frame_id] = pixels
            size = (pixels.shape[1], pixels.shape[0])
            self.log.size[ref.frame_id] = size
            if expected is not None and size != expected:
                raise UnusableFrame(
                    "geometry_changed",
                    f"{size[0]} x {size[1]} px, the reference frame has {expected[0]} x {expected[1]}",
                )
        except UnusableFrame as problem:
            self.log.refuse(ref, problem)
            return None
        return pixels

    def by_fields(self, interlaced: bool | None) -> Reader:
        """Return the reader for frames that are *interlaced*; None = as the first, middle and last of the unit show."""
        if interlaced is None:
            frames = self.log.unit.frames
            seen = (self.pixels(frames[at]) for at in sorted({0, len(frames) // 2, len(frames) - 1}))
            interlaced = are_interlaced([turns(pixels) for pixels in seen if pixels is not None])
        return replace(self, one_field=True, held={}) if interlaced else self

    def _decoded(self, ref: FrameRef) -> NDArray[np.uint8]:
        data = self.data(ref)
        if content_hash(data) != ref.sha256:
            raise UnusableFrame("changed_while_running", "the file is not the one that was indexed; run again")
        pixels = decode(data, max_pixels=self.max_pixels).pixels
        return upper_field(pixels) if self.one_field else pixels
