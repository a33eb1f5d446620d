"""Sums of many small decision trees, without walking them.

Of a tree only those leaves count that no decision rules out: a row that goes right at a decision leaves out the leaves
on its left. So of each column it is enough to know between which two thresholds a row's value lies; the leaves of all
trees that are left by then are tabled, as bits, and what is left by all columns has the leaf reached as its lowest bit.

Source: Lucchese, Nardini, Orlando, Perego, Tonellotto and Venturini, "QuickScorer: a fast algorithm to rank documents
with additive ensembles of regression trees", SIGIR 2015; with its decisions multiplied out beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.matching.bits import lowest
from vtrack_batch.matching.candidates import Array, Index

MOST_LEAVES = 32
BATCH = 64


class Decision(NamedTuple):
    """A row goes left where *column* <= *threshold*; where not, only the leaves *left* (bits) of its tree remain."""

    column: int
    threshold: float
    tree: int
    left: int


@dataclass(frozen=True)
class Trees:
    """The decisions of all trees, tabled by column.

    ``threshold`` (d,) in order of columns, and ascending in each, from ``first`` (columns + 1,) on; ``left``
    (d + columns, trees) uint32 are the leaves left above so many of a column's thresholds, none of them first;
    ``value`` (trees, leaves) those of the leaves from left to right.
    """

    first: Index
    threshold: Array
    left: NDArray[np.uint32]
    value: Array

    @classmethod
    def of(cls, trees: list[dict[str, Any]], columns: int) -> Trees:
        """Read trees as lists of nodes: node t goes left where column[t] <= threshold[t]; a leaf has column -1.

        ``left`` and ``right`` are node numbers, the root comes first. What is no such tree raises ``ValueError``,
        ``KeyError`` or ``IndexError``.
        """
        decisions: list[Decision] = []
        value = np.zeros((len(trees), MOST_LEAVES))
        for number, tree in enumerate(trees):
            leaves = _leaves(tree, 0, number, decisions)
            if len(leaves) > MOST_LEAVES:
                raise ValueError(f"a tree has {len(leaves)} leaves, more than {MOST_LEAVES}")
            value[number, : len(leaves)] = leaves
        if any(not 0 <= d.column < columns for d in decisions):
            raise ValueError(f"a tree asks for a column that is not there; there are {columns}")
        first, threshold, tables = [0], [], []
        for column in range(columns):
            of_column = sorted(d for d in decisions if d.column == column)
            limits = np.unique([d.threshold for d in of_column])
            table = np.full((len(limits) + 1, len(trees)), 2**MOST_LEAVES - 1, np.uint32)
            for d in of_column:
                table[np.searchsorted(limits, d.threshold) + 1, d.tree] &= np.uint32(d.left)
            tables.append(np.bitwise_and.accumulate(table, axis=0))
            threshold.append(limits)
            first.append(first[-1] + len(limits))
        return cls(np.array(first), np.concatenate(threshold).astype(float), np.vstack(tables), value)

    def probability(self, x: Array) -> Array:
        """Return the probability (e,) of every row of *x* (e, columns); the last columns may lack if none asks them."""
        sums = _sums(np.ascontiguousarray(x), self.first, self.threshold, self.left, self.value)
        return np.asarray(1 / (1 + np.exp(-sums)))


def _leaves(tree: dict[str, Any], node: int, number: int, decisions: list[Decision], before: int = 0) -> list[float]:
    """Return the values of the leaves under *node* from left to right, *before* of them on its left; add decisions."""
    column, threshold = int(tree["column"][node]), float(tree["threshold"][node])
    if column < 0:
        return [threshold]
    branches = int(tree["left"][node]), int(tree["right"][node])
    if min(branches) <= node:
        raise ValueError("a tree's nodes do not come before their branches")
    left = _leaves(tree, branches[0], number, decisions, before)
    right = _leaves(tree, branches[1], number, decisions, before + len(left))
    gone = ((1 << len(left)) - 1) << before
    decisions.append(Decision(column, threshold, number, (2**MOST_LEAVES - 1) & ~gone))
    return left + right


@njit(cache=True, nogil=True)
def _sums(x, first, threshold, left, value):  # type: ignore[no-untyped-def]
    """Return the sums (e,) of all trees; ``BATCH`` rows go side by side through the thresholds of a column.

    Columns of which all rows hold the same are asked once.
    """
    always, asked, count = np.full(len(value), 0xFFFFFFFF, np.uint32), np.empty(x.shape[1], np.int64), 0
    for column in range(x.shape[1]):
        same = len(x) > 0
        for e in range(1, len(x)):
            same &= x[e, column] == x[0, column]
            if not same:
                break
        if same:
            limits = threshold[first[column] : first[column + 1]]
            always &= left[first[column] + column + (limits < x[0, column]).sum()]
        asked[count] = column
        count += not same
    out, at, row = np.empty(len(x)), np.empty(BATCH), np.empty(BATCH, np.int64)
    bits = np.empty((BATCH, len(value)), np.uint32)
    for begin in range(0, len(x), BATCH):
        size = min(BATCH, len(x) - begin)
        bits[:] = always
        for column in asked[:count]:
            at[:size] = x[begin : begin + size, column]
            row[:] = first[column] + column
            for s in range(first[column], first[column + 1]):
                for e in range(BATCH):
                    row[e] += threshold[s] < at[e]
            for e in range(size):
                of_row, is_left = bits[e], left[row[e]]
                for t in range(len(value)):
                    of_row[t] &= is_left[t]
        for e in range(size):
            total = 0.0
            for t in range(len(value)):
                total += value[t, lowest(bits[e, t])]
            out[begin + e] = total
    return out
