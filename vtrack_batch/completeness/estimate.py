"""Completeness from what was painted and came back: of each place and time, with its interval.

Paint and places are those of vehicles that are found; how often the same come back tells how many are not. Moving and
standing ones are counted apart: n found of a kind of which a share r comes back stand for n / r that were there
(Horvitz and Thompson 1952). Places with few painted vehicles lean on the whole survey.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

_Z = 1.959963984540054
_LEAN = 20.0
_FEWEST = 10


def completeness(rows: pd.DataFrame, inside: NDArray[np.bool_], of_bin: NDArray[np.int64], bins: int) -> pd.DataFrame:
    """Return ``place``, ``bin``, ``completeness``, ``completeness_lo``, ``completeness_hi``, where there is one.

    *rows* as in table ``injections``; *inside* (n, places) bool; *of_bin* (n,), -1 = none of the *bins*. A place where
    fewer than ten were painted in all, and a bin in which nothing was found, have no row.
    """
    columns = ["place", "bin", "completeness", "completeness_lo", "completeness_hi"]
    painted = rows["painted"].to_numpy(bool)
    whole = _shares(rows[painted], {False: 1.0, True: 1.0}, lean=1.0)
    found = []
    for place in range(inside.shape[1]):
        if (inside[:, place] & painted).sum() < _FEWEST:
            continue
        here = _shares(rows[inside[:, place] & painted], {s: r for s, (r, _) in whole.items()})
        for number in range(bins):
            now = inside[:, place] & (of_bin == number)
            real = rows.loc[now & ~painted, "stands"]
            if len(real):
                shares = _shares(rows[now & painted], {s: r for s, (r, _) in here.items()})
                found.append((place, number, *_whole(real, shares)))
    return pd.DataFrame(found, columns=columns)


Shares = dict[bool, tuple[float, float]]
"""Stands → share that comes back, and the variance of that."""


def _shares(painted: pd.DataFrame, prior: dict[bool, float], lean: float = _LEAN) -> Shares:
    """Return the shares of moving and standing vehicles that come back; sightings of one stay are one witness,
    and *lean* witnesses speak for what is *usual*."""
    shares = {}
    for stands, usual in prior.items():
        of_kind = painted[painted["stands"] == stands]
        by_stay = of_kind.groupby("stay", sort=True)["found"].agg(["sum", "size"]).to_numpy(float).reshape(-1, 2)
        leaning = lean * max(1.0, by_stay[:, 1].mean() if len(by_stay) else 1.0)
        count = by_stay[:, 1].sum() + leaning
        share = (by_stay[:, 0].sum() + leaning * usual) / count
        spread = float(((by_stay[:, 0] - share * by_stay[:, 1]) ** 2).sum()) / count**2
        shares[stands] = (float(share), max(spread, float(share * (1 - share) / count)))
    return shares


def _whole(stands: pd.Series, shares: Shares) -> tuple[float, float, float]:
    """Return the completeness of vehicles of which some stand, with its Wilson interval."""
    counts = {kind: int((stands == kind).sum()) for kind in (False, True)}
    there = sum(n / max(shares[kind][0], 1e-3) for kind, n in counts.items())
    share = len(stands) / there
    slope = {kind: share**2 * n / (len(stands) * max(shares[kind][0], 1e-3) ** 2) for kind, n in counts.items()}
    variance = sum(slope[kind] ** 2 * shares[kind][1] for kind in counts)
    trials = share * (1 - share) / variance if variance > 0 and share < 1 else float(len(stands))
    centre = (share + _Z**2 / (2 * trials)) / (1 + _Z**2 / trials)
    half = _Z * np.sqrt(share * (1 - share) / trials + _Z**2 / (4 * trials**2)) / (1 + _Z**2 / trials)
    return share, max(0.0, float(min(centre - half, share))), min(1.0, float(max(centre + half, share)))
