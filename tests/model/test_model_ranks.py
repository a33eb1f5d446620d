from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vtrack_batch.model.ranks import comparators, take_ranks


@settings(deadline=None, max_examples=60)
@given(count=st.integers(1, 40), seed=st.integers(0, 10_000), share=st.floats(0, 1))
def test_every_rank_is_exact(count: int, seed: int, share: float) -> None:
    stack = np.random.default_rng(seed).integers(0, 256, (count, 3, 17), dtype=np.uint8)
    rank = min(count - 1, int(share * count))
    wanted = np.sort(stack, axis=0)
    low, high = take_ranks(stack.copy(), (rank, count - 1 - rank))
    assert (low == wanted[rank]).all()
    assert (high == wanted[count - 1 - rank]).all()


def test_median_of_31_needs_fewer_comparators_than_sorting() -> None:
    assert 100 < len(comparators(31, (15,))) < len(comparators(31, tuple(range(31))))
