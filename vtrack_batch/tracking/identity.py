"""How sure is it that a chain is one vehicle?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vtrack_batch.tracking.link import Chains
from vtrack_batch.tracking.paths import Paths, chain_numbers
from vtrack_batch.tracking.sightings import Array

SLOPE, OFFSET = 0.43, 2.6  # of log-odds; see docs/decisions/0006


def identity_probability(chains: Chains, paths: Paths) -> Array:
    """Return, for every path, the probability of its weakest link (k,); 1 where there is none.

    The product of all links would say too little: wrong links come together, where two vehicles are taken for one
    another, and what is stated of the many sure links is less than the truth.
    """
    chain = chain_numbers(chains.before)
    weakest = np.ones(int(chain.max(initial=-1)) + 1)
    linked = chains.after >= 0
    np.minimum.at(weakest, chain[linked], chains.probability[linked])
    return np.asarray(weakest[chain[paths.sighting[paths.start]]])


def calibrated(chains: Chains) -> Chains:
    """Return *chains* with link probabilities that mean what they say.

    Evidence that past and future share counts once only in the odds that choose links, and every rival counts in full,
    so that those odds are too modest. A straight line on log-odds mends it, fitted to simulated traffic.
    """
    mended = calibrated_probability(chains.probability)
    return replace(chains, probability=np.where(chains.after >= 0, mended, chains.probability))


def calibrated_probability(p: Array | float) -> Array:
    """Return what the probability of a link means."""
    p = np.clip(p, 1e-9, 1 - 1e-9)
    return np.asarray(1 / (1 + np.exp(-(SLOPE * np.log(p / (1 - p)) + OFFSET))))
