"""The printed methods (a)-(d) reach, pair by pair, the rates that another implementation stored."""

import numpy as np
import pandas as pd
import pytest

from vtrack_batch.matching import decision
from vtrack_batch.matching.candidates import candidates
from vtrack_batch.matching.match import paper_labels
from vtrack_batch.matching.params import MatchingParams, RelaxationParams
from vtrack_batch.matching.vehicles import Vehicles

METHODS = {"a": "original", "b": "colour", "c": "opposite", "d": "proposed"}
PX_M, ELAPSED_S = 0.33, 1.5
PRINTED = MatchingParams(
    paper=RelaxationParams(
        max_speed_mps=150 * PX_M / ELAPSED_S, consistency_mps=20 * PX_M / ELAPSED_S, neighbourhood_m=200 * PX_M
    )
)
TIE = 1e-6


class Answers:
    """Who is whose partner by a method; probabilities within ``TIE`` of one another leave a vehicle's answer open."""

    def __init__(self, rows, method):
        images = [rows[rows["image"] == number] for number in (1, 2)]
        self.seen = [Vehicles.of(image, "image") for image in images]
        truth = [dict(zip(image["detection_id"], image["truth_vehicle"], strict=True)) for image in images]
        self.truth = [np.array([t[n] for n in v.ids]) for t, v in zip(truth, self.seen, strict=True)]
        a, b = self.seen
        self.edges = candidates(a.xy, b.xy, PRINTED.reach_m(ELAPSED_S, printed=True))
        self.labels = paper_labels(self.edges, a, b, ELAPSED_S, METHODS[method], PRINTED)
        self.one_way = method in "ab"

    def chosen(self, rule):
        """Return picks (mask) for image 1 and for image 2 and the vehicles of each whose answer hangs on a tie."""
        e, p = self.edges, self.labels
        sides = [(p.p, p.p_none, e.i, e.k), (p.q, p.q_none, e.k, e.i)]
        open_1, open_2 = (self._open(*side) for side in sides)
        if not self.one_way:
            each = [decision._best(*side) for side in sides]
            if rule == "mutual":
                each = [each[0] & each[1]] * 2
                ends = (e.i, e.k)
                touched = [np.union1d(o, ends[s][np.isin(ends[1 - s], u)]) for s, o, u in
                           ((0, open_1, open_2), (1, open_2, open_1))]  # fmt: skip
                return each, touched
            return each, [open_1, open_2]
        # one-way: a vehicle of image 2 belongs to the surest of those that pick it
        picks = np.flatnonzero(decision.argmax(e, p))
        best = picks[np.lexsort((picks, -p.p[picks], e.k[picks]))]
        top = best[np.unique(e.k[best], return_index=True)[1]]
        rivals = picks[np.isin(e.k[picks], e.k[top])]
        surest = dict(zip(e.k[top], p.p[top], strict=True))
        near = rivals[[p.p[r] > surest[e.k[r]] - TIE for r in rivals]] if len(rivals) else rivals
        tied = np.array([k for k in np.unique(e.k[near]) if (e.k[near] == k).sum() > 1], int)
        keep = np.zeros(len(e), bool)
        keep[top] = True
        loose = np.union1d(open_1, e.i[picks][np.isin(e.k[picks], tied)])
        touched = np.union1d(tied, e.k[np.isin(e.i, open_1)])
        return [keep if rule == "mutual" else decision.argmax(e, p), keep], [
            loose if rule == "mutual" else open_1, touched
        ]  # fmt: skip

    @staticmethod
    def _open(p, none, owner, _):
        values = [np.append(p[owner == v], none[v]) for v in range(len(none))]
        return np.array([v for v, labels in enumerate(values) if (labels > labels.max() - TIE).sum() > 1], int)

    def right(self, rule):
        """Return right answers, vehicles and open answers of both images."""
        picks, loose = self.chosen(rule)
        out = []
        for side, ends in enumerate(((self.edges.i, self.edges.k), (self.edges.k, self.edges.i))):
            own, other = self.truth[side], self.truth[1 - side]
            answer = np.full(len(own), -1)
            answer[ends[0][picks[side]]] = other[ends[1][picks[side]]]
            want = np.where(np.isin(own, other), own, -1)
            out.append(((answer == want).sum(), len(own), len(np.unique(loose[side]))))
        return out


def off_by(rows, method, rule, want):
    """Return by how many answers, beyond those that hang on ties, both rates are off; and the ties."""
    right = Answers(rows, method).right(rule)
    stored = [want["rate_image1"], want["rate_image2"]]
    off = [max(0, abs(r - s * n) - t) for (r, n, t), s in zip(right, stored, strict=True)]
    return sum(off), sum(t for *_, t in right)


def unrounded(rows, trials):
    """Yield data that would be written as *rows*: places to the millimetre, colours to the level."""
    random = np.random.default_rng(0)
    for _ in range(trials):
        places = rows[["x_m", "y_m"]] + random.uniform(-5e-4, 5e-4, (len(rows), 2))
        paints = rows[["red", "green", "blue"]] + random.uniform(-0.5, 0.5, (len(rows), 3))
        yield rows.assign(**places, **paints)


@pytest.mark.real
def test_rates_equal_the_stored_ones_pair_by_pair(shared_data):
    """To 0.1 point, ties aside; where not, the stored rate comes of data that the file's rounding hides.

    In jams a displacement lies so near to T that half a millimetre decides a few answers.
    """
    stored = pd.read_parquet(shared_data / "sumo" / "rates.parquet").set_index(["pair", "method", "decision"])
    some = sorted(stored.index.unique("pair"))[::4]
    pairs = pd.read_parquet(shared_data / "sumo" / "pairs.parquet", filters=[("pair", "in", some)])
    equal = tied = 0
    rounding, unequal = [], []
    for pair, rows in pairs.groupby("pair"):
        for method in METHODS:
            for rule in ("argmax", "mutual"):
                want = stored.loc[(pair, method, rule)]
                off, ties = off_by(rows, method, rule, want)
                equal, tied = equal + (off < 0.1), tied + (ties > 0)
                assert off <= 0.05 * len(rows), (pair, method, rule, off)
                if off >= 0.1:
                    reached = any(off_by(other, method, rule, want)[0] < 0.1 for other in unrounded(rows, 40))
                    (rounding if reached else unequal).append((pair, method, rule, round(off)))
    rates = len(some) * 8
    print(
        f"{equal} of {rates} rates equal; in {tied} some answers hang on ties; on rounding: {rounding}; not: {unequal}"
    )
    assert len(rounding) < 0.02 * rates
    assert len(unequal) <= 0.003 * rates
