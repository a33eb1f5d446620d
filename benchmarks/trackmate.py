"""Does our assignment make the links that TrackMate made of the same spots? ``python -m benchmarks.trackmate``.

TrackMate (Tinevez and others 2017) links spots by two linear assignments (Jaqaman and others 2008): spots of successive
frames at the cost of their squared distance, then ends of tracks to later starts ("gap closing"). Its files tell the
links and their costs, not the settings: the greatest distances are inferred from the links, and tried around.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.page import SHARED
from vtrack_batch.matching.decision import assign

FOLDER = SHARED / "trackmate"
WANTED = 0.99
NO_LINK = 1.05
"""TrackMate's price of no link: this times the greatest cost of any possible link."""

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Limits:
    """Greatest distances, in the files' unit, and the most frames from the end of a track to its continuation."""

    link: float
    gap: float
    frames: int


def main() -> int:
    """Print the share of links reproduced with and without gap closing, and all differences; 1 below 99 %."""
    spots, with_gaps, without = read(FOLDER)
    limits = inferred(spots, with_gaps)
    print(f"{len(spots)} spots in {spots['frame'].nunique()} frames; limits inferred from the links: {limits}")
    worst = 1.0
    for name, theirs, frames in (("without gap closing", without, 1), ("with gap closing", with_gaps, limits.frames)):
        ours = linked(spots, Limits(limits.link, limits.gap, frames))
        common = ours & theirs
        worst = min(worst, len(common) / len(theirs), len(common) / max(1, len(ours)))
        print(f"{name}: {len(common)} of {len(theirs)} links reproduced, {len(ours - theirs)} of ours are not theirs")
        for said, links in (("only TrackMate", theirs - ours), ("only ours", ours - theirs)):
            for source, target in sorted(links):
                print(f"  {said}: {told(spots, source)} -> {told(spots, target)}")
    for factor in (0.75, 0.9, 1.0, 1.25, 1.5, 2.0, 3.0):
        tried = Limits(factor * limits.link, factor * limits.gap, limits.frames)
        common = linked(spots, tried) & with_gaps
        print(f"  limits x {factor:g}: {len(common)} of {len(with_gaps)} reproduced")
    return int(worst < WANTED)


def read(folder: Path) -> tuple[pd.DataFrame, set[tuple[int, int]], set[tuple[int, int]]]:
    """Return the spots (by id: frame, x, y), and TrackMate's links with and without gap closing."""
    names = [f"trackmate_tracks_{which}_gap_closing" for which in ("with", "without")]
    spots = pd.read_csv(folder / f"{names[0]}_spots.csv").set_index("id")
    spots = spots[["frame", "position_x", "position_y"]].set_axis(["frame", "x", "y"], axis=1)
    links = (pd.read_csv(folder / f"{name}.csv")[["spot_source_id", "spot_target_id"]] for name in names)
    with_gaps, without = ({(int(a), int(b)) for a, b in rows.itertuples(index=False)} for rows in links)
    return spots.sort_index(), with_gaps, without


def inferred(spots: pd.DataFrame, links: set[tuple[int, int]]) -> Limits:
    """Return the least limits that allow all of *links*: a little beyond the longest, and as many frames."""
    source, target = (spots.loc[list(ends)] for ends in zip(*sorted(links), strict=True))
    distance = np.hypot(*(target[["x", "y"]].to_numpy() - source[["x", "y"]].to_numpy()).T)
    frames = target["frame"].to_numpy() - source["frame"].to_numpy()
    longest = 1.01 * float(distance[frames == 1].max())
    return Limits(longest, max(longest, 1.01 * float(distance[frames > 1].max(initial=0.0))), int(frames.max()))


def linked(spots: pd.DataFrame, limits: Limits) -> set[tuple[int, int]]:
    """Return the links (id, id) of our own assignment in two stages; ``frames`` = 1 closes no gaps."""
    frame, xy = spots["frame"].to_numpy(np.int64), spots[["x", "y"]].to_numpy(float)
    i, k = _pairs(frame, xy, np.arange(len(spots)), np.arange(len(spots)), 1, limits.link)
    picked = _cheapest(i, k, xy)
    i, k = i[picked], k[picked]
    ends, starts = np.setdiff1d(np.arange(len(spots)), i), np.setdiff1d(np.arange(len(spots)), k)
    if limits.frames > 1:
        a, b = _pairs(frame, xy, ends, starts, limits.frames, limits.gap)
        closed = _cheapest(a, b, xy)
        i, k = np.r_[i, a[closed]], np.r_[k, b[closed]]
    ids = spots.index.to_numpy()
    return {(int(a), int(b)) for a, b in zip(ids[i], ids[k], strict=True)}


def told(spots: pd.DataFrame, spot: int) -> str:
    """Return a spot in words."""
    frame, x, y = spots.loc[spot]
    return f"{spot} (frame {frame:.0f}, {x:.1f}, {y:.1f})"


def _pairs(frame: Index, xy: NDArray[np.float64], a: Index, b: Index, frames: int, reach: float) -> tuple[Index, Index]:
    """Return all pairs of *a* and *b* that are 1 to *frames* frames and at most *reach* apart."""
    later = frame[b][None, :] - frame[a][:, None]
    near = np.hypot(*(xy[b][None, :] - xy[a][:, None]).transpose(2, 0, 1)) <= reach
    row, column = np.nonzero((later >= 1) & (later <= frames) & near)
    return a[row], b[column]


def _cheapest(i: Index, k: Index, xy: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Pick the one-to-one links of least total cost, a link saving the price of no link at both its ends."""
    cost = ((xy[k] - xy[i]) ** 2).sum(axis=1)
    return assign(i, k, 2 * NO_LINK * cost.max(initial=0.0) - cost)


if __name__ == "__main__":
    sys.exit(main())
