"""From chains to smoothed paths: one point for every frame between a vehicle's first and last sighting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.tracking.link import Chains
from vtrack_batch.tracking.motion import smooth
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.tracking.sightings import Array, Index, Sightings


@dataclass(frozen=True)
class Paths:
    """Smoothed paths, track after track: points of track k are rows first[k] ... first[k + 1] - 1.

    ``frame`` (p,), ``sighting`` (p,) row of the sighting or -1, ``xy`` (p, 2), ``velocity`` (p, 2), ``speed_sigma``
    (p,) standard error of the velocity per axis, ``parked`` (k,) whether the vehicle stands all its life.
    """

    first: Index
    frame: Index
    sighting: Index
    xy: Array
    velocity: Array
    speed_sigma: Array
    parked: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.parked)

    @property
    def track(self) -> Index:
        """Number of the track of every point, (p,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.first))

    @property
    def start(self) -> Index:
        """First point of every track, (k,)."""
        return self.first[:-1]

    @property
    def end(self) -> Index:
        """Last point of every track, (k,)."""
        return self.first[1:] - 1


def paths_of(s: Sightings, chains: Chains, params: TrackingParams) -> Paths:
    """Smooth every chain of at least ``min_sightings`` sightings; paths are in order of their first sighting."""
    chain = chain_numbers(chains.before)
    size = np.bincount(chain)
    kept = np.flatnonzero((size >= params.min_sightings)[chain])
    kept = kept[np.lexsort((kept, chain[kept]))]
    _, at, count = np.unique(chain[kept], return_index=True, return_counts=True)
    head, tail = kept[at], kept[at + count - 1]
    length = s.frame[tail] - s.frame[head] + 1
    first = np.concatenate([[0], np.cumsum(length)]).astype(np.int64)
    track = np.repeat(np.arange(len(head)), length)
    frame = np.arange(first[-1]) - first[track] + s.frame[head][track]
    sighting = np.full(first[-1], -1)
    of_track = np.repeat(np.arange(len(head)), count)
    sighting[first[of_track] + s.frame[kept] - s.frame[head][of_track]] = kept
    seen = sighting >= 0
    motion = params.motion
    mean, cov = smooth(
        first, s.frame_s[frame], seen, s.xy[sighting], s.sigma_m[sighting], motion.jerkiness, motion.speed_sigma_mps
    )
    parked = _parked(s, kept, of_track, at, params)
    return Paths(first, frame, sighting, mean[:, :2], mean[:, 2:], np.sqrt(cov[:, 2]), parked)


def chain_numbers(before: Index) -> Index:
    """Number the chains by their first sighting; returns the number of every sighting, (n,)."""
    head = np.arange(len(before))
    jump = np.where(before >= 0, before, head)
    while (jump != jump[jump]).any():  # pointer doubling: a chain of a thousand takes ten rounds
        jump = jump[jump]
    return np.unique(jump, return_inverse=True)[1] if len(before) else head


def _parked(s: Sightings, kept: Index, of_track: Index, at: Index, params: TrackingParams) -> NDArray[np.bool_]:
    """Tell which tracks never leave the place where they are, for long enough."""
    if not len(at):
        return np.zeros(0, bool)
    xy, t = s.xy[kept], s.t[kept]
    centre = np.column_stack([np.bincount(of_track, weights=c) for c in xy.T]) / np.bincount(of_track)[:, None]
    away = np.hypot(*(xy - centre[of_track]).T)
    farthest = np.maximum.reduceat(away, at)
    life = np.maximum.reduceat(t, at) - np.minimum.reduceat(t, at)
    return np.asarray((farthest < params.parked_move_m) & (life >= params.parked_s))
