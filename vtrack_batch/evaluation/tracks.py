"""Does a track stay with its vehicle? IDF1, MOTA, HOTA, switches, and the share of vehicles tracked end to end.

The three figures follow the definitions, and the order of work, of TrackEval (Luiten and others 2020), with the
similarity ``1 - distance / (2 · gate)``: a pair within the gate is one of similarity 0.5 and more.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.evaluation.assignment import Index, best_pairs
from vtrack_batch.evaluation.blocks import Array, Blocks, divide
from vtrack_batch.evaluation.calibration import calibration
from vtrack_batch.evaluation.clear import clear_scores
from vtrack_batch.evaluation.links import with_names
from vtrack_batch.evaluation.pairing import NEUTRAL, Paired
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.sides import Result
from vtrack_batch.evaluation.tracked import EPSILON, Tracked

_ALPHAS = np.arange(0.05, 0.99, 0.05)


def track_scores(paired: Paired, blocks: Blocks, params: EvaluationParams) -> dict[str, Any]:
    """Return IDF1, MOTA, HOTA (0-1), ID switches, and shares of vehicles, each with its interval.

    For the intervals of IDF1 and HOTA the pairing of vehicles with tracks is kept, and its sums are drawn by block.
    """
    return {**identity_scores(comparable(paired), blocks), **_end_to_end(paired, blocks, params)}


def identity_scores(tracked: Tracked, blocks: Blocks) -> dict[str, Any]:
    """Return the field's own figures: IDF1, MOTA with ID switches, HOTA with DetA and AssA."""
    return {
        "vehicles": len(np.unique(tracked.vehicle)),
        "tracks": len(np.unique(tracked.track)),
        "idf1": _idf1(tracked, blocks),
        **clear_scores(tracked, blocks),
        **_hota(tracked, blocks),
    }


def comparable(paired: Paired) -> Tracked:
    """Return what can be compared: wanted vehicles, and points of tracks that are right or wrong."""
    true_at = np.flatnonzero(paired.true["wanted"].to_numpy(bool))
    points = (paired.found["verdict"] != NEUTRAL) & paired.found["vehicle_id"].notna()
    found_at = np.flatnonzero(points.to_numpy(bool))
    true, found = paired.true.iloc[true_at], paired.found.iloc[found_at]
    to_true, to_found = np.full(len(paired.true), -1), np.full(len(paired.found), -1)
    to_true[true_at], to_found[found_at] = np.arange(len(true_at)), np.arange(len(found_at))
    i, j = to_true[paired.near[1]], to_found[paired.near[0]]
    similarity = 1 - paired.near[2] / 2
    keep = np.flatnonzero((i >= 0) & (j >= 0) & (similarity > 0))
    keep = keep[np.lexsort((j[keep], i[keep]))]
    return Tracked(
        vehicle=pd.factorize(true["vehicle"], sort=True)[0].astype(np.int64),
        frame=true["frame"].to_numpy(np.int64),
        track=pd.factorize(found["vehicle_id"], sort=True)[0].astype(np.int64),
        track_frame=found["frame"].to_numpy(np.int64),
        i=i[keep],
        j=j[keep],
        similarity=similarity[keep],
    )


def _idf1(tracked: Tracked, blocks: Blocks) -> dict[str, float | None]:
    """Ristani and others 2016: vehicles against tracks one to one, so that most frames agree."""
    within = tracked.similarity >= 0.5 - EPSILON
    i, j = tracked.i[within], tracked.j[within]
    pairs, code, together = _couples(tracked.vehicle[i], tracked.track[j])
    chosen = np.zeros(len(together), bool)
    chosen[best_pairs(pairs[0], pairs[1], together.astype(float))] = True
    right = blocks.totals(tracked.frame[i], chosen[code])
    return blocks.ratio(2 * right, blocks.totals(tracked.frame) + blocks.totals(tracked.track_frame))


def _hota(tracked: Tracked, blocks: Blocks) -> dict[str, dict[str, float | None]]:
    """Luiten and others 2021: geometric mean of detection and association, averaged over the gates alpha."""
    shape = (tracked.vehicle.max(initial=-1) + 1, tracked.track.max(initial=-1) + 1)
    size_v, size_t = np.bincount(tracked.vehicle, minlength=shape[0]), np.bincount(tracked.track, minlength=shape[1])
    vehicle, track = tracked.vehicle[tracked.i], tracked.track[tracked.j]
    of_true = np.bincount(tracked.i, tracked.similarity, len(tracked.vehicle))
    of_point = np.bincount(tracked.j, tracked.similarity, len(tracked.track))
    share = tracked.similarity / np.maximum(of_true[tracked.i] + of_point[tracked.j] - tracked.similarity, EPSILON)
    pairs, code, _ = _couples(vehicle, track)
    alike = np.bincount(code, share, len(pairs[0]))
    alike = alike / (size_v[pairs[0]] + size_t[pairs[1]] - alike)
    best = best_pairs(tracked.i, tracked.j, alike[code] * tracked.similarity)
    all_points = blocks.totals(tracked.frame) + blocks.totals(tracked.track_frame)
    values: dict[str, list[Array]] = {"hota": [], "deta": [], "assa": []}
    for alpha in _ALPHAS:
        kept = best[tracked.similarity[best] >= alpha - EPSILON]
        count = np.bincount(code[kept], minlength=len(pairs[0]))
        association = count / np.maximum(1, size_v[pairs[0]] + size_t[pairs[1]] - count)
        frame = tracked.frame[tracked.i[kept]]
        tp = blocks.totals(frame)
        associated = blocks.totals(frame, association[code[kept]])
        values["deta"].append(divide(tp, all_points - tp))
        values["assa"].append(associated / np.maximum(tp, 1))
        values["hota"].append(np.sqrt(divide(associated, all_points - tp)))
    return {name: blocks.score(np.mean(each, axis=0)) for name, each in values.items()}


def _end_to_end(paired: Paired, blocks: Blocks, params: EvaluationParams) -> dict[str, Any]:
    """Return shares of the vehicles with enough sightings; a vehicle belongs to the block it is first seen in.

    ``end_to_end``: all its sightings, missed ones too, on one track that holds nothing else. ``found_on_one_track``:
    all that were found. ``first_to_last``: the first and the last sighting on the same track.
    """
    true = paired.true[paired.true["wanted"]]
    owner = paired.found["vehicle_id"].to_numpy(object)
    owned = np.where(true["row"] >= 0, owner[true["row"].to_numpy()], None) if len(owner) else np.full(len(true), None)
    points = paired.found[(paired.found["verdict"] != NEUTRAL) & paired.found["vehicle_id"].notna()]
    size_t = points["vehicle_id"].value_counts()
    seen = pd.DataFrame(
        {"vehicle": true["vehicle"].to_numpy(object), "frame": true["frame"].to_numpy(), "track": owned}
    )
    seen["found"] = (true["row"] >= 0).to_numpy()
    seen["size"] = seen["track"].map(size_t)
    by = seen.sort_values("frame").groupby("vehicle", sort=True)
    each = pd.DataFrame({"first_frame": by["frame"].first(), "sightings": by.size(), "found": by["found"].sum()})
    on_track = by["track"].count()
    alone = (by["track"].nunique() == 1) & (by["size"].max() == on_track)
    each["whole"] = alone & (on_track == each["sightings"])
    each["of_found"] = alone & (on_track == each["found"])
    first, last = by["track"].nth(0), by["track"].nth(-1)
    ends = pd.DataFrame(
        {
            "first": first.set_axis(seen.loc[first.index, "vehicle"]),
            "last": last.set_axis(seen.loc[last.index, "vehicle"]),
        }
    )
    each["ends"] = (ends["first"].notna() & (ends["first"] == ends["last"])).reindex(each.index)
    each = each[each["sightings"] >= params.least_sightings]
    frame = each["first_frame"].to_numpy(np.int64)
    count = blocks.totals(frame)
    return {
        "vehicles_for_end_to_end": len(each),
        "end_to_end": blocks.ratio(blocks.totals(frame, each["whole"].to_numpy(float)), count),
        "found_on_one_track": blocks.ratio(blocks.totals(frame, each["of_found"].to_numpy(float)), count),
        "first_to_last": blocks.ratio(blocks.totals(frame, each["ends"].to_numpy(float)), count),
    }


def _couples(vehicle: Index, track: Index) -> tuple[tuple[Index, Index], Index, Index]:
    """Return the distinct (vehicle, track), the number of each row's couple, and how often each occurs."""
    base = int(track.max(initial=0)) + 1
    distinct, code, count = np.unique(vehicle * base + track, return_inverse=True, return_counts=True)
    return (distinct // base, distinct % base), code, count


def identity_calibration(
    result: Result, paired: Paired, blocks: Blocks, params: EvaluationParams
) -> dict[str, Any] | None:
    """Return how true ``identity_probability`` is: how often all sightings of a track are one vehicle, by what it says.

    Tracks without a sighting that can be judged, and parked ones, are left out; a track belongs to the block in which
    it is first seen. None where no probability is stated.
    """
    stated = result.trajectories.dropna(subset=["identity_probability"])
    found = with_names(paired)
    judged = found[(found["name"] != "") & ~found["parked"] & found["vehicle_id"].notna()]
    by = judged.sort_values("frame").groupby("vehicle_id", sort=True)
    each = pd.DataFrame({"frame": by["frame"].first(), "names": by["name"].nunique(), "on": by["vehicle"].count()})
    each["size"] = by.size()
    each = each.join(stated.drop_duplicates("vehicle_id").set_index("vehicle_id")["identity_probability"], how="inner")
    right = ((each["names"] == 1) & (each["on"] == each["size"])).to_numpy()
    stated_p = each["identity_probability"].to_numpy(float)
    return calibration(each["frame"].to_numpy(np.int64), stated_p, right, blocks, least=params.least_probability)
