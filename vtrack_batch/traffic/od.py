"""Where each vehicle came from and went to, and how many went between each pair.

Trips begin and end at gates and zones (at approaches where there are neither). For one trajectory, all its visits to
zones and crossings of gates are put in order of time, and

* its **origin** is the place that it left first: a zone that it starts in or passes out of, or a gate that it crosses
  inwards. If the first thing that happens is that it leaves by a gate, or comes to rest in a zone, it came from inside;
* its **destination** is the place that it reached last: a zone that it ends in or passes through, or a gate that it
  crosses outwards. If the last thing that happens is that it comes in by a gate, or leaves the zone that it began in,
  it went to somewhere inside;
* a single zone passed on the way, with nothing else, counts for the end of the path that is nearer to it;
* a trajectory that never leaves one zone came from it only if it entered the view there, and went to it only if it left
  the view there: whoever waits at a red light at the border of the view from the first frame on may have come from
  anywhere;
* somewhere inside is **unknown**. A trajectory that starts parked comes from **parked**, whatever place it stands in,
  and likewise at its end;
* of zones one inside another, the one left first (reached last) counts.

So each trajectory has one origin and one destination, and the counts of a bin add up to the trajectories that start in
it. A trip starts at the time at which it leaves its origin, or is first seen if that is unknown or parked.

Where identity is uncertain (``identity_probability`` p), the trip counts p, and the rest, 1 - p, goes from the same
origin to unknown: the vehicle was seen there, but what arrived elsewhere may be another one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from vtrack_batch.traffic.bins import SECOND_US, Bins
from vtrack_batch.traffic.coverage import Coverage, status_of
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.paths import Paths
from vtrack_batch.traffic.places import Place, names_of, trip_ends
from vtrack_batch.traffic.tables import blank_where, cell_of, counted, grid, with_all_classes

UNKNOWN, PARKED = "unknown", "parked"


def trips_of(
    vehicles: pd.DataFrame, paths: Paths, places: Sequence[Place], crossings: pd.DataFrame, visits: pd.DataFrame
) -> pd.DataFrame:
    """Return one row per row of *vehicles*: origin, destination (ids), t_origin_us, travel_time_s (NaN if not known).

    *vehicles* needs t_first_us, t_last_us, starts_parked, ends_parked; it is indexed by the paths' vehicle number.
    """
    ends = trip_ends(places)
    items = _items(places, crossings[crossings["place"].isin(ends)], visits[visits["place"].isin(ends)])
    items = _never_left(_nearer_end(items, paths), vehicles)
    first = items.sort_values(["vehicle", "t_out_us", "place"], kind="stable").drop_duplicates("vehicle")
    last = items.sort_values(["vehicle", "t_in_us", "place"], kind="stable").drop_duplicates("vehicle", keep="last")
    first = first[first["leaves"]].set_index("vehicle").reindex(vehicles.index)
    last = last[last["reaches"]].set_index("vehicle").reindex(vehicles.index)
    ids = names_of(places)
    origin = first["place"].map(ids).astype("object").fillna(UNKNOWN).mask(vehicles["starts_parked"], PARKED)
    destination = last["place"].map(ids).astype("object").fillna(UNKNOWN).mask(vehicles["ends_parked"], PARKED)
    left = first["t_out_us"].mask(vehicles["starts_parked"])
    reached = last["t_in_us"].mask(vehicles["ends_parked"])
    # A path prolonged beyond its sightings may leave its origin before the first frame: the trip starts in view.
    t_origin = np.clip(left.fillna(vehicles["t_first_us"]), vehicles["t_first_us"], vehicles["t_last_us"])
    travel_time = (reached - left) / SECOND_US
    return pd.DataFrame(
        {
            "origin": origin,
            "destination": destination,
            "t_origin_us": t_origin.astype("int64"),
            "travel_time_s": travel_time.where(travel_time > 0),
        }
    )


def od_pairs(
    vehicles: pd.DataFrame, trips: pd.DataFrame, places: Sequence[Place], *, coverage: Coverage, params: TrafficParams
) -> pd.DataFrame:
    """Return the table ``od_pairs``: every pair in every bin for class ``all``, and single classes of pairs that occur.

    A pair is observed while both places are in view at once; unknown and parked are, while anything is.
    """
    events = with_all_classes(_events(vehicles, trips, coverage.bins))
    ends = trip_ends(places)
    names = [*(places[i].id for i in ends), PARKED, UNKNOWN]
    keys = ["origin", "destination", "vehicle_class"]
    pairs = pd.MultiIndex.from_product([names, names, ["all"]], names=keys).to_frame(index=False)
    pairs = pd.concat([pairs, events[keys]]).drop_duplicates(ignore_index=True)
    cells = grid(pairs, coverage.bins)
    cells = counted(cells, events, [*keys, "bin"], uncertain=bool(vehicles["uncertain"].any()))
    cells = _with_travel_time(cells, events, [*keys, "bin"])
    index = dict(zip(names, [*ends, len(places), len(places)], strict=True))
    seconds = coverage.pair_seconds()
    observed_s = seconds[cells["bin"], cells["origin"].map(index), cells["destination"].map(index)]
    some = cells["count"].to_numpy() > 0
    status = status_of(observed_s, cells["bin_s"].to_numpy(), some, params=params)
    cells = cells.assign(observed_s=observed_s, status=status)
    return blank_where(cells, status == "not_observed", ["count", "count_lo", "count_hi"])


def _items(places: Sequence[Place], crossings: pd.DataFrame, visits: pd.DataFrame) -> pd.DataFrame:
    """Return visits and crossings as one list; ``leaves`` = may be an origin, ``reaches`` = may be a destination."""
    inward = np.array([place.inward for place in places], int)
    enters = crossings["forward"].to_numpy(bool) == (inward[crossings["place"].to_numpy(int)] > 0)
    gates = pd.DataFrame(
        {
            "vehicle": crossings["vehicle"],
            "place": crossings["place"],
            "t_in_us": crossings["t_us"],
            "t_out_us": crossings["t_us"],
            "way_in_m": crossings["way_m"],
            "way_out_m": crossings["way_m"],
            "passes": False,
            "never_left": False,
            "leaves": enters,
            "reaches": ~enters,
        }
    )
    begins, ends = visits["begins"].to_numpy(bool), visits["ends"].to_numpy(bool)
    shared = ["vehicle", "place", "t_in_us", "t_out_us", "way_in_m", "way_out_m"]
    zones = visits[shared].assign(
        passes=~begins & ~ends, never_left=begins & ends, leaves=begins | ~ends, reaches=ends | ~begins
    )
    filled = [part for part in (gates, zones) if len(part)]
    return pd.concat(filled, ignore_index=True) if filled else gates


def _nearer_end(items: pd.DataFrame, paths: Paths) -> pd.DataFrame:
    """Let a zone that is all that a path passes through count only for the end of the path that is nearer to it."""
    first, last = paths.ends
    start = pd.Series(paths.along_m[first], index=paths.vehicle[first])
    stop = pd.Series(paths.along_m[last], index=paths.vehicle[last])
    before = items["way_in_m"] - items["vehicle"].map(start)
    after = items["vehicle"].map(stop) - items["way_out_m"]
    alone = items["passes"] & ~items["vehicle"].duplicated(keep=False)
    return items.assign(
        leaves=items["leaves"] & ~(alone & (before > after)), reaches=items["reaches"] & ~(alone & (before <= after))
    )


def _never_left(items: pd.DataFrame, vehicles: pd.DataFrame) -> pd.DataFrame:
    """Let a zone that a vehicle never left count for the ends at which the view begins or ends there."""
    numbers = items["vehicle"].to_numpy(int)
    entered = (vehicles["start_reason"] == "entered_view").to_numpy(bool)[numbers]
    left = (vehicles["end_reason"] == "left_view").to_numpy(bool)[numbers]
    elsewhere = ~items["never_left"].to_numpy(bool)
    return items.assign(leaves=items["leaves"] & (elsewhere | entered), reaches=items["reaches"] & (elsewhere | left))


def _events(vehicles: pd.DataFrame, trips: pd.DataFrame, bins: Bins) -> pd.DataFrame:
    """Return the trips with their weight and bin, and the doubtful rest of each as a trip to unknown."""
    events = trips.assign(vehicle_class=vehicles["vehicle_class"], bin=bins.index(trips["t_origin_us"].to_numpy()))
    known = events["destination"] != UNKNOWN
    events["weight"] = vehicles["probability"].where(known, 1.0)
    rest = events[known & (events["weight"] < 1)]
    rest = rest.assign(destination=UNKNOWN, weight=1 - rest["weight"], travel_time_s=np.nan)
    return pd.concat([events, rest], ignore_index=True) if len(rest) else events.reset_index(drop=True)


def _with_travel_time(cells: pd.DataFrame, events: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    timed = events[events["travel_time_s"].notna()]
    median = timed["travel_time_s"].groupby(cell_of(cells, timed, keys)).median()
    return cells.assign(median_travel_time_s=median.reindex(np.arange(len(cells))).to_numpy())
