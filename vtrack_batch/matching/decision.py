"""From label probabilities to links: the best label, labels that agree, or the best one-to-one set."""

from __future__ import annotations

import numpy as np
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


def assign(i: Index, k: Index, gain: Array) -> Mask:
    """Pick pairs (i, k) so that none is used twice and the sum of *gain* (e,) is greatest; gains <= 0 are never picked.

    Sparse Jonker-Volgenant (scipy); every row also has a column of its own, at gain 0, that means no match.
    """
    picked = np.zeros(len(gain), bool)
    useful = np.flatnonzero(gain > 0)
    if len(useful) == 0:
        return picked
    rows, row = np.unique(i[useful], return_inverse=True)
    cols, col = np.unique(k[useful], return_inverse=True)
    n, m = len(rows), len(cols)
    top = float(gain[useful].max()) + 1.0  # keeps all costs above zero: scipy takes zero for "no edge"
    cost = coo_array(
        (
            np.concatenate([top - gain[useful], np.full(n, top)]),
            (np.concatenate([row, np.arange(n)]), np.concatenate([col, m + np.arange(n)])),
        ),
        shape=(n, m + n),
    ).tocsr()
    at_row, at_col = min_weight_full_bipartite_matching(cost)
    partner = np.full(n, -1)
    partner[at_row] = at_col
    picked[useful] = partner[row] == col
    return picked


def _best(p: Array, none: Array, owner: Index, partner: Index) -> Mask:
    """Mark each owner's best edge if it beats no match; of equal edges the one with the lowest partner."""
    order = np.lexsort((partner, -p, owner))
    first = np.ones(len(order), bool)
    first[1:] = owner[order][1:] != owner[order][:-1]
    best = np.zeros(len(p), bool)
    best[order[first]] = True
    return best & (p > none[owner])
