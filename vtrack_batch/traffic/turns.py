"""Which way vehicles turned at junctions.

A vehicle **enters** by an arm when it leaves that area towards the junction (its distance from the centre shrinks over
the visit by a fair part of the way it went there), or crosses that line inwards; it **exits** by an arm in the
opposite way. Among its events at one junction in order of time, a turn leads from the first of a run of entries to the
last of the run of exits that follows (arms whose corner is clipped on the way lie between), and belongs to the time of
entry. An entry that no exit follows is a turn ``unknown``: the vehicle was lost, stayed inside, or the data ended; the
shares are those of the turns that are known.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from vtrack_batch.traffic.bins import Bins
from vtrack_batch.traffic.coverage import Coverage, status_of
from vtrack_batch.traffic.intervals import wilson_intervals
from vtrack_batch.traffic.junctions import Junction
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.paths import Floats
from vtrack_batch.traffic.places import Place
from vtrack_batch.traffic.tables import blank_where, counted, grid, per_hour, with_all_classes

UNKNOWN = "unknown"
_RADIAL = 0.3
_APPROACH = ["junction", "approach", "vehicle_class", "bin"]


def turns_made(
    junctions: Sequence[Junction], places: Sequence[Place], crossings: pd.DataFrame, visits: pd.DataFrame
) -> pd.DataFrame:
    """Return one row per vehicle and entry, by vehicle and time: vehicle, junction, approach (ids), movement, t_us."""
    parts = [_turns_at(junction, places, crossings, visits) for junction in junctions]
    empty = pd.DataFrame({name: [] for name in ("vehicle", "junction", "approach", "movement", "t_us")}, dtype=object)
    filled = [part for part in parts if len(part)]
    turns = pd.concat(filled, ignore_index=True) if filled else empty.astype({"vehicle": "int64", "t_us": "int64"})
    return turns.sort_values(["vehicle", "t_us", "junction"], kind="stable", ignore_index=True)


def turns_table(
    vehicles: pd.DataFrame,
    turns: pd.DataFrame,
    junctions: Sequence[Junction],
    places: Sequence[Place],
    *,
    coverage: Coverage,
    params: TrafficParams,
) -> pd.DataFrame:
    """Return the table ``turns``: every movement in every bin for class ``all``, and single classes that occur.

    A movement is observed while its approach and all arms that it may lead to are in view at once. The uncertain part
    of a turn (1 - ``identity_probability``) counts as unknown.
    """
    events = with_all_classes(_events(vehicles, turns, coverage.bins))
    keys = ["junction", "approach", "movement", "vehicle_class"]
    arms = _arms_of_movements(junctions, places)
    possible = pd.DataFrame([(*movement, "all") for movement in arms], columns=keys)
    cells = grid(pd.concat([possible, events[keys]]).drop_duplicates(ignore_index=True), coverage.bins)
    cells = counted(cells, events, [*keys, "bin"], uncertain=bool(vehicles["uncertain"].any()))
    cells = _with_shares(cells)
    cells = cells.assign(observed_s=_observed(cells, arms, coverage))
    observed_s, count = cells["observed_s"].to_numpy(), cells["count"].to_numpy()
    status = status_of(observed_s, cells["bin_s"].to_numpy(), count > 0, params=params)
    cells = cells.assign(rate_vph=per_hour(count, observed_s), status=status)
    return blank_where(cells, status == "not_observed", ["count", "count_lo", "count_hi"])


def _turns_at(
    junction: Junction, places: Sequence[Place], crossings: pd.DataFrame, visits: pd.DataFrame
) -> pd.DataFrame:
    events = pd.concat([_line_events(junction, places, crossings), _area_events(junction, visits)])
    usable_in = {entry for entry, _ in junction.movement}
    usable_out = {leaving for _, leaving in junction.movement}
    usable = np.where(events["enters"], events["place"].isin(usable_in), events["place"].isin(usable_out))
    events = events[usable].sort_values(["vehicle", "t_us", "place"], kind="stable", ignore_index=True)
    vehicle, enters, place = (events[name].to_numpy() for name in ("vehicle", "enters", "place"))
    run = np.flatnonzero(np.r_[True, (vehicle[1:] != vehicle[:-1]) | (enters[1:] != enters[:-1])])[: len(events)]
    end = np.r_[run[1:], len(events)][: len(run)] - 1
    entry = np.flatnonzero(enters[run].astype(bool))
    followed = np.append(vehicle[run], -1)[entry + 1] == vehicle[run[entry]]
    made, leaving = run[entry], place[np.append(end, 0)[np.where(followed, entry + 1, -1)]]
    movement = [
        junction.movement.get((int(a), int(b)), UNKNOWN) if on else UNKNOWN
        for a, b, on in zip(place[made], leaving, followed, strict=True)
    ]
    return pd.DataFrame(
        {
            "vehicle": vehicle[made],
            "junction": junction.id,
            "approach": [places[i].id for i in place[made]],
            "movement": movement,
            "t_us": events["t_us"].to_numpy()[made],
        }
    )


def _line_events(junction: Junction, places: Sequence[Place], crossings: pd.DataFrame) -> pd.DataFrame:
    at = crossings[crossings["place"].isin(junction.arms)]
    inward = np.array([place.inward for place in places], int)[at["place"].to_numpy(int)]
    enters = at["forward"].to_numpy(bool) == (inward > 0)
    return at[["vehicle", "place", "t_us"]].assign(enters=enters)


def _area_events(junction: Junction, visits: pd.DataFrame) -> pd.DataFrame:
    at = visits[visits["place"].isin(junction.arms)]
    nearer = _distance(at, "in", junction.centre) - _distance(at, "out", junction.centre)
    least = _RADIAL * (at["way_out_m"] - at["way_in_m"])
    shared = at[["vehicle", "place"]]
    entries = shared.assign(t_us=at["t_out_us"], enters=True)[(nearer > least) & ~at["ends"]]
    exits = shared.assign(t_us=at["t_in_us"], enters=False)[(-nearer > least) & ~at["begins"]]
    return pd.concat([entries, exits])


def _distance(visits: pd.DataFrame, end: str, centre: tuple[float, float]) -> Floats:
    return np.hypot(visits[f"x_{end}_m"] - centre[0], visits[f"y_{end}_m"] - centre[1])


def _events(vehicles: pd.DataFrame, turns: pd.DataFrame, bins: Bins) -> pd.DataFrame:
    """Return the turns with class, bin and weight, and the doubtful rest of each as one to unknown."""
    vehicle = turns["vehicle"].to_numpy(int)
    probability = vehicles["probability"].to_numpy()[vehicle]
    events = turns.assign(
        vehicle_class=vehicles["vehicle_class"].to_numpy()[vehicle],
        bin=bins.index(turns["t_us"].to_numpy(np.int64)),
        weight=np.where(turns["movement"] == UNKNOWN, 1.0, probability),
    )
    rest = events[events["weight"] < 1]
    rest = rest.assign(movement=UNKNOWN, weight=1 - rest["weight"])
    return pd.concat([events, rest], ignore_index=True) if len(rest) else events


def _arms_of_movements(
    junctions: Sequence[Junction], places: Sequence[Place]
) -> dict[tuple[str, str, str], tuple[int, ...]]:
    """Return for each (junction, approach, movement) the places that must be in view to see it."""
    arms: dict[tuple[str, str, str], tuple[int, ...]] = {}
    for junction in junctions:
        for (entry, leaving), movement in junction.movement.items():
            name = (junction.id, places[entry].id, movement)
            arms[name] = (*arms.get(name, (entry,)), leaving)
            arms[junction.id, places[entry].id, UNKNOWN] = (entry,)
    return arms


def _observed(cells: pd.DataFrame, arms: dict[tuple[str, str, str], tuple[int, ...]], coverage: Coverage) -> Floats:
    names = list(arms)
    seconds = np.array([coverage.seconds(*arms[name]) for name in names]).reshape(len(names), len(coverage.bins))
    number = pd.Series(np.arange(len(names)), index=pd.MultiIndex.from_tuples(names)) if names else pd.Series(dtype=int)
    of_cell = pd.MultiIndex.from_frame(cells[["junction", "approach", "movement"]])
    return seconds[number.reindex(of_cell).to_numpy(int), cells["bin"]] if len(cells) else np.empty(0)


def _with_shares(cells: pd.DataFrame) -> pd.DataFrame:
    """Add the share of each known movement among the known ones of its approach, class and bin."""
    known = cells["movement"].to_numpy() != UNKNOWN
    count = cells["count"].to_numpy(float)
    total = cells.assign(known=np.where(known, count, 0.0)).groupby(_APPROACH)["known"].transform("sum").to_numpy()
    trials = np.where(known, total, 0.0)
    lo, hi = wilson_intervals(count, trials)
    share = np.divide(count, trials, out=np.full(len(cells), np.nan), where=trials > 0)
    return cells.assign(share=share, share_lo=lo, share_hi=hi)
