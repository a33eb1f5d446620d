"""Which A, B, C serve traffic like this: the paper's sweep (section 4.2.1) on labelled pairs, and what methods reach.

A setting is chosen on some pairs and judged on others. Optima are broad: of all settings that are as good as the best
within one standard error of the paired difference, the one nearest to the defaults is taken (Breiman et al. 1984).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.candidates import Array, Index, candidates
from vtrack_batch.matching.colour import colour_labels, equal_labels
from vtrack_batch.matching.match import match
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.matching.relaxation import sweep
from vtrack_batch.matching.vehicles import Vehicles

NONE = -1
LEAST = 0.05  # settings are compared by their logarithms; 0 counts as this


@dataclass(frozen=True)
class LabelledPair:
    """Two images *elapsed_s* apart in the columns of ``match``, and ``vehicle`` as well: who it is, null = nobody."""

    earlier: pd.DataFrame
    later: pd.DataFrame
    elapsed_s: float

    def read(self) -> tuple[Vehicles, Vehicles, Index, Index]:
        """Return both images as matching sees them, and the row of the true partner of each (n,), (m,); -1 = none."""
        images = Vehicles.of(self.earlier, "earlier image"), Vehicles.of(self.later, "later image")
        sides = []
        for name, table, image in zip(("i", "k"), (self.earlier, self.later), images, strict=True):
            vehicle = table.set_index("detection_id")["vehicle"].loc[image.ids].reset_index(drop=True).dropna()
            if vehicle.duplicated().any():
                raise UnusableData("a vehicle is seen twice in one image of a labelled pair")
            sides.append(vehicle.rename("vehicle").rename_axis(name).reset_index())
        both = sides[0].merge(sides[1], on="vehicle")
        to_k, to_i = (np.full(len(image), NONE) for image in images)
        to_k[both["i"]], to_i[both["k"]] = both["k"], both["i"]
        return *images, to_k, to_i


def logarithmic_grid() -> Array:
    """Return settings of A, B, C (1574, 3) as far apart as matters: an A of 0.02 to 1, B and C of 0.1 to 25, and 0."""
    a = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0])
    bc = np.concatenate([[0.0], 0.1 * 250 ** (np.arange(14) / 13)])
    grid = np.column_stack([part.ravel() for part in np.meshgrid(a, bc, bc, indexing="ij")])
    return np.asarray(grid[grid.sum(axis=1) > 0])


def sweep_rates(pairs: Sequence[LabelledPair], settings: Array, params: MatchingParams) -> Array:
    """Return the pooled label rate (pairs, settings) of the relaxation, decided mutually, for *settings* (s, 3).

    With colour where the pairs have it: method (d), else (c). Both images count, and so does no match (the paper).
    """
    rates = np.empty((len(pairs), len(settings)))
    for row, pair in enumerate(pairs):
        a, b, *true = pair.read()
        edges = candidates(a.xy, b.xy, params.reach_m(pair.elapsed_s, printed=True), limit=params.max_candidate_pairs)
        coloured = a.rgb is not None and b.rgb is not None
        start = colour_labels(edges, a.rgb, b.rgb) if coloured else equal_labels(edges)  # type: ignore[arg-type]
        tolerance = params.paper.consistency_m(pair.elapsed_s)
        best_i, best_k = sweep(
            edges, start, a.xy, b.xy, settings=settings, tolerance=tolerance, params=params.paper
        )  # fmt: skip
        rates[row] = mutual_rates(best_i, best_k, *true)
    return rates


def mutual_rates(best_i: NDArray[np.int32], best_k: NDArray[np.int32], true_i: Index, true_k: Index) -> Array:
    """Return the pooled label rate (s,) of best labels (s, n), (s, m) that hold where both sides agree."""
    right = _agreed(best_i, best_k) == true_i
    other = _agreed(best_k, best_i) == true_k
    return np.asarray((right.sum(axis=1) + other.sum(axis=1)) / max(1, len(true_i) + len(true_k)))


def method_rates(pairs: Sequence[LabelledPair], methods: Sequence[str], params: MatchingParams) -> pd.DataFrame:
    """Return the pooled label rate of every method (column) on every pair (row)."""
    return pd.DataFrame([{method: _rate(pair, method, params) for method in methods} for pair in pairs])


def chosen_setting(rates: Array, settings: Array, default: Array) -> int:
    """Return the row of *settings* (s, 3) nearest to *default* (3,) among those as good as the best by *rates*."""
    best = int(rates.mean(axis=0).argmax())
    behind = rates[:, [best]] - rates
    spread = behind.std(axis=0, ddof=1) / np.sqrt(len(rates)) if len(rates) > 1 else np.zeros(len(settings))
    as_good = behind.mean(axis=0) <= spread
    away = np.abs(_logarithm(settings) - _logarithm(default)).sum(axis=1)
    return int(np.where(as_good, away, np.inf).argmin())


def _agreed(best: NDArray[np.int32], opposite: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the label of each vehicle (s, n) if the vehicle that it names answers with it, else no match."""
    if opposite.shape[1] == 0:
        return np.full(best.shape, NONE)
    answer = np.take_along_axis(opposite, np.maximum(best, 0), axis=1)
    return np.where((best >= 0) & (answer == np.arange(best.shape[1])), best, NONE)


def _rate(pair: LabelledPair, method: str, params: MatchingParams) -> float:
    a, b, true_k, true_i = pair.read()
    links = match(pair.earlier, pair.later, elapsed_s=pair.elapsed_s, method=method, params=params)
    made = links.dropna(subset=["detection_id_from", "detection_id_to"])
    i = pd.Index(a.ids).get_indexer(made["detection_id_from"])
    k = pd.Index(b.ids).get_indexer(made["detection_id_to"])
    found_k, found_i = np.full(len(a), NONE), np.full(len(b), NONE)
    found_k[i], found_i[k] = k, i
    right = int((found_k == true_k).sum() + (found_i == true_i).sum())
    return right / max(1, len(a) + len(b))


def _logarithm(settings: Array) -> Array:
    return np.asarray(np.log(np.maximum(settings, LEAST)))
