"""Is a stated probability true? Reliability by bins, and the expected calibration error (ECE)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.evaluation.blocks import Array, Blocks, divide

_EDGES = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 0.999])
"""Bins are finer towards 1, where nearly all links lie and where a wrong belief costs most."""


def calibration(
    frame: NDArray[np.int64], probability: Array, right: NDArray[np.bool_], blocks: Blocks, *, least: float
) -> dict[str, Any] | None:
    """Return how often events stated with *probability* came true: all together, by bin, and the ECE.

    ``frame``, ``probability``, ``right`` (n,): one row an event; those stated at *least* or lower, or not at all, are
    left out. ECE: over the bins, |mean stated - share right| weighted by events (Naeini and others 2015). None without
    events.
    """
    kept = probability > least
    frame, probability, right = frame[kept], probability[kept], right[kept].astype(float)
    if not len(frame):
        return None
    number = np.searchsorted(_EDGES, probability, side="left")
    bins, misfit = [], np.zeros(len(blocks.draws))
    total = blocks.totals(frame)
    ends = np.r_[least, _EDGES, 1.0]
    for k in np.unique(number):
        of = number == k
        count = blocks.totals(frame[of])
        stated, came = (blocks.totals(frame[of], values[of]) for values in (probability, right))
        misfit += np.abs(stated - came)
        bins.append(
            {
                "above": float(ends[k]),
                "up_to": float(ends[k + 1]),
                "events": int(of.sum()),
                "mean_stated": float(probability[of].mean()),
                "share_right": blocks.ratio(came, count),
            }
        )
    return {
        "events": len(frame),
        "mean_stated": blocks.ratio(blocks.totals(frame, probability), total),
        "share_right": blocks.ratio(blocks.totals(frame, right), total),
        "ece": blocks.score(divide(misfit, total)),
        "bins": bins,
    }
