"""The block of a unit: its reference frame, and where that lies on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import UnusableFrame
from vtrack_batch.georeference.fix import GroundFix, scale_at
from vtrack_batch.model import homography
from vtrack_batch.pipeline.ground import fix_ground
from vtrack_batch.pipeline.parts import Context
from vtrack_batch.pipeline.plan import FrameRef, Unit
from vtrack_batch.pipeline.reading import Reader
from vtrack_batch.registration.alignment import register
from vtrack_batch.registration.reference import prepare_reference


@dataclass
class Block:
    """Frames that share one reference and one background, and where the reference lies on the ground.

    ``unit`` holds these frames and their halo; ``size`` = width and height in px of every frame; ``pixels`` of the
    reference, until they are handed over.
    """

    unit: Unit
    ref: FrameRef
    size: tuple[int, int]
    fix: GroundFix
    metres_per_px: tuple[float, float]
    pixels: NDArray[np.uint8] | None

    def hand_over(self) -> NDArray[np.uint8]:
        """Return the pixels of the reference and forget them: large frames are held no longer than they are used."""
        assert self.pixels is not None, "the pixels were handed over before"
        pixels, self.pixels = self.pixels, None
        return pixels


def find_block(unit: Unit, reader: Reader, context: Context, former: Block | None = None) -> Block | None:
    """Return the block of all frames of *unit*, or None, with the reason logged, where none leads to the ground.

    A block that does not show the site is joined to the *former* one, whose last frames show what its first ones show.
    """
    try:
        return _joined_block(unit, reader, context, former)
    except UnusableFrame as problem:
        reader.log.refuse_all(unit.frames, problem)
        return None


def _joined_block(unit: Unit, reader: Reader, context: Context, former: Block | None) -> Block | None:
    """Choose the middle readable frame as reference; without tags of its own it is joined to the site frame."""
    site = _first_readable(unit.site, reader)
    middle = len(unit.frames) // 2
    by_nearness = sorted(range(len(unit.frames)), key=lambda i: (abs(i - middle), i))
    found = _first_readable([unit.frames[i] for i in by_nearness], reader)
    if site is None:
        tried = ", ".join(ref.path for ref in unit.site)
        detail = f"none of the frames that lead to the ground can be used: {tried}; see georeference.reference_frame"
        raise UnusableFrame("no_site_frame", detail)
    if found is None:
        return None
    (site_ref, site_pixels), (ref, pixels) = site, found
    del site, found
    fix = _fix(ref, pixels, reader, context)
    if fix.method not in ("geotiff", "world_file") and ref.frame_id != site_ref.frame_id:
        joined = _join(pixels, site_pixels, _fix(site_ref, site_pixels, reader, context), context.survey)
        del site_pixels
        if joined is None and former is not None:
            joined = _join_to_former(pixels, unit, former, reader, context.survey)
        if joined is None:
            detail = f"its block's reference {ref.path} fits neither {site_ref.path} nor the block before it"
            raise UnusableFrame("not_joined", f"{detail}; does a flight go on over the border of execution.unit_s?")
        fix = joined
    size = (pixels.shape[1], pixels.shape[0])
    return Block(unit, ref, size, fix, scale_at(fix.reference_to_ground, *size), pixels)


def _first_readable(refs: Sequence[FrameRef], reader: Reader) -> tuple[FrameRef, NDArray[np.uint8]] | None:
    for ref in refs:
        pixels = reader.pixels(ref)
        if pixels is not None:
            if pixels[::_POINT_STEP_PX, ::_POINT_STEP_PX].std() >= MIN_REFERENCE_SPREAD:
                return ref, pixels
            reader.log.refuse(ref, UnusableFrame("blank", "all pixels have nearly one value"))
    return None


MIN_REFERENCE_SPREAD = 2.0
"""Standard deviation in grey levels below which a frame shows nothing."""

_POINT_STEP_PX = 5


def _fix(ref: FrameRef, pixels: NDArray[np.uint8], reader: Reader, context: Context) -> GroundFix:
    height, width = pixels.shape[:2]
    return fix_ground(context.survey, context.archive, ref, reader.data(ref), width, height)


def _join(
    pixels: NDArray[np.uint8], site_pixels: NDArray[np.uint8], fix: GroundFix, survey: Survey
) -> GroundFix | None:
    """Return where the block's reference lies on the ground, through the site frame; None if they do not fit."""
    params = survey.registration
    pose = register(pixels, prepare_reference(site_pixels, params=params), params=params)
    to_site = pose.frame_to_reference
    if not pose.accepted:
        # in leaning scenes one direction may hold where the other does not
        pose = register(site_pixels, prepare_reference(pixels, params=params), params=params)
        if not pose.accepted:
            return None
        to_site = np.asarray(np.linalg.inv(pose.frame_to_reference), np.float64)
    return _moved(fix, to_site, pose.residual_px)


def _join_to_former(
    pixels: NDArray[np.uint8], unit: Unit, former: Block, reader: Reader, survey: Survey
) -> GroundFix | None:
    """Return where the reference of *unit* lies on the ground, by a frame between it and the *former* block's."""
    params, former_pixels = survey.registration, reader.pixels(former.ref)
    if former_pixels is None:
        return None
    here, there = prepare_reference(pixels, params=params), prepare_reference(former_pixels, params=params)
    del former_pixels
    for ref in (former.unit.frames[-1], unit.frames[0], former.unit.frames[-2], unit.frames[1]):
        between = reader.pixels(ref)
        if between is None:
            continue
        to_here, to_there = (register(between, reference, params=params) for reference in (here, there))
        if to_here.accepted and to_there.accepted:
            to_former = to_there.frame_to_reference @ np.linalg.inv(to_here.frame_to_reference)
            return _moved(former.fix, to_former, float(np.hypot(to_here.residual_px, to_there.residual_px)))
    return None


def _moved(fix: GroundFix, to_fixed: homography.Array, residual_px: float) -> GroundFix:
    """Return the fix of a frame that lies *to_fixed* (3, 3) on a frame with a known *fix*."""
    to_ground = homography.normalised(fix.reference_to_ground @ to_fixed)
    residual_m = float(np.hypot(fix.residual_m or 0.0, float(np.mean(fix.gsd_m)) * residual_px))
    return GroundFix(to_ground, fix.method, residual_m, fix.crs, fix.gsd_m)
