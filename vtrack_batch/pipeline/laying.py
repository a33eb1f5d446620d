"""Laying the frames of a block on its reference: by a plane pose, and straightened where no plane pose fits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.background.stacks import Rows, Sample
from vtrack_batch.model.homography import Array
from vtrack_batch.pipeline.samples import Keep
from vtrack_batch.registration.alignment import Registration, register
from vtrack_batch.registration.bending import Bend, common_picture, find_bend, residual_px, straighten
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.reference import Reference
from vtrack_batch.registration.steady import steady_patches

_PICTURE_FRAMES = 31
_PROBES = 8
# Straightening must make the residual this much smaller before it is done.
_PREFERENCE = 0.9


@dataclass(frozen=True)
class Laid:
    """A frame on the reference: ``pixels`` straightened by ``bend``, None = as they were; the pose is for these."""

    pixels: NDArray[np.uint8]
    registration: Registration
    bend: Bend | None


@dataclass(frozen=True)
class References:
    """The block's reference frame in two digests: patches that lie still on the ground, and patches anywhere.

    ``picture`` (h, w) uint8, from which frames are told to bend, and the reference frame's own ``bend``; None where
    plane poses fit.
    """

    steady: Reference
    whole: Reference
    picture: NDArray[np.uint8] | None = None
    bend: Bend | None = None

    def lay(self, pixels: NDArray[np.uint8], params: RegistrationParams) -> Laid:
        """Lay a frame on the reference by patches on the ground; by all, where too few of those are in view."""
        by = self.steady
        pose = register(pixels, by, params=params)
        if not pose.accepted:
            by = self.whole
            pose = register(pixels, by, params=params)
        if self.picture is None or self.bend is None or not pose.accepted:
            return Laid(pixels, pose, None)
        bend = find_bend(pixels, pose.frame_to_reference, self.picture, params=params)
        checked = pose.patches_px[by.held_out], self.bend.to_straight(by.centres_px[by.held_out])
        left_px = residual_px(*checked, pose.frame_to_reference, bend)
        return Laid(straighten(pixels, bend), replace(pose, residual_px=left_px), bend)


def lay_samples(
    samples: list[Rows], laid: Sequence[Registration], rough: Reference, *, keep: Keep, params: RegistrationParams
) -> tuple[list[Sample], References]:
    """Settle the poses of *samples*, the reference's first, then those of the frames *laid* on it in *rough*.

    Where plane poses leave a large residual, and straightening a smaller one, *samples* are replaced by straight ones.
    """
    steady, settled = steady_patches(rough, laid, params=params)
    poses = [np.eye(3), *settled]
    references = References(steady, rough)
    plane_px = _typical_px(laid, settled, rough.centres_px, [None] * len(laid))
    if params.bend == "auto" and plane_px > params.bend_from_px:
        picture = common_picture(_spread(samples, poses))
        bends = _bends(samples, poses, picture, laid, rough, params)
        if bends:
            for number, bend in enumerate(bends):
                samples[number] = keep(straighten(samples[number][:], bend))
            references = References(steady, rough, picture, bends[0])
    return list(map(Sample, samples, poses)), references


def _bends(
    samples: Sequence[Rows],
    poses: Sequence[Array],
    picture: NDArray[np.uint8],
    laid: Sequence[Registration],
    rough: Reference,
    params: RegistrationParams,
) -> list[Bend]:
    """Return how each of *samples* bends, the reference's first; none where straightening makes too little better.

    Some of them tell first whether it is worth while to look at all.
    """
    found: dict[int, Bend] = {}
    for step in (max(1, len(laid) // _PROBES), 1):
        others = range(1, len(samples), step)
        for number in (0, *others):
            if number not in found:
                found[number] = find_bend(samples[number][:], poses[number], picture, params=params)
        some, settled = [laid[number - 1] for number in others], [poses[number] for number in others]
        centres_px = found[0].to_straight(rough.centres_px)
        bent_px = _typical_px(some, settled, centres_px, [found[number] for number in others])
        if bent_px >= _PREFERENCE * _typical_px(some, settled, rough.centres_px, [None] * len(some)):
            return []
    return [found[number] for number in range(len(samples))]


def _typical_px(
    laid: Sequence[Registration], poses: Sequence[Array], centres_px: Array, bends: Sequence[Bend | None]
) -> float:
    """Return the median over frames of the residual at all patches that were found."""
    frames = zip(laid, poses, bends, strict=True)
    left = [residual_px(frame.patches_px, centres_px, pose, bend) for frame, pose, bend in frames]
    return float(np.median(left)) if left else 0.0


def _spread(samples: Sequence[Rows], poses: Sequence[Array]) -> Iterator[tuple[NDArray[np.uint8], Array]]:
    """Yield the reference, and some other samples from first to last."""
    others = np.unique(np.linspace(1, len(samples) - 1, min(_PICTURE_FRAMES, len(samples)) - 1).round().astype(int))
    for number in (0, *others.tolist()):
        yield samples[number][:], poses[number]
