"""Counts of truth and result side by side, by cell and by block of time, so that blocks can be drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.evaluation.blocks import Array, Blocks, draw_blocks
from vtrack_batch.evaluation.params import EvaluationParams


@dataclass(frozen=True)
class Counted:
    """``found``, ``true`` (1 + resamples, cells): counts of all bins together, for the data as they are and every draw.

    ``hours`` (1 + resamples,) is the observed time. ``blocks`` scores what is made from them.
    """

    cells: pd.MultiIndex
    blocks: Blocks
    found: Array
    true: Array
    hours: Array


def counted(
    sides: tuple[pd.DataFrame, pd.DataFrame],
    trips: tuple[pd.DataFrame, pd.DataFrame],
    hours: pd.Series,
    params: EvaluationParams,
) -> Counted:
    """Return counts by cell, drawn over blocks of time.

    *sides*: found and true rows with the cell's columns, ``bin_start_utc``, ``count``. *hours*: observed hours by bin.
    *trips*, found and true: rows with ``t_utc`` and those of the cell's columns that a trip knows. A block is a bin;
    where there are fewer bins than ``least_blocks``, each is cut into equal parts of the time in which trips begin, and
    its counts are dealt to the parts as the trips of the cell begin in them.
    """
    cell = [name for name in sides[0].columns if name not in ("bin_start_utc", "count")]
    cells = pd.MultiIndex.from_frame(pd.concat([side[cell] for side in sides]).drop_duplicates().sort_values(cell))
    bins = pd.Index(pd.concat([side["bin_start_utc"] for side in sides]).drop_duplicates().sort_values())
    parts = 1 if len(bins) >= params.least_blocks else -(-params.least_blocks // max(1, len(bins)))
    began = pd.concat([trip["t_utc"] for trip in trips])
    if began.empty:
        parts = 1
    grids = []
    for side, trip in zip(sides, trips, strict=True):
        grid = np.zeros((max(1, len(bins)), len(cells)))
        where = bins.get_indexer(side["bin_start_utc"]), cells.get_indexer(pd.MultiIndex.from_frame(side[cell]))
        np.add.at(grid, where, side["count"].to_numpy(float))
        grids.append(_dealt(grid, cells, bins, trip, began, parts) if parts > 1 else grid)
    of_bin = hours.reindex(bins).fillna(0.0).to_numpy(float) if len(bins) else np.zeros(1)
    draws = draw_blocks(len(grids[0]), params)
    blocks = Blocks(np.arange(len(grids[0])), draws, float("nan"))
    drawn_hours = draws @ np.repeat(of_bin / parts, parts)
    return Counted(cells, blocks, draws @ grids[0], draws @ grids[1], drawn_hours)


def _dealt(
    grid: Array, cells: pd.MultiIndex, bins: pd.Index, trips: pd.DataFrame, began: pd.Series, parts: int
) -> Array:
    """Deal the counts (bins, cells) to *parts* of each bin: (bins · parts, cells)."""
    known = [name for name in cells.names if name in trips]
    dealt = np.zeros((len(bins), parts, len(cells)))
    all_bin, bin_of = _bin_of(bins, began), _bin_of(bins, trips["t_utc"])
    for k in range(len(bins)):
        inside = began[all_bin == k]
        here = trips[bin_of == k]
        share = np.full((parts, len(cells)), 1 / parts)
        if len(inside) and len(here):
            edges = pd.date_range(inside.min(), inside.max(), parts + 1)[1:-1]
            part = edges.searchsorted(here["t_utc"], side="right")
            anywhere = np.bincount(part, minlength=parts) / len(part)
            tally: Any = here.assign(part=part).groupby([*known, "part"], observed=True).size().unstack(fill_value=0)
            keys = cells.to_frame(index=False)[known]
            row = tally.index.get_indexer(pd.MultiIndex.from_frame(keys) if len(known) > 1 else keys[known[0]])
            of_cell = tally.reindex(columns=range(parts), fill_value=0).to_numpy(float)
            of_cell = of_cell / of_cell.sum(axis=1, keepdims=True)
            share = np.where(row >= 0, of_cell[row].T, anywhere[:, None])
        dealt[k] = share * grid[k]
    return dealt.reshape(-1, len(cells))


def _bin_of(bins: pd.Index, t_utc: pd.Series) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return the number of the bin in which each time lies; before the first it is the first."""
    return np.maximum(bins.searchsorted(t_utc, side="right") - 1, 0)
