"""Benchmarks beside other people's programs hold what they print."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

PROJECT = Path(__file__).resolve().parents[2]


def benchmark(name: str) -> ModuleType:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(PROJECT))
        return importlib.import_module(f"benchmarks.{name}")


@pytest.mark.real
def test_links_of_trackmate_are_reproduced(shared_data: Path) -> None:
    trackmate = benchmark("trackmate")
    spots, with_gaps, without = trackmate.read(shared_data / "trackmate")
    limits = trackmate.inferred(spots, with_gaps)
    assert limits.frames == 2
    no_gaps = trackmate.Limits(limits.link, limits.gap, 1)
    for ours, theirs in ((trackmate.linked(spots, limits), with_gaps), (trackmate.linked(spots, no_gaps), without)):
        assert len(theirs) > 100
        assert len(ours & theirs) >= 0.99 * len(theirs)
        assert len(ours - theirs) <= 0.01 * len(theirs)
    assert len(trackmate.linked(spots, trackmate.Limits(limits.link / 2, limits.gap / 2, 2)) & with_gaps) < 120


def test_faulty_crowds_tell_the_two_readings_of_clear_apart() -> None:
    oracles = benchmark("oracles")
    truth = oracles.crowd(np.random.default_rng(0))
    tracked = oracles.overlapping(truth, oracles.with_faults(truth, np.random.default_rng(100)))
    scores = oracles.our_scores(tracked)
    # TrackEval 1.3.0 and motmetrics 1.4.0 on the same boxes: python -m benchmarks.oracles
    trackeval = {
        "idf1": 0.745351043643264,
        "mota": 0.765243902439024,
        "id_switches": 25,
        "hota": 0.581092129304805,
        "deta": 0.620613286479421,
        "assa": 0.544480345916394,
    }
    motmetrics = {"idf1": 0.745351043643264, "mota_carried": 0.768292682926829, "id_switches_carried": 21}
    for theirs in (trackeval, motmetrics):
        assert {name: scores[name] for name in theirs} == pytest.approx(theirs, abs=1e-9)
    shuffled = truth.sample(frac=1, random_state=4).reset_index(drop=True)
    again = oracles.overlapping(shuffled, oracles.with_faults(truth, np.random.default_rng(100)))
    assert oracles.our_scores(again) == scores
