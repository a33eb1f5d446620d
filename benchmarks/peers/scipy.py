"""Plain one-to-one assignment between successive frames: distance, and colour difference if there is one."""

import numpy as np
from scipy.optimize import linear_sum_assignment
from shapes import linked


def run(tables, settings):
    """Link every sequence."""
    return linked(tables, settings, link)


def link(frames, interval_s, *, reach_mps, metres_per_level, predict=False):
    """Chain assignments; cost = distance + metres_per_level · colour distance, no match costs the reach.

    With *predict* a track is sought where its last displacement would bring it.
    """
    reach = max(reach_mps * interval_s, 2.0)
    tracks, last, count = [], None, 0
    moved = None
    for frame in frames:
        track = np.full(len(frame["xy"]), -1)
        step = np.zeros_like(frame["xy"])
        if last is not None:
            expected = last["xy"] + (moved if predict else 0)
            i, k = assigned(expected, last["rgb"], frame["xy"], frame["rgb"], reach, metres_per_level)
            track[k] = tracks[-1][i]
            step[k] = frame["xy"][k] - last["xy"][i]
        new = track < 0
        track[new] = count + np.arange(new.sum())
        count += int(new.sum())
        tracks.append(track)
        last, moved = frame, step
    return tracks


def assigned(xy, rgb, later_xy, later_rgb, reach, metres_per_level):
    """Return the pairs of least total cost; each side has a no-match of its own."""
    n, m = len(xy), len(later_xy)
    away = np.linalg.norm(xy[:, None] - later_xy[None], axis=2)
    cost = away.copy()
    if rgb is not None and later_rgb is not None:
        cost += metres_per_level * np.linalg.norm(rgb[:, None] - later_rgb[None], axis=2)
    cost[away > reach] = np.inf
    limit = reach * (1 if rgb is None else 1.5)
    # either pair i with k, or leave both: both are dearer than `limit` together
    whole = np.full((n + m, n + m), 1e9)
    whole[:n, :m] = np.where(np.isfinite(cost), cost, 1e9)
    whole[np.arange(n), m + np.arange(n)] = limit / 2
    whole[n + np.arange(m), np.arange(m)] = limit / 2
    whole[n:, m:] = 0
    i, k = linear_sum_assignment(whole)
    kept = (i < n) & (k < m)
    return i[kept], k[kept]
