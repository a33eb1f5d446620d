"""Chains of plain pair matches: what a pair matcher gives without prediction or coasting, for comparison."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.match import match
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.matching.vehicles import COLOUR
from vtrack_batch.tracking.link import Chains
from vtrack_batch.tracking.sightings import Sightings


def chain_pairs(s: Sightings, method: str, matching: MatchingParams, flow_map: FlowMap | None) -> Chains:
    """Match every two successive frames by *method* and join the links; a miss ends a chain."""
    n = len(s)
    after, before, probability, none_before = np.full(n, -1), np.full(n, -1), np.ones(n), np.ones(n)
    columns = {"detection_id": np.arange(n), "x_m": s.xy[:, 0], "y_m": s.xy[:, 1]}
    rows = pd.DataFrame(columns if s.rgb is None else columns | dict(zip(COLOUR, s.rgb.T, strict=True)))
    for f in range(len(s.frame_s) - 1):
        earlier, later = rows.iloc[s.first[f] : s.first[f + 1]], rows.iloc[s.first[f + 1] : s.first[f + 2]]
        elapsed_s = float(s.frame_s[f + 1] - s.frame_s[f])
        found = match(earlier, later, elapsed_s=elapsed_s, method=method, flow_map=flow_map, params=matching)
        i, k = found["detection_id_from"], found["detection_id_to"]
        both = i.notna() & k.notna()
        probability[i[k.isna()].astype(int)] = found["probability"][k.isna()]
        none_before[k[i.isna()].astype(int)] = found["probability"][i.isna()]
        # one-way methods may give a vehicle to several others: the surest keeps it
        links = found[both].sort_values(["probability", "detection_id_from"], ascending=[False, True])
        links = links.drop_duplicates("detection_id_to")
        i, k = links["detection_id_from"].astype(int), links["detection_id_to"].astype(int)
        after[i], before[k], probability[i] = k, i, links["probability"]
    return Chains(after, before, probability, none_before)
