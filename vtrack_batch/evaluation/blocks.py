"""Intervals: independent blocks of time, drawn with replacement.

Vehicles in the same minute share light, queue and platform, so vehicles are not independent and never drawn. Blocks
of time are drawn instead (Künsch 1989; for trackers Kasturi et al. 2009), every sum being kept per block: a draw is
then a vector of block multiplicities, and a score is a function of weighted sums.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.evaluation.params import EvaluationParams

Array = NDArray[np.float64]
Score = dict[str, float | None]
"""``value``, ``lo``, ``hi``: the score and its 95 % interval; None where it is not defined."""


@dataclass(frozen=True)
class Blocks:
    """``of_frame`` (n_frames,) block of each frame; ``draws`` (1 + resamples, n_blocks) multiplicities, first row 1."""

    of_frame: NDArray[np.int64]
    draws: Array
    length_s: float

    def totals(self, frame: NDArray[Any], amount: NDArray[Any] | float = 1.0) -> Array:
        """Return the sum of *amount* over rows lying in *frame*, for the data as they are and for every draw."""
        weight = np.broadcast_to(np.asarray(amount, float), np.shape(frame))
        per_block = np.bincount(self.of_frame[np.asarray(frame, np.int64)], weight, self.draws.shape[1])
        return np.asarray(self.draws @ per_block)

    def score(self, values: Array) -> Score:
        """Return the first of *values* (1 + resamples,) with the 2.5 % and 97.5 % points of the others."""
        lo, hi = None, None
        drawn = values[1:][np.isfinite(values[1:])]
        if self.draws.shape[1] > 1 and len(drawn):
            lo, hi = (float(x) for x in np.percentile(drawn, [2.5, 97.5]))
        value = float(values[0]) if np.isfinite(values[0]) else None
        return {"value": value, "lo": None if value is None else lo, "hi": None if value is None else hi}

    def ratio(self, part: Array, whole: Array) -> Score:
        """Score of *part* over *whole*, both as ``totals`` gives them; not defined where *whole* is 0."""
        return self.score(divide(part, whole))

    def quantile(self, frame: NDArray[Any], values: NDArray[Any], share: float = 0.5) -> Score:
        """Score of the quantile of *values* at *share*, draws weighting the values by their block's multiplicity."""
        if not len(values):
            return {"value": None, "lo": None, "hi": None}
        order = np.argsort(values, kind="stable")
        block = self.of_frame[np.asarray(frame, np.int64)[order]]
        ordered = np.asarray(values, float)[order]
        places = [np.flatnonzero(block == k) for k in range(self.draws.shape[1])]
        whole = self.draws @ np.array([len(place) for place in places], float)
        # the mean of both middle values, as every median has it
        low, high = (self._first(places, whole * share, beyond, len(values)) for beyond in (False, True))
        found = (ordered[low] + ordered[high]) / 2
        return self.score(np.where(whole > 0, found, np.nan))

    def _first(self, places: list[NDArray[np.int64]], aim: Array, beyond: bool, count: int) -> NDArray[np.int64]:
        """Return, per draw, the first place at which the weights up to it reach *aim* (or are *beyond* it), by halving.

        ``places``: of each block, the places of its values in the order of all.
        """
        low, high = np.zeros(len(aim), np.int64), np.full(len(aim), count - 1)
        while (low < high).any():
            middle = (low + high) // 2
            reach = np.zeros(len(aim))
            for draw, place in zip(self.draws.T, places, strict=True):
                reach += draw * np.searchsorted(place, middle, "right")
            there = reach > aim if beyond else reach >= aim
            low, high = np.where(there, low, middle + 1), np.where(there, middle, high)
        return np.minimum(low, count - 1)


def divide(part: Array, whole: Array) -> Array:
    """Return part / whole, NaN where whole is 0."""
    return np.asarray(np.divide(part, whole, out=np.full(np.shape(whole), np.nan), where=whole > 0))


def time_blocks(t_s: Array, params: EvaluationParams) -> Blocks:
    """Cut frames at times *t_s* (n_frames,) in seconds into blocks of equal length, and draw them."""
    start, span = (float(t_s.min()), float(np.ptp(t_s))) if len(t_s) else (0.0, 0.0)
    step = span / max(1, len(t_s) - 1)
    length = min(params.block_s, max((span + step) / params.least_blocks, 1e-6))
    _, block = np.unique(np.floor((t_s - start) / length + 1e-9).astype(np.int64), return_inverse=True)
    count = int(block.max()) + 1 if len(block) else 1
    return Blocks(block.astype(np.int64), draw_blocks(count, params), length)


def draw_blocks(count: int, params: EvaluationParams) -> Array:
    """Return multiplicities (1 + resamples, count): the data as they are, then draws with replacement."""
    rng = np.random.default_rng(params.seed)
    drawn = rng.multinomial(count, np.full(count, 1 / count), params.resamples)
    return np.vstack([np.ones(count), drawn]).astype(float)
