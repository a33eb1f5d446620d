"""Cutting a unit into blocks: one where the platform hovers, several where it flies on and the overlap falls."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.errors import UnusableFrame
from vtrack_batch.pipeline.block import Block, find_block
from vtrack_batch.pipeline.parts import Context
from vtrack_batch.pipeline.plan import FrameRef, Unit
from vtrack_batch.pipeline.reading import Reader
from vtrack_batch.registration.alignment import overlap_share, register
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.reference import Reference, prepare_reference

Pixels = NDArray[np.uint8]

_PROBES = (0.0, 0.25, 0.75, 1.0)
_FEWEST_FRAMES = 8
"""Fewer frames show too little of what moves to be a block; the last two blocks share what is left."""


def find_blocks(unit: Unit, reader: Reader, context: Context) -> Iterator[Block]:
    """Yield the blocks of *unit* in order of time, each joined to the ground; frames without a way there are logged."""
    former: Block | None = None
    for part in cut_blocks(unit, reader, context.survey.registration):
        block = find_block(part, reader, context, former)
        if block is not None:
            yield block
            former = block


def cut_blocks(unit: Unit, reader: Reader, params: RegistrationParams) -> list[Unit]:
    """Return *unit* as it is where all of it shows one place, else cut where the overlap has fallen too far."""
    count = len(unit.frames)
    if count < 2 * _FEWEST_FRAMES or _hovers(unit.frames, reader, params):
        return [unit]
    firsts = [0, *_departures(unit.frames, reader, params)]
    if len(firsts) > 1 and count - firsts[-1] < _FEWEST_FRAMES:
        firsts[-1] = (firsts[-2] + count) // 2
    return [_part(unit, first, end) for first, end in zip(firsts, [*firsts[1:], count], strict=True)]


def _part(unit: Unit, first: int, end: int) -> Unit:
    """Return some frames of *unit*; the frames around them, half as many on either side, are their halo.

    These show a part of the same ground at other times, when what stands in the block may not yet have stood there.
    """
    if (first, end) == (0, len(unit.frames)):
        return unit
    reach = (end - first) // 2
    around = *unit.frames[max(first - reach, 0) : first], *unit.frames[end : end + reach]
    return replace(unit, frames=tuple(unit.frames[first:end]), halo=tuple(around))


def _hovers(frames: Sequence[FrameRef], reader: Reader, params: RegistrationParams) -> bool:
    """Tell whether some frames from first to last all show what the middle one shows; unreadable ones say nothing."""
    middle = _reference_of(reader.pixels(frames[len(frames) // 2]), params)
    if middle is None:
        return False
    probes = (reader.pixels(frames[round(share * (len(frames) - 1))]) for share in _PROBES)
    return all(pixels is None or _shows(pixels, middle, params) for pixels in probes)


def _departures(frames: Sequence[FrameRef], reader: Reader, params: RegistrationParams) -> Iterator[int]:
    """Yield the frames that show too little of the first one of their block, though they follow on the one before.

    What fits neither, or has nothing to hold on to, is damaged, covered or lost: it does not tell where the camera is.
    """
    anchor: Reference | None = None
    before: Pixels | None = None
    first = 0
    for number, ref in enumerate(frames):
        pixels = reader.pixels(ref)
        if pixels is None:
            continue
        if anchor is None:
            anchor = _reference_of(pixels, params)
        elif number - first >= _FEWEST_FRAMES and not _shows(pixels, anchor, params):
            own = _reference_of(pixels, params)
            if own is not None and before is not None and register(before, own, params=params).accepted:
                yield number
                anchor, first = own, number
        before = pixels


def _reference_of(pixels: Pixels | None, params: RegistrationParams) -> Reference | None:
    """Return a frame as a reference; None where it is unreadable or has nothing to hold on to."""
    try:
        return None if pixels is None else prepare_reference(pixels, params=params)
    except UnusableFrame:
        return None


def _shows(pixels: Pixels, reference: Reference, params: RegistrationParams) -> bool:
    """Tell whether a frame shows enough of the reference to be of its block."""
    pose = register(pixels, reference, params=params)
    return pose.accepted and (
        overlap_share(pose.frame_to_reference, pixels.shape, reference) >= params.block_overlap_share
    )
