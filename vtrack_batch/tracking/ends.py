"""Cut the first or last link of a chain where it asks for an acceleration that no vehicle has.

Inside a chain past and future speak against a wrong sighting; at its ends only one of them does, so a false alarm
beside the road is most easily taken for the beginning or the end of a vehicle's path.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vtrack_batch.tracking.link import Chains
from vtrack_batch.tracking.sightings import Index, Sightings

ACCEL_SIGMAS = 3.0
ROUNDS = 4


def cut_impossible_ends(s: Sightings, chains: Chains, *, max_accel_mps2: float) -> Chains:
    """Return *chains* without end links that ask for more than *max_accel_mps2*, noise of positions allowed for."""
    for _ in range(ROUNDS):
        early = _impossible(s, np.flatnonzero(chains.before < 0), chains.after, max_accel_mps2)
        late = chains.before[_impossible(s, np.flatnonzero(chains.after < 0), chains.before, max_accel_mps2)]
        if not len(early) and not len(late):
            break
        chains = _without(chains, np.union1d(early, late))
    return chains


def _impossible(s: Sightings, ends: Index, onward: Index, max_accel_mps2: float) -> Index:
    """Return those of *ends* from which the step *onward* does not go with the step after it."""
    ends = ends[onward[ends] >= 0]
    ends = ends[onward[onward[ends]] >= 0]
    middle = onward[ends]
    far = onward[middle]
    first_s, second_s = s.t[middle] - s.t[ends], s.t[far] - s.t[middle]
    change = (s.xy[far] - s.xy[middle]) / second_s[:, None] - (s.xy[middle] - s.xy[ends]) / first_s[:, None]
    elapsed_s = np.abs(first_s + second_s) / 2
    sigma_mps = np.sqrt(
        (s.sigma_m[ends] / first_s) ** 2
        + (s.sigma_m[middle] * (1 / first_s + 1 / second_s)) ** 2
        + (s.sigma_m[far] / second_s) ** 2
    )
    return np.asarray(ends[np.hypot(*change.T) > max_accel_mps2 * elapsed_s + ACCEL_SIGMAS * sigma_mps])


def _without(chains: Chains, froms: Index) -> Chains:
    """Return *chains* without the links that leave the sightings *froms*."""
    after, before = chains.after.copy(), chains.before.copy()
    probability, none_before = chains.probability.copy(), chains.none_before.copy()
    tos = after[froms]
    none_before[tos] = 1 - probability[froms]
    probability[froms] = 1 - probability[froms]
    after[froms], before[tos] = -1, -1
    return replace(chains, after=after, before=before, probability=probability, none_before=none_before)
