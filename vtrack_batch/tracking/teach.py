"""The sequence as its own teacher: where no flow map is given, sure links of one round are the map of the next.

The first window of a sequence is linked twice: without a map (where it is long, only its beginning), then with the map
that its own sure links make. Every later window is linked once, with the map of the window before, which holds none of
its own motions, and with the spreads of colour that were found there; what was judged there of frames that both windows
hold is taken over. Of a large map an even sample is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.params import ColourParams, MatchingParams
from vtrack_batch.tracking.edges import Judged
from vtrack_batch.tracking.identity import calibrated_probability
from vtrack_batch.tracking.learn import LEAST_SIGHTINGS, SURE, flow_of
from vtrack_batch.tracking.link import Chains, colour_of, link
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.tracking.sightings import Sightings, of_frames

MOST_MOTIONS = 30_000  # more motions of one place say no more, and take longer to ask
FIRST_SIGHTINGS = 60_000  # of the first window so many are linked without a map: they make a first map that is as large


@dataclass
class Taught:
    """Links the windows of one sequence in their order; ``flow_map`` is the one given, or what was taught so far."""

    matching: MatchingParams
    params: TrackingParams
    flow_map: FlowMap | None

    def __post_init__(self) -> None:
        self.teaches = self.flow_map is None and self.params.link.self_taught
        self.colour: ColourParams | None = None
        self.judged = Judged()

    def __call__(self, s: Sightings) -> Chains:
        """Return the chains of a window."""
        if self.teaches and self.flow_map is None:
            beginning = of_frames(s, 0, _frames_with(s, FIRST_SIGHTINGS))
            self.flow_map = _some(flow_of(beginning, link(beginning, self.matching, self.params)))
        chains = link(s, self.matching, self.params, self.flow_map, colour=self.colour, judged=self.judged)
        self.colour = colour_of(s, chains, self.matching.colour)
        if self.teaches:
            self.flow_map = _some(flow_of(s, chains))
        return chains


def flow_of_tables(detections: pd.DataFrame, track_points: pd.DataFrame, matches: pd.DataFrame) -> FlowMap | None:
    """Return the map that the sure ``matches`` between successive frames make; None where there are none.

    *detections* tell the places; matches on tracks of few sightings teach nothing.
    """
    seen = track_points.dropna(subset=["detection_id"])
    followed = seen.groupby("vehicle_id")["detection_id"].transform("size") >= LEAST_SIGHTINGS
    place = detections.set_index("detection_id")[["x_m", "y_m"]]
    place = place[place.index.isin(seen.loc[followed, "detection_id"])]
    ends = matches["detection_id_from"].isin(place.index) & matches["detection_id_to"].isin(place.index)
    sure = matches[ends & (matches["probability"] > calibrated_probability(SURE))]
    elapsed_s = (sure["t_to_utc"] - sure["t_from_utc"]).dt.total_seconds().to_numpy(float)
    start, end = (place.loc[sure[f"detection_id_{side}"]].to_numpy(float) for side in ("from", "to"))
    successive = elapsed_s < 1.5 * np.median(elapsed_s) if len(sure) else np.zeros(0, bool)
    return _some(FlowMap(start[successive], ((end - start) / elapsed_s[:, None])[successive]))


def _frames_with(s: Sightings, most: int) -> int:
    """Return how many frames at the beginning have *most* sightings; two at least, if there are."""
    return min(len(s.frame_s), max(2, int(np.searchsorted(s.first, most, side="right")) - 1))


def _some(learned: FlowMap) -> FlowMap | None:
    """Return the map, thinned evenly where it is large; None where it is empty."""
    every = max(1, -(-len(learned.xy) // MOST_MOTIONS))
    return FlowMap(learned.xy[::every], learned.velocity[::every]) if len(learned.xy) else None
