"""Points of tracks beside true sightings: what the measures of identity are made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vtrack_batch.evaluation.assignment import Index
from vtrack_batch.evaluation.blocks import Array

EPSILON = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Tracked:
    """Points of tracks and true sightings, frame by frame.

    ``vehicle``, ``frame`` (n_true,) and ``track``, ``track_frame`` (n_points,) are codes; ``i`` (row of a sighting),
    ``j`` (row of a point), ``similarity`` (n_pairs,) are all pairs of one frame with similarity > 0, in order of frame,
    vehicle and track. A pair of similarity 0.5 and more is within the gate.
    """

    vehicle: Index
    frame: Index
    track: Index
    track_frame: Index
    i: Index
    j: Index
    similarity: Array
