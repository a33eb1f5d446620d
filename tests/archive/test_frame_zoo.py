"""Each animal of the frame zoo has a typed outcome. What decodes is whole: never is a missing part painted grey.

Faults 1 to 3, 5 to 8, 12, 13 and 15. How long each takes: benchmarks/zoo.py.
"""

from __future__ import annotations

import os
from collections import Counter

import numpy as np
import pytest
from frame_zoo import MAX_PIXELS, ZOO, formats, memory_mb, outcome

from vtrack_batch.archive.decode import decode

MOST_MB = 500
REASONS = {
    "empty", "not_an_image", "unsupported_format", "unsupported_samples", "multi_page", "truncated", "malformed",
    "too_large",
}  # fmt: skip


def test_every_animal_has_a_typed_outcome_and_little_memory() -> None:
    found: dict[str, str] = {}
    for name, data in ZOO.items():
        taken_mb = memory_mb(lambda name=name, data=data: found.update({name: outcome(data)}))
        assert taken_mb < MOST_MB, name
    assert len(found) >= 500
    assert set(found.values()) <= REASONS | {"whole"}
    counts = Counter(found.values())
    assert all(counts[reason] for reason in REASONS), counts
    strangers = {name: reason for name, reason in found.items() if name.startswith("stranger")}
    assert set(strangers.values()) <= {"unsupported_format", "not_an_image", "whole"}
    assert {name for name, reason in strangers.items() if reason == "whole"} <= {"stranger MPO"}


def test_memory_that_was_taken_and_given_back_is_seen() -> None:
    assert memory_mb(lambda: bytearray(os.urandom(1 << 20)) * 600) > MOST_MB
    assert memory_mb(lambda: None) < 10


@pytest.mark.parametrize("name", list(formats()))
def test_no_part_of_a_cut_picture_is_accepted(name: str) -> None:
    whole = decode(formats()[name], max_pixels=MAX_PIXELS).pixels
    for other, data in ZOO.items():
        if other.startswith(f"{name} cut") or other.startswith(f"{name} short"):
            reason = outcome(data)
            assert reason in ("whole", "truncated", "malformed", "empty", "not_an_image"), other
            if reason == "whole":
                found = decode(data, max_pixels=MAX_PIXELS).pixels
                np.testing.assert_array_equal(found, whole, err_msg=other)


@pytest.mark.parametrize("name", ["png", "png palette", "png alpha"])
def test_bit_flips_in_a_format_with_checksums_never_change_a_pixel(name: str) -> None:
    whole = decode(formats()[name], max_pixels=MAX_PIXELS).pixels
    for other, data in ZOO.items():
        if other.startswith(f"{name} flipped") and outcome(data) == "whole":
            np.testing.assert_array_equal(decode(data, max_pixels=MAX_PIXELS).pixels, whole)


def test_bombs_take_no_memory() -> None:
    for name, data in ZOO.items():
        if "bomb" in name:
            assert outcome(data) in ("too_large", "malformed", "truncated"), name
