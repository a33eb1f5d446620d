"""Finding small patches of the reference in a frame at the places where a guessed pose puts them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model import homography
from vtrack_batch.registration.correlation import correlate
from vtrack_batch.registration.reduction import Grey
from vtrack_batch.registration.reference import Reference


@dataclass(frozen=True)
class Search:
    """How far from its predicted place a patch is looked for, and from which correlation it counts as found."""

    reach_px: int
    min_correlation: float


@dataclass(frozen=True, eq=False)
class Sightings:
    """Where patches were looked for and found: all (m,) along the reference's patches.

    ``visible``: the frame shows the patch's predicted place; ``found``: its correlation is high and peaks inside the
    search window; ``frame_px`` (m, 2) float64: where, NaN unless found.
    """

    visible: NDArray[np.bool_]
    found: NDArray[np.bool_]
    frame_px: NDArray[np.float64]


def find_patches(
    plane: Grey,
    reference: Reference,
    frame_to_reference: NDArray[np.float64],
    *,
    chosen: NDArray[np.bool_],
    search: Search,
) -> Sightings:
    """Look in the frame *plane* (H, W) for the *chosen* (m,) patches of *reference*.

    The window around a prediction is cut out in the reference's geometry (rotation and scale of the guessed pose)
    and centred on a whole pixel, so that a mere shift costs no interpolation. Normalised cross-correlation does not
    mind gain and offset of exposure.
    """
    to_frame: NDArray[np.float64] = np.asarray(np.linalg.inv(frame_to_reference), np.float64)
    predicted = homography.apply(to_frame, reference.centres_px)
    linear = homography.jacobian(to_frame, reference.centres_px)
    half_px = reference.patches.shape[1] / 2 + search.reach_px
    visible = chosen & _inside(predicted, linear, half_px, plane.shape)
    anchors = np.round(predicted[visible])
    offsets, scores = correlate(plane, reference.patches[visible], anchors, linear[visible], search_px=search.reach_px)
    good = scores >= search.min_correlation
    found = visible.copy()
    found[visible] = good
    places = np.full_like(predicted, np.nan)
    places[found] = anchors[good] + np.einsum("nij,nj->ni", linear[found], offsets[good])
    return Sightings(visible, found, places)


def _inside(
    places: NDArray[np.float64], linear: NDArray[np.float64], half_px: float, shape: tuple[int, ...]
) -> NDArray[np.bool_]:
    """Say which windows of *half_px* around *places*, turned by *linear*, lie inside an image of *shape*."""
    reach = half_px * np.abs(linear).sum(axis=2) + 2
    high = np.array([shape[1] - 1, shape[0] - 1])
    return np.asarray(((places - reach >= 0) & (places + reach <= high)).all(axis=1))
