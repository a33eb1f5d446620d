"""Cutting a unit into blocks: one where the platform hovers, several where it flies on and the overlap falls."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

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
"""Fewer frames are no block of their own: they show too little of what moves."""


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
    if len(unit.frames) < 2 * _FEWEST_FRAMES or _hovers(unit.frames, reader, params):
        return [unit]
    firsts = [0]
    for first in _departures(unit.frames, reader, params):
        if first - firsts[-1] >= _FEWEST_FRAMES and len(unit.frames) - first >= _FEWEST_FRAMES:
            firsts.append(first)
    return [_part(unit, first, end) for first, end in zip(firsts, [*firsts[1:], len(unit.frames)], strict=True)]


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
    """Tell whether some frames from first to last all show what the middle one shows."""
    middle = reader.pixels(frames[len(frames) // 2])
    if middle is None:
        return False
    reference = prepare_reference(middle, params=params)
    probes = (reader.pixels(frames[round(share * (len(frames) - 1))]) for share in _PROBES)
    return all(pixels is not None and _shows(pixels, reference, params) for pixels in probes)


def _departures(frames: Sequence[FrameRef], reader: Reader, params: RegistrationParams) -> Iterator[int]:
    """Yield the frames that show too little of the first one of their block, though they follow on the one before.

    What fits neither is damaged, covered or lost: it says nothing of where the platform is.
    """
    anchor: Reference | None = None
    before: Pixels | None = None
    for number, ref in enumerate(frames):
        pixels = reader.pixels(ref)
        if pixels is None:
            continue
        if anchor is None or before is None:
            anchor = prepare_reference(pixels, params=params)
        elif not _shows(pixels, anchor, params) and _follows(pixels, before, params):
            yield number
            anchor = prepare_reference(pixels, params=params)
        before = pixels


def _shows(pixels: Pixels, reference: Reference, params: RegistrationParams) -> bool:
    """Tell whether a frame shows enough of the reference to be of its block."""
    pose = register(pixels, reference, params=params)
    shown = overlap_share(pose.frame_to_reference, pixels.shape, reference)
    return pose.accepted and shown >= params.block_overlap_share


def _follows(pixels: Pixels, before: Pixels, params: RegistrationParams) -> bool:
    """Tell whether a frame can be laid on the one before it."""
    return register(pixels, prepare_reference(before, params=params), params=params).accepted
