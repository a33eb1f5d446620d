"""Pixels become the right metres, to the half pixel, whatever says where the frame lies."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vtrack_batch.errors import ConfigError
from vtrack_batch.georeference.fix import WorldFile, find_fix, scale_at
from vtrack_batch.georeference.params import GeoreferenceParams
from vtrack_batch.model import homography
from vtrack_batch.model.geotags import GeoTags

WIDTH, HEIGHT = 640, 360
PLACES = np.array([[0.0, 0.0], [639, 0], [12.25, 300.5], [639, 359]])


def params(**given: object) -> GeoreferenceParams:
    return GeoreferenceParams.model_validate(given)


def ground(at: GeoreferenceParams, places: np.ndarray = PLACES, **known: object) -> np.ndarray:
    return homography.apply(find_fix(at, WIDTH, HEIGHT, **known).reference_to_ground, places)


def points(to_ground: np.ndarray, pixels: np.ndarray, noise_m: np.ndarray | float = 0.0) -> list[dict[str, float]]:
    metres = homography.apply(to_ground, pixels) + noise_m
    return [
        {"col_px": c, "row_px": r, "x_m": x, "y_m": y}
        for (c, r), (x, y) in zip(pixels.tolist(), metres.tolist(), strict=True)
    ]


NORTH_UP = np.array([[0.5, 0, 480_000.25], [0, -0.5, 4_300_999.75], [0, 0, 1]])
OBLIQUE = np.array([[0.5, 0.02, 1000], [0.03, -0.6, 2000], [1e-5, 2e-4, 1]])
SPREAD = np.array([[10.0, 20], [600, 30], [50, 330], [620, 340], [300, 180], [150, 90], [480, 250], [350, 30]])


class TestScale:
    def test_local_frame_has_its_origin_at_the_top_left_and_y_up(self):
        col, row = PLACES.T
        found = ground(params(gsd_m=0.33))
        np.testing.assert_allclose(found, np.column_stack([(col + 0.5) * 0.33, -(row + 0.5) * 0.33]), atol=1e-9)

    def test_pair_is_along_columns_then_rows(self):
        found = ground(params(gsd_m=(0.4, 0.3)))
        np.testing.assert_allclose(found[3], [639.5 * 0.4, -359.5 * 0.3], atol=1e-9)

    def test_origin_is_the_corner_not_the_centre(self):
        at = params(gsd_m=0.5, crs="EPSG:26913", origin={"x_m": 480_000, "y_m": 4_301_000})
        np.testing.assert_allclose(ground(at)[0], [480_000.25, 4_300_999.75], atol=1e-9)
        assert find_fix(at, WIDTH, HEIGHT).crs == "EPSG:26913"

    def test_frame_whose_top_points_east(self):
        found = ground(params(gsd_m=(0.4, 0.3), rotation_deg=90))
        # Down in the frame is then west, right in the frame is south.
        np.testing.assert_allclose(found[1] - found[0], [0, -639 * 0.4], atol=1e-9)
        np.testing.assert_allclose(found[3] - found[1], [-359 * 0.3, 0], atol=1e-9)
        np.testing.assert_allclose(found[0], [-0.15, -0.2], atol=1e-9)

    @given(st.floats(-360, 360), st.floats(0.05, 3), st.floats(0.05, 3))
    def test_distances_hold_under_rotation(self, rotation, x, y):
        found = ground(params(gsd_m=(x, y), rotation_deg=rotation))
        lengths = np.linalg.norm(found[[1, 3]] - found[[0, 1]], axis=1)
        np.testing.assert_allclose(lengths, [639 * x, 359 * y], rtol=1e-9)
        across, down = found[1] - found[0], found[3] - found[1]
        assert across[0] * down[1] - across[1] * down[0] < 0  # never mirrored

    def test_crs_without_a_place_is_refused(self):
        with pytest.raises(ConfigError, match="origin"):
            find_fix(params(crs="EPSG:26913"), WIDTH, HEIGHT)

    def test_scale_at_centre(self):
        fix = find_fix(params(gsd_m=(0.4, 0.3), rotation_deg=33), WIDTH, HEIGHT)
        assert fix.gsd_m == pytest.approx((0.4, 0.3))
        assert scale_at(OBLIQUE, 1, 1) == pytest.approx(
            np.linalg.norm(homography.apply(OBLIQUE, np.array([[1e-6, 0], [0, 1e-6]])) - [1000, 2000], axis=1) / 1e-6,
            rel=1e-4,
        )


class TestHalfPixel:
    """The same ground, told in corners, in centres and in points, is the same to a nanometre."""

    corner = GeoTags((480_000.0, 0.5, 0.0, 4_301_000.0, 0.0, -0.5), "EPSG:26913")
    centre = WorldFile("a.tfw", "0.5\n0\n0\n-0.5\n480000.25\n4300999.75\n")

    def test_all_agree(self):
        exact = homography.apply(NORTH_UP, PLACES)
        at = params(crs="EPSG:26913")
        np.testing.assert_allclose(ground(at, tags=self.corner), exact, rtol=0, atol=2e-9)
        np.testing.assert_allclose(ground(at, world_file=self.centre), exact, rtol=0, atol=2e-9)
        by_points = params(crs="EPSG:26913", control_points=points(NORTH_UP, SPREAD))
        np.testing.assert_allclose(ground(by_points), exact, rtol=0, atol=2e-8)
        by_origin = params(crs="EPSG:26913", gsd_m=0.5, origin={"x_m": 480_000, "y_m": 4_301_000})
        np.testing.assert_allclose(ground(by_origin), exact, rtol=0, atol=2e-9)

    def test_rotated_file_of_either_kind(self):
        a, b, c, d = 0.4, 0.1, 0.12, -0.35  # dx/dcol, dx/drow, dy/dcol, dy/drow: all different
        tags = GeoTags((100.0, a, b, 200.0, c, d), "EPSG:26913")
        lines = [a, c, b, d, 100 + (a + b) / 2, 200 + (c + d) / 2]
        world = WorldFile("a.jgw", "\n".join(map(repr, lines)))
        at = params(crs="EPSG:26913")
        expected = np.array([[100 + a * 10.5 + b * 3.5, 200 + c * 10.5 + d * 3.5]])
        np.testing.assert_allclose(ground(at, np.array([[10.0, 3]]), tags=tags), expected, atol=1e-9)
        np.testing.assert_allclose(ground(at, np.array([[10.0, 3]]), world_file=world), expected, atol=1e-9)


class TestSources:
    def test_auto_prefers_points_then_tags_then_world_file_then_scale(self):
        tags = GeoTags((0.0, 0.5, 0.0, 0.0, 0.0, -0.5), "EPSG:26913")
        world = WorldFile("a.tfw", "0.5\n0\n0\n-0.5\n0\n0\n")

        def method(at, **known):
            return find_fix(at, WIDTH, HEIGHT, **known).method

        assert method(params(control_points=points(NORTH_UP, SPREAD)), tags=tags, world_file=world) == "control_points"
        assert method(params(), tags=tags, world_file=world) == "geotiff"
        assert method(params(), world_file=world) == "world_file"
        assert method(params()) == "scale"
        assert method(params(origin={"x_m": 1, "y_m": 2}), tags=tags, world_file=world) == "scale"
        assert method(params(source="world_file"), tags=tags, world_file=world) == "world_file"
        assert method(params(source="scale"), tags=tags, world_file=world) == "scale"

    @pytest.mark.parametrize("source", ["world_file", "geotiff"])
    def test_missing_source_is_named(self, source):
        with pytest.raises(ConfigError, match=source):
            find_fix(params(source=source), WIDTH, HEIGHT)

    @pytest.mark.parametrize(
        ("text", "complaint"),
        [
            ("0.5\n0\nzero\n-0.5\n1\n2\n", "line 3.*zero"),
            ("0.5\n0\n0\n-0.5\n1\n", "6 lines.*5"),
            ("0.5\n0\n0\n-0.5\n1\nnan\n", "line 6"),
            ("0\n0\n0\n-0.5\n1\n2\n", "area"),
            ("0.000002\n0\n0\n-0.000002\n-7.5\n40.2\n", "degrees"),
            ("", "6 lines"),
        ],
    )
    def test_bad_world_file_names_its_fault(self, text, complaint):
        with pytest.raises(ConfigError, match=f"bad.tfw.*{complaint}"):
            find_fix(params(), WIDTH, HEIGHT, world_file=WorldFile("bad.tfw", text))

    def test_tags_without_area_are_refused(self):
        with pytest.raises(ConfigError, match="area"):
            find_fix(params(), WIDTH, HEIGHT, tags=GeoTags((1.0, 0.0, 0.0, 2.0, 0.0, 0.0), "EPSG:26913"))


class TestControlPoints:
    def test_three_points_fix_but_tell_no_residual(self):
        fix = find_fix(params(control_points=points(NORTH_UP, SPREAD[:3])), WIDTH, HEIGHT)
        assert fix.residual_m is None
        np.testing.assert_allclose(
            homography.apply(fix.reference_to_ground, PLACES), homography.apply(NORTH_UP, PLACES), atol=1e-6
        )

    def test_oblique_view_is_seen_in_eight_points(self):
        fix = find_fix(params(control_points=points(OBLIQUE, SPREAD)), WIDTH, HEIGHT)
        np.testing.assert_allclose(fix.reference_to_ground, OBLIQUE, rtol=1e-6)
        assert fix.residual_m == pytest.approx(0, abs=1e-6)

    def test_four_points_of_an_oblique_view(self):
        fix = find_fix(params(control_points=points(OBLIQUE, SPREAD[:4])), WIDTH, HEIGHT)
        np.testing.assert_allclose(fix.reference_to_ground, OBLIQUE, rtol=1e-6)
        assert fix.residual_m is None

    def test_noise_shows_as_residual_and_does_not_invent_perspective(self):
        noise = np.random.default_rng(3).normal(0, 0.2, SPREAD.shape)
        fix = find_fix(params(control_points=points(NORTH_UP, SPREAD, noise)), WIDTH, HEIGHT)
        assert fix.reference_to_ground[2, 0] == 0
        assert 0.1 < fix.residual_m < 0.4
        error = homography.apply(fix.reference_to_ground, PLACES) - homography.apply(NORTH_UP, PLACES)
        assert 0.01 < np.abs(error).max() < 0.6

    @pytest.mark.parametrize("blunder", range(len(SPREAD)))
    def test_one_blunder_among_eight_is_left_out(self, blunder):
        noise = np.zeros(SPREAD.shape)
        noise[blunder] = (40, -25)
        fix = find_fix(params(control_points=points(NORTH_UP, SPREAD, noise)), WIDTH, HEIGHT)
        assert fix.left_out == (blunder,)
        np.testing.assert_allclose(
            homography.apply(fix.reference_to_ground, PLACES), homography.apply(NORTH_UP, PLACES), atol=1e-6
        )

    def test_order_of_points_does_not_matter(self):
        noise = np.random.default_rng(5).normal(0, 0.3, SPREAD.shape)
        given = points(NORTH_UP, SPREAD, noise)
        one = find_fix(params(control_points=given), WIDTH, HEIGHT)
        other = find_fix(params(control_points=given[::-1]), WIDTH, HEIGHT)
        np.testing.assert_allclose(one.reference_to_ground, other.reference_to_ground, rtol=1e-9, atol=1e-9)

    def test_exchanged_axes_are_found_out(self):
        swapped = [{**p, "x_m": p["y_m"], "y_m": p["x_m"]} for p in points(NORTH_UP, SPREAD)]
        with pytest.raises(ConfigError, match="exchanged"):
            find_fix(params(control_points=swapped), WIDTH, HEIGHT)


class TestOtherCrs:
    degrees = GeoTags((-7.5034665502899385, 1.9e-6, 0.0, 40.269448601242665, 0.0, -1.9e-6), "EPSG:4326")

    def test_degrees_are_refused_with_the_zone_to_set(self):
        with pytest.raises(ConfigError, match=r"EPSG:32629"):
            find_fix(params(), WIDTH, HEIGHT, tags=self.degrees)

    def test_degrees_are_projected_where_a_crs_is_set(self):
        from pyproj import Transformer

        fix = find_fix(params(crs="EPSG:32629"), WIDTH, HEIGHT, tags=self.degrees)
        x0, dx, _, y0, _, dy = self.degrees.geotransform
        col, row = PLACES.T
        exact = Transformer.from_crs("EPSG:4326", "EPSG:32629", always_xy=True).transform(
            x0 + (col + 0.5) * dx, y0 + (row + 0.5) * dy
        )
        np.testing.assert_allclose(homography.apply(fix.reference_to_ground, PLACES), np.column_stack(exact), atol=1e-3)
        assert fix.crs == "EPSG:32629"
        assert 0 <= fix.residual_m < 1e-3
        assert fix.gsd_m == pytest.approx((0.162, 0.211), abs=0.002)

    def test_same_crs_in_other_words_is_not_transformed(self):
        from pyproj import CRS

        tags = GeoTags((480_000.0, 0.5, 0.0, 4_301_000.0, 0.0, -0.5), CRS.from_epsg(26913).to_wkt())
        fix = find_fix(params(crs="epsg:26913"), WIDTH, HEIGHT, tags=tags)
        assert fix.residual_m is None
        assert fix.crs == "EPSG:26913"

    def test_feet_are_refused_or_transformed(self):
        tags = GeoTags((3_100_000.0, 1.0, 0.0, 1_700_000.0, 0.0, -1.0), "EPSG:2232")  # Colorado Central, US survey feet
        with pytest.raises(ConfigError, match="metres"):
            find_fix(params(), WIDTH, HEIGHT, tags=tags)
        fix = find_fix(params(crs="EPSG:26913"), WIDTH, HEIGHT, tags=tags)
        assert fix.gsd_m == pytest.approx((0.3048, 0.3048), rel=2e-3)

    def test_tags_without_crs_take_the_survey_s(self):
        tags = GeoTags((480_000.0, 0.5, 0.0, 4_301_000.0, 0.0, -0.5), None)
        assert find_fix(params(crs="EPSG:26913"), WIDTH, HEIGHT, tags=tags).crs == "EPSG:26913"
        assert find_fix(params(), WIDTH, HEIGHT, tags=tags).crs is None
