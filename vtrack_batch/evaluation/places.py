"""The result's names of places in the truth's words, where the result had to propose its own."""

from __future__ import annotations

import pandas as pd

from vtrack_batch.evaluation.pairing import Paired
from vtrack_batch.evaluation.sides import ENDS_NOT_PLACES, Result, Truth


def places_of(table: pd.DataFrame) -> set[str]:
    """Return the known places that *table* names as origin or destination."""
    return {*table["origin"].dropna(), *table["destination"].dropna()} - set(ENDS_NOT_PLACES)


def place_names(result: Result, truth: Truth, paired: Paired) -> dict[str, str]:
    """Return, for each place of the result, the true place: itself where the names agree, else by majority.

    A place that the truth does not know is given the true place at which most of its vehicles really started (as an
    origin) or ended (as a destination); who they really are is what *paired* says of most of their sightings. Several
    places may go to one. Without such vehicles a place keeps its name, and counts as wrong.
    """
    found = places_of(result.od_pairs) | places_of(result.trajectories)
    names = {place: place for place in sorted(found)}
    if found <= places_of(truth.od_pairs) | places_of(truth.trajectories):
        return names
    votes = _votes(result, truth, paired)
    counted = votes.groupby(["found", "true"], sort=True).size().rename("votes").reset_index()
    best = counted.sort_values(["found", "votes", "true"], ascending=[True, False, True]).drop_duplicates("found")
    return names | dict(zip(best["found"], best["true"], strict=True))


def _votes(result: Result, truth: Truth, paired: Paired) -> pd.DataFrame:
    """Return one row per end of a track at a known place, with the true place of its vehicle at that end."""
    seen = paired.found.dropna(subset=["vehicle_id", "vehicle"])
    counted = seen.groupby(["vehicle_id", "vehicle"], sort=True).size().rename("points").reset_index()
    counted = counted.sort_values(["vehicle_id", "points", "vehicle"], ascending=[True, False, True])
    who = counted.drop_duplicates("vehicle_id")[["vehicle_id", "vehicle"]]
    ends = result.trajectories[["vehicle_id", "origin", "destination"]].merge(who, on="vehicle_id")
    true = truth.trajectories[["vehicle_id", "origin", "destination"]].rename(columns={"vehicle_id": "vehicle"})
    ends = ends.merge(true, on="vehicle", suffixes=("", "_true"))
    both = [
        ends[[end, f"{end}_true"]].set_axis(["found", "true"], axis=1).astype(object)
        for end in ("origin", "destination")
    ]
    votes = pd.concat(both).dropna()
    return votes[~votes["found"].isin(ENDS_NOT_PLACES) & ~votes["true"].isin(ENDS_NOT_PLACES)]
