"""CLEAR MOT (Bernardin and Stiefelhagen 2008): misses, false alarms and switches, frame by frame, by two readings.

A vehicle keeps its track while both are within the gate, even where another track is nearer. The paper leaves open for
how long. Nearest in time (TrackEval): the partner of the last frame is kept, as far as the rest of that frame allows,
and similarities of all pairs add up to the most. Carried (motmetrics): the last partner ever is kept, after any gap and
before all else, and as many others as possible are paired. Both count a switch when a vehicle's partner is another than
its last one ever. They agree wherever no vehicle has two tracks within its gate; see docs/measures.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.evaluation.assignment import Index, best_pairs
from vtrack_batch.evaluation.blocks import Array, Blocks, divide
from vtrack_batch.evaluation.tracked import EPSILON, Tracked

_KEPT = 1000.0
"""Worth of the partner of the last frame above all similarity, as TrackEval has it."""
_MOST_PAIRS = 1e4
"""Worth of any pair above all similarity: as many pairs as possible come first, as motmetrics has it."""

Rule: TypeAlias = Callable[[Index, Index, Array, Index, Index], Index]
"""(vehicles, tracks, similarities of a frame; last partner ever, partner in the last frame) -> the pairs chosen."""


def clear_scores(tracked: Tracked, blocks: Blocks) -> dict[str, Any]:
    """Return MOTA and the number of ID switches by TrackEval's reading, and as ``..._carried`` by motmetrics'."""
    true, points = blocks.totals(tracked.frame), blocks.totals(tracked.track_frame)
    scores: dict[str, Any] = {}
    for name, rule in {"": of_last_frame, "_carried": carried}.items():
        chosen, switched = clear_matches(tracked, rule)
        frame = tracked.frame[tracked.i[chosen]]
        tp, ids = blocks.totals(frame), blocks.totals(frame[switched])
        scores[f"mota{name}"] = blocks.score(divide(2 * tp - points - ids, true))
        scores[f"id_switches{name}"] = int(ids[0])
    return scores


def clear_matches(tracked: Tracked, rule: Rule) -> tuple[Index, NDArray[np.bool_]]:
    """Return the pairs matched by *rule*, as positions in ``tracked.i``, in order of frame, and which are switches."""
    partner = np.full(tracked.vehicle.max(initial=-1) + 1, -1)
    former = partner.copy()
    within = np.flatnonzero(tracked.similarity >= 0.5 - EPSILON)
    chosen, switches = [np.empty(0, np.int64)], [np.empty(0, bool)]
    # a frame without vehicles, or without tracks, is passed over and forgets nothing
    populated = np.intersect1d(tracked.frame, tracked.track_frame)
    begin, end = (np.searchsorted(tracked.frame[tracked.i[within]], populated, side) for side in ("left", "right"))
    for start, stop in zip(begin, end, strict=True):
        rows = within[start:stop]
        vehicle, track = tracked.vehicle[tracked.i[rows]], tracked.track[tracked.j[rows]]
        best = rule(vehicle, track, tracked.similarity[rows], partner, former)
        vehicle, track = vehicle[best], track[best]
        chosen.append(rows[best])
        switches.append((partner[vehicle] >= 0) & (partner[vehicle] != track))
        partner[vehicle] = track
        former[:] = -1
        former[vehicle] = track
    return np.concatenate(chosen), np.concatenate(switches)


def of_last_frame(vehicle: Index, track: Index, similarity: Array, partner: Index, former: Index) -> Index:
    """Pair for the largest total, keeping partners of the last frame first (TrackEval)."""
    return best_pairs(vehicle, track, similarity + _KEPT * (former[vehicle] == track))


def carried(vehicle: Index, track: Index, similarity: Array, partner: Index, former: Index) -> Index:
    """Keep every last partner, after any gap; then pair as many others as can be, nearest first (motmetrics)."""
    kept = np.flatnonzero(partner[vehicle] == track)
    # two vehicles may have had the same track, one after the other: the first in order of name has it
    kept = kept[np.sort(np.unique(track[kept], return_index=True)[1])]
    free = np.flatnonzero(~np.isin(vehicle, vehicle[kept]) & ~np.isin(track, track[kept]))
    best = free[best_pairs(vehicle[free], track[free], _MOST_PAIRS + similarity[free])]
    return np.sort(np.concatenate([kept, best]))
