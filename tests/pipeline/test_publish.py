"""What is published has a place of its own, and one coordinate system."""

from __future__ import annotations

import pytest

from vtrack_batch.errors import ConfigError
from vtrack_batch.pipeline.publish import slug
from vtrack_batch.pipeline.track import one_crs

START = "20260517T060000Z"


def test_sequences_keep_their_names_as_files() -> None:
    assert slug(f"main/{START}") == f"main_{START}"
    assert slug(f"cam_1/{START}") == f"cam_1_{START}"


def test_no_two_sequences_share_a_file() -> None:
    long = "platform-" * 20
    platforms = ["東京", "大阪", "a/b", "a_b", "a b", "_a", "a", ".a", f"{long}1", f"{long}2"]
    names = [f"{platform}/{START}" for platform in platforms] + [f"{long}1/20260517T070000Z"]
    files = [slug(name) for name in names]
    assert len(set(files)) == len(names)
    assert all(len(file) < 100 and file[0] not in "_." and "/" not in file for file in files)


def test_coordinates_of_two_systems_are_not_mixed() -> None:
    assert one_crs([]) is None
    assert one_crs(["EPSG:26913", "EPSG:26913"]) == "EPSG:26913"
    with pytest.raises(ConfigError, match=r"EPSG:26913, EPSG:26914.*georeference\.crs"):
        one_crs(["EPSG:26914", "EPSG:26913"])
