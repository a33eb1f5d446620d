"""From label probabilities to links: the best label, labels that agree, or the best one-to-one set."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from vtrack_batch.matching.candidates import Array, Edges, Index
from vtrack_batch.matching.relaxation import Labels

Mask = NDArray[np.bool_]
TINY = 1e-12


def argmax(edges: Edges, labels: Labels) -> Mask:
    """Pick for every earlier vehicle its most probable label; ties with no match go to no match.

    Several earlier vehicles may pick the same later one: that is how the paper's (a) and (b) decide.
    """
    return _best(labels.p, labels.p_none, edges.i, edges.k)


def mutual(edges: Edges, labels: Labels) -> Mask:
    """Pick the edges that are the best label from both images."""
    return _best(labels.p, labels.p_none, edges.i, edges.k) & _best(labels.q, labels.q_none, edges.k, edges.i)


def one_to_one(edges: Edges, labels: Labels) -> Mask:
    """Pick the one-to-one set of edges of greatest total log-odds against no match, from both images."""
    odds = np.log(labels.p + TINY) - np.log(labels.p_none + TINY)[edges.i]
    odds += np.log(labels.q + TINY) - np.log(labels.q_none + TINY)[edges.k]
    return assign(edges.i, edges.k, odds)


def most_right(edges: Edges, labels: Labels) -> Mask:
    """Pick the one-to-one set of which the most labels are expected to be right, no match counted as a label.

    A link of probability p puts two labels right; without it each of its ends would be right with that of no match.
    """
    return assign(edges.i, edges.k, labels.p + labels.q - labels.p_none[edges.i] - labels.q_none[edges.k])


def assign(i: Index, k: Index, gain: Array) -> Mask:
    """Pick pairs (i, k) so that none is used twice and the sum of *gain* (e,) is greatest; gains <= 0 are never picked.

    A pair worth at least the best other pair of i and the best other pair of k together is in a best set, whatever the
    rest: such pairs are fixed first, which leaves few. Those are solved by sparse Jonker-Volgenant (scipy).
    """
    picked = np.zeros(len(gain), bool)
    left = np.flatnonzero(gain > 0)
    while len(left):
        row, col, worth = _codes(i[left]), _codes(k[left]), gain[left]
        fixed = worth >= _best_other(row, worth) + _best_other(col, worth)
        # of equal claims on one end only the first is taken
        claims = np.flatnonzero(fixed)
        claims = claims[_first_of_each(row[claims])]
        claims = claims[_first_of_each(col[claims])]
        if not len(claims):
            picked[left[_solved(row, col, worth)]] = True
            break
        picked[left[claims]] = True
        gone_i, gone_k = np.zeros(row.max() + 1, bool), np.zeros(col.max() + 1, bool)
        gone_i[row[claims]], gone_k[col[claims]] = True, True
        left = left[~(gone_i[row] | gone_k[col])]
    return picked


def _codes(values: Index) -> Index:
    """Number the values (e,), none negative, by their rank; without sorting."""
    return np.asarray((np.cumsum(_among(values)) - 1)[values])


def _first_of_each(values: Index) -> Index:
    """Return the ascending positions at which each value, none negative, occurs first."""
    first = np.full(values.max(initial=-1) + 1, -1)
    first[values[::-1]] = np.arange(len(values))[::-1]  # of many on one place the last one stays
    return np.sort(first[first >= 0])


def _among(values: Index) -> Mask:
    """Tell which numbers, from 0 to the greatest, are among the *values*."""
    among = np.zeros(values.max(initial=-1) + 1, bool)
    among[values] = True
    return among


@njit(cache=True, nogil=True)
def _best_other(end, worth):  # type: ignore[no-untyped-def]
    """Return for every pair the greatest worth (> 0) of the other pairs at its *end*, 0 where there is none."""
    size = end.max() + 1
    best, second, which = np.zeros(size), np.zeros(size), np.full(size, -1)
    for e in range(len(end)):
        at = end[e]
        if worth[e] > best[at]:
            best[at], second[at], which[at] = worth[e], best[at], e
        elif worth[e] > second[at]:
            second[at] = worth[e]
    out = np.empty(len(end))
    for e in range(len(end)):
        out[e] = second[end[e]] if which[end[e]] == e else best[end[e]]
    return out


def _solved(row: Index, col: Index, worth: Array) -> Index:
    """Return the positions of the best one-to-one set; every row also has a column of its own, at 0, for no match."""
    n, m = int(row.max()) + 1, int(col.max()) + 1
    top = float(worth.max()) + 1.0  # keeps all costs above zero: scipy takes zero for "no edge"
    cost = coo_array(
        (
            np.concatenate([top - worth, np.full(n, top)]),
            (np.concatenate([row, np.arange(n)]), np.concatenate([col, m + np.arange(n)])),
        ),
        shape=(n, m + n),
    ).tocsr()
    at_row, at_col = min_weight_full_bipartite_matching(cost)
    partner = np.full(n, -1)
    partner[at_row] = at_col
    return np.flatnonzero(partner[row] == col)


def _best(p: Array, none: Array, owner: Index, partner: Index) -> Mask:
    """Mark each owner's best edge if it beats no match; of equal edges the one with the lowest partner."""
    order = np.lexsort((partner, -p, owner))
    first = np.ones(len(order), bool)
    first[1:] = owner[order][1:] != owner[order][:-1]
    best = np.zeros(len(p), bool)
    best[order[first]] = True
    return best & (p > none[owner])
