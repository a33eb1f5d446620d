"""Contradictions in the survey's georeference are refused in words that say what to do."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from vtrack_batch.georeference.params import GeoreferenceParams

POINT = {"col_px": 0, "row_px": 0, "x_m": 0, "y_m": 0}
TRIANGLE = [POINT, {**POINT, "col_px": 100, "x_m": 50}, {**POINT, "row_px": 100, "y_m": -50}]


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({"crs": "EPSG:4326"}, "degrees"),
        ({"crs": "EPSG:2232"}, "foot"),
        ({"crs": "EPSG:999999"}, "not a coordinate reference system"),
        ({"crs": "the local one"}, "not a coordinate reference system"),
        ({"control_points": TRIANGLE[:2]}, "at least 3"),
        ({"control_points": [POINT, {**POINT, "col_px": 9, "x_m": 4}, {**POINT, "col_px": 20, "x_m": 9}]}, "one line"),
        ({"control_points": [*TRIANGLE[:2], {**POINT, "row_px": 100}]}, "one line on the ground"),
        ({"control_points": TRIANGLE, "origin": {"x_m": 1, "y_m": 2}}, "contradict"),
        ({"control_points": TRIANGLE, "rotation_deg": 3}, "contradict"),
        ({"control_points": TRIANGLE, "source": "geotiff"}, "source is geotiff"),
        ({"source": "control_points"}, "none are given"),
        ({"source": "world_file", "origin": {"x_m": 1, "y_m": 2}}, "not be used"),
        ({"gsd_m": 0}, "greater than 0"),
        ({"gsd_m": (0.3, -0.3)}, "greater than 0"),
        ({"gsd_m": (0.3, 0.3, 0.3)}, "at most 2"),
        ({"gsd": 0.3}, "Extra inputs"),
    ],
)
def test_refused(given, complaint):
    with pytest.raises(ValidationError, match=complaint):
        GeoreferenceParams.model_validate(given)


def test_defaults_serve_the_example():
    at = GeoreferenceParams()
    assert at.gsd_xy_m == (0.33, 0.33)
    assert at.mosaic_gsd_m == 0.33


def test_pairs_and_crs_are_normalised_and_survive_a_round_trip():
    at = GeoreferenceParams.model_validate({"gsd_m": [0.44, 0.33], "crs": "epsg:26913"})
    assert (at.gsd_xy_m, at.mosaic_gsd_m, at.crs) == ((0.44, 0.33), 0.33, "EPSG:26913")
    assert GeoreferenceParams.model_validate(at.model_dump(mode="json")) == at
