"""laptrack: Jaqaman's two linear assignments, frame to frame and across gaps; colour as further coordinates."""

import networkx as nx
import numpy as np
from laptrack import LapTrack
from shapes import linked


def run(tables, settings):
    """Link every sequence."""
    return linked(tables, settings, link)


def link(frames, interval_s, *, reach_mps, metres_per_level=0.0, gaps=0):
    """Link by squared distance in (x, y, scaled r, g, b)."""
    reach = max(reach_mps * interval_s, 2.0)
    places = [
        f["xy"] if f["rgb"] is None or not metres_per_level else np.hstack([f["xy"], metres_per_level * f["rgb"]])
        for f in frames
    ]
    tracker = LapTrack(
        metric="sqeuclidean",
        cutoff=reach**2,
        gap_closing_cutoff=(2 * reach) ** 2 if gaps else False,
        gap_closing_max_frame_count=max(gaps, 1),
        splitting_cutoff=False,
        merging_cutoff=False,
    )
    graph = tracker.predict(places)
    tracks = [np.full(len(p), -1) for p in places]
    for number, nodes in enumerate(nx.connected_components(graph.to_undirected())):
        for frame, index in nodes:
            tracks[frame][index] = number
    return tracks
