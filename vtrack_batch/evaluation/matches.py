"""Are the matches right, and their probabilities true? The table ``matches`` itself, before any track is cut of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.evaluation.assignment import Index
from vtrack_batch.evaluation.blocks import Array, Blocks
from vtrack_batch.evaluation.calibration import calibration
from vtrack_batch.evaluation.links import NOBODY, following, label_rates, with_names
from vtrack_batch.evaluation.pairing import Paired
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.sides import Result

_STEPS = 1e-6
"""Seconds by which equal spans may differ in floating point."""


def match_scores(
    result: Result, paired: Paired, frames: pd.DataFrame, blocks: Blocks, params: EvaluationParams
) -> dict[str, Any] | None:
    """Return label rates, link precision and recall, and the calibration of links and of ends; None without matches.

    A link is right when its later end is the very next sighting found of the vehicle at its earlier end, however many
    frames between them missed it. An end (one side null) is right when the vehicle has no other sighting found on that
    side within the longest time that any link of the result spans. Links of parked vehicles, and what cannot be judged,
    are left out, as for the links of tracks. Calibration is also told of links whose both ends lie on moving vehicles,
    so that the matcher's doubts are seen apart from the detector's false alarms.
    """
    if result.matches.empty:
        return None
    found = with_names(paired)
    at = pd.Series(found["at"].to_numpy(), index=found["detection_id"].to_numpy(object))
    at = at[~at.index.duplicated()]
    order = ["detection_id_from", "detection_id_to"]
    rows = result.matches.sort_values(order, na_position="last")
    ends = [rows[name].map(at).fillna(NOBODY).to_numpy(np.int64) for name in order]
    probability = rows["probability"].to_numpy(float, na_value=np.nan)
    both = (ends[0] >= 0) & (ends[1] >= 0)
    named = _Named(found, frames["t_s"].to_numpy(float))
    links = _links(named, ends[0][both], ends[1][both], probability[both])
    judged = links[links["judged"]]
    frame, right = judged["frame"].to_numpy(int), judged["right"].to_numpy(bool)
    stated = judged["probability"].to_numpy()
    between = named.vehicle[judged["from"]] & named.vehicle[judged["to"]]
    true_next = np.flatnonzero((named.after >= 0) & found["vehicle"].notna().to_numpy())
    linked = np.zeros(len(found), bool)
    linked[judged.loc[judged["right"], "from"]] = True
    horizon_s = _horizon_s(links, named, frames)
    lone = _lone_ends(rows, ends, probability, named, horizon_s)
    partner, before = _partners(links, following(frames), len(found))
    could = found["frame"].to_numpy(int)[true_next]
    least = params.least_probability
    return {
        **label_rates(found, partner, before, following(frames), blocks),
        "links": len(judged),
        "precision": blocks.ratio(blocks.totals(frame, right), blocks.totals(frame)),
        "recall": blocks.ratio(blocks.totals(could, linked[true_next]), blocks.totals(could)),
        "calibration_of_links": calibration(frame, stated, right, blocks, least=least),
        "calibration_between_vehicles": calibration(
            frame[between], stated[between], right[between], blocks, least=least
        ),
        "calibration_of_ends": calibration(*lone, blocks, least=least),
    }


class _Named:
    """Sightings with the names of who they are: ``after``, ``before`` (n,) are the same vehicle's next and last one."""

    def __init__(self, found: pd.DataFrame, t_s: Array) -> None:
        self.frame, self.name = found["frame"].to_numpy(int), found["name"].to_numpy(object)
        self.parked, self.vehicle = found["parked"].to_numpy(bool), found["vehicle"].notna().to_numpy()
        self.t_s = t_s[self.frame]
        order = np.lexsort((self.frame, pd.factorize(found["name"])[0]))
        same = self.vehicle[order[:-1]] & (self.name[order[:-1]] == self.name[order[1:]])
        self.after, self.before = np.full(len(found), NOBODY), np.full(len(found), NOBODY)
        self.after[order[:-1][same]] = order[1:][same]
        self.before[order[1:][same]] = order[:-1][same]


def _links(named: _Named, i: Index, k: Index, probability: Array) -> pd.DataFrame:
    """Return one row a link: ``from``, ``to``, the frames of both, ``right``, and whether it is ``judged``."""
    judged = (named.name[i] != "") & (named.name[k] != "") & ~(named.parked[i] & named.parked[k])
    return pd.DataFrame(
        {
            "from": i,
            "to": k,
            "frame": named.frame[i],
            "frame_to": named.frame[k],
            "probability": probability,
            "right": named.after[i] == k,
            "judged": judged.astype(bool),
        }
    )


def _horizon_s(links: pd.DataFrame, named: _Named, frames: pd.DataFrame) -> float:
    """Return the longest time that a link spans; without links, the usual time between frames."""
    spans = named.t_s[links["to"]] - named.t_s[links["from"]]
    between = np.diff(np.unique(frames["t_s"].to_numpy(float)))
    usual = float(np.median(between)) if len(between) else 0.0
    return max(float(spans.max(initial=0.0)), usual) + _STEPS


def _lone_ends(
    rows: pd.DataFrame, ends: list[Index], probability: Array, named: _Named, horizon_s: float
) -> tuple[Index, Array, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Return frame, probability and truth of the rows that say: no partner."""
    parts = []
    for here, other, column in ((0, named.after, "detection_id_to"), (1, named.before, "detection_id_from")):
        alone = rows[column].isna().to_numpy() & (ends[here] >= 0)
        at = ends[here][alone]
        away_s = np.where(other[at] >= 0, np.abs(named.t_s[other[at]] - named.t_s[at]), np.inf)
        judged = (named.name[at] != "") & ~named.parked[at]
        parts.append((named.frame[at][judged], probability[alone][judged], (away_s > horizon_s)[judged]))
    frame, stated, right = (np.concatenate(part) for part in zip(*parts, strict=True))
    return frame, stated, right


def _partners(links: pd.DataFrame, next_frame: Index, count: int) -> tuple[Index, Index]:
    """Return who each of *count* sightings was given in the next frame, and in the one before; -1 = nobody.

    Where rivals claim one sighting, as one-way methods allow, its own partner is the most probable of them.
    """
    step = links[next_frame[links["frame"].to_numpy(int)] == links["frame_to"].to_numpy(int)]
    step = step.sort_values(["probability", "from", "to"], ascending=[False, True, True])
    partner, before = np.full(count, NOBODY), np.full(count, NOBODY)
    for given, here, there in ((partner, "from", "to"), (before, "to", "from")):
        chosen = step.drop_duplicates(here)
        given[chosen[here]] = chosen[there]
    return partner, before
