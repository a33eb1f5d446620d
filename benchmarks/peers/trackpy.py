"""trackpy: linking of particles by displacement, with memory and, if asked, velocity prediction."""

import numpy as np
import pandas as pd
import trackpy as tp
from shapes import linked


def run(tables, settings):
    """Link every sequence."""
    tp.quiet()
    return linked(tables, settings, link)


def link(frames, interval_s, *, reach_mps, memory=0, predict=False):
    """Link with an adaptive search range, as its manual advises for dense scenes."""
    table = pd.DataFrame(np.vstack([f["xy"] for f in frames]), columns=["x", "y"])
    table["frame"] = np.repeat(np.arange(len(frames)), [len(f["xy"]) for f in frames])
    linker = tp.predict.NearestVelocityPredict() if predict else tp
    reach = max(reach_mps * interval_s, 2.0)
    # adaptive: where too many candidates hang together, the range is narrowed until the subnet can be solved
    found = linker.link_df(
        table, reach, pos_columns=["x", "y"], memory=memory, adaptive_stop=0.01 * reach, adaptive_step=0.9
    )
    track = found["particle"].reindex(table.index).to_numpy()
    return np.split(track, np.cumsum([len(f["xy"]) for f in frames])[:-1])
