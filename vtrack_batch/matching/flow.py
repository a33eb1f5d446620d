"""The flow map of a place: how vehicles move where, as a sample of motions; learned without truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from vtrack_batch.matching.candidates import Array

NEAREST = 32  # motions that speak for a place
PLACE_M = 4.0  # how far they speak (Gaussian sigma)


@dataclass(frozen=True)
class FlowMap:
    """Motions seen at a place: ``xy`` (n, 2) metres, ``velocity`` (n, 2) m/s, the mean over one interval from there.

    ``spread_mps`` is how far the motions of vehicles at one place differ from those of others, times the interval, and
    ``spread_min_m`` the least spread of displacements.
    """

    xy: Array
    velocity: Array
    spread_mps: float = 1.5
    spread_min_m: float = 0.8

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.xy)

    def mixed(self, prior: Array, xy: Array, displacement: Array, elapsed_s: float, *, prior_weight: float) -> Array:
        """Return densities (e,) of displacements (e, 2) from places (e, 2): the *prior* where nothing was seen.

        Like the votes of neighbours: (κ prior + Σ w N(d; v t)) / (κ + Σ w), with κ = *prior_weight*.
        """
        if not len(self.xy) or not len(xy):
            return prior
        spread = max(self.spread_mps * elapsed_s, self.spread_min_m)
        places, of_place = np.unique(xy, axis=0, return_inverse=True)
        count = min(NEAREST, len(self.xy))
        away, near = self._tree.query(places, k=np.arange(1, count + 1))
        weight = np.exp(-0.5 * (away / PLACE_M) ** 2)[of_place]
        off = displacement[:, None, :] - self.velocity[near[of_place]] * elapsed_s
        votes = np.exp(-0.5 * (off**2).sum(axis=2) / spread**2) / (2 * np.pi * spread**2)
        seen = weight.sum(axis=1)
        return np.asarray((prior_weight * prior + (weight * votes).sum(axis=1)) / (prior_weight + seen))
