"""The flow map of a place: how vehicles move where, as a sample of motions; learned without truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.candidates import Array

FORMAT = "vtrack-batch flow map 1: xy_m, velocity_mps"

NEAREST = 32  # motions that speak for a place
VOTERS = 48  # motions that are asked in finer detail
ALIKE_M, ALIKE_MPS = 4.0, 5.0  # a motion is like another up to this distance, plus this much a second
UNKNOWN_M = 6.0  # places farther than this from the 8th motion are not known
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

    def possible(self, start: Array, end: Array, elapsed_s: float) -> NDArray[np.bool_]:
        """Tell which motions from *start* to *end* (e, 2) are like one ever seen, or lead through the unknown."""
        if not len(self.xy) or not len(start):
            return np.ones(len(start), bool)
        tree, starts, ends, _ = self._trees(elapsed_s)
        near = np.isfinite(
            tree.query(np.column_stack([start, end]), distance_upper_bound=ALIKE_M + ALIKE_MPS * elapsed_s)[0]
        )
        few = min(8, len(self.xy))
        return near | (_distance(starts, start, few) > UNKNOWN_M) | (_distance(ends, end, few) > UNKNOWN_M)

    def evidence(self, start: Array, end: Array, elapsed_s: float) -> Array:
        """Return what the map knows of motions from *start* (e, 2) to *end* (e, 2), as ten columns (e, 10).

        Distances (m) to the 1st, 8th and 24th most similar motion, to the 8th start and the 8th end of any motion; log
        shares of the motions that start (end) nearby and go (come) the same way, narrowly and widely; log of their
        number.
        """
        tree, starts, ends, far = self._trees(elapsed_s)
        motion = np.column_stack([start, end])
        count = min(24, len(self.xy))
        alike = tree.query(motion, k=sorted({1, min(8, count), count}))[0]
        alike = alike[:, [0, min(1, alike.shape[1] - 1), alike.shape[1] - 1]]
        there, forward = _votes(starts, start, end, far, elapsed_s)
        here, backward = _votes(ends, end, start, self.xy, elapsed_s)
        return np.column_stack([alike, there, here, forward, backward, np.full(len(start), np.log(len(self.xy)))])

    def _trees(self, elapsed_s: float) -> tuple[KDTree, KDTree, KDTree, Array]:
        """Trees of motions, of their starts, of their ends, and the ends; kept for one interval."""
        if self._kept.get("elapsed_s") != elapsed_s:
            ends = self.xy + self.velocity * elapsed_s
            trees = (KDTree(np.column_stack([self.xy, ends])), self._tree, KDTree(ends), ends)
            self._kept.update(elapsed_s=elapsed_s, trees=trees)
        return self._kept["trees"]

    @cached_property
    def _kept(self) -> dict[str, Any]:
        return {}

    def save(self, path: str | Path) -> None:
        """Write the map to one file, numpy's npz; the same map gives the same bytes."""
        with Path(path).open("wb") as file:
            np.savez_compressed(file, format=np.array(FORMAT), xy_m=self.xy, velocity_mps=self.velocity)

    @classmethod
    def load(cls, path: str | Path) -> FlowMap:
        """Read a map that ``save`` wrote; another file raises ``UnusableData``."""
        try:
            with np.load(Path(path), allow_pickle=False) as file:
                found, xy, velocity = str(file["format"]), file["xy_m"], file["velocity_mps"]
        except (BadZipFile, EOFError, KeyError, ValueError, TypeError, AttributeError) as reason:
            raise UnusableData(f"{path} is not a flow map: {reason}") from reason
        if found != FORMAT:
            raise UnusableData(f"{path} holds {found!r}; this version reads {FORMAT!r}")
        if not (xy.ndim == 2 and xy.shape[1:] == (2,) and xy.shape == velocity.shape):
            raise UnusableData(f"{path}: places {xy.shape} and velocities {velocity.shape} should be (n, 2) alike")
        if not (np.isfinite(xy).all() and np.isfinite(velocity).all()):
            raise UnusableData(f"{path} holds values that are not finite")
        return cls(xy, velocity)

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


def _distance(tree: KDTree, at: Array, rank: int) -> Array:
    """Return the distance (e,) from points to their neighbour of that *rank*; points may be repeated."""
    places, of_place = np.unique(at, axis=0, return_inverse=True)
    return np.asarray(tree.query(places, k=[rank])[0][of_place, 0])


def _votes(tree: KDTree, at: Array, other: Array, others: Array, elapsed_s: float) -> tuple[Array, Array]:
    """Return the distance to the 8th place of *tree*, and the log shares (e, 2) of the nearest whose far end agrees."""
    places, of_place = np.unique(at, axis=0, return_inverse=True)
    count = min(VOTERS, len(others))
    away, near = tree.query(places, k=np.arange(1, count + 1))
    weight = np.exp(-0.5 * (away / PLACE_M) ** 2)[of_place]
    square = ((other[:, None, :] - others[near[of_place]]) ** 2).sum(axis=2)
    shares = [
        np.log(((weight * np.exp(-0.5 * square / spread**2)).sum(axis=1) + 0.02) / (weight.sum(axis=1) + 1))
        for spread in (0.7 + 0.35 * elapsed_s, 0.8 + 1.2 * elapsed_s)
    ]
    return away[of_place, min(7, count - 1)], np.column_stack(shares)
