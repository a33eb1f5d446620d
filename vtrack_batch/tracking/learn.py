"""Learn the flow map of a place from its own tracks, without truth."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.tracking.link import Chains, link
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.tracking.paths import chain_numbers
from vtrack_batch.tracking.sightings import Sightings, read_detections, sightings_of

SURE = 0.95  # links of less belief teach nothing
LEAST_SIGHTINGS = 4


def learn_flow(
    detections: pd.DataFrame, *, matching: MatchingParams | None = None, params: TrackingParams | None = None
) -> FlowMap:
    """Return the flow map that a table of detections shows: the sure links of tracks found without a map.

    *detections* as for ``track``; best taken at the interval at which the map will be used.
    """
    matching, params = matching or MatchingParams(), params or TrackingParams()
    checked = read_detections(detections)
    maps = []
    for name, rows in checked.groupby("sequence", sort=True, observed=True):
        s = sightings_of(rows, str(name), None, params.motion.position_sigma_m)
        maps.append(flow_of(s, link(s, matching, params)))
    if not maps:
        return FlowMap(np.zeros((0, 2)), np.zeros((0, 2)))
    return FlowMap(np.vstack([m.xy for m in maps]), np.vstack([m.velocity for m in maps]))


def flow_of(s: Sightings, chains: Chains) -> FlowMap:
    """Return the motions of the sure links between successive frames of chains that are long enough."""
    chain = chain_numbers(chains.before)
    long = np.bincount(chain)[chain] >= LEAST_SIGHTINGS if len(chain) else np.zeros(0, bool)
    successive = s.frame[chains.after] == s.frame + 1
    i = np.flatnonzero((chains.after >= 0) & successive & long & (chains.probability > SURE))
    k = chains.after[i]
    return FlowMap(s.xy[i], (s.xy[k] - s.xy[i]) / (s.t[k] - s.t[i])[:, None])
