"""GeoTIFF bytes say the same ground as they were given, and the same input gives the same bytes."""

from __future__ import annotations

import resource
import struct

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from vtrack_batch.errors import ConfigError, UnusableData, UnusableFrame
from vtrack_batch.georeference.fix import find_fix
from vtrack_batch.georeference.params import GeoreferenceParams
from vtrack_batch.model import homography
from vtrack_batch.model.ground_grid import GroundGrid
from vtrack_batch.storage.geotiff import merge_geotiffs, read_geotags, read_reduced, write_geotiff

GRID = GroundGrid("EPSG:26913", 480_000.0, 4_301_000.0, 0.5, (30, 50))


def tiff(transform: Affine | None, crs: str | None = "EPSG:26913", **tags: str) -> bytes:
    with rasterio.MemoryFile() as memory:
        profile = {"driver": "GTiff", "width": 50, "height": 30, "count": 3, "dtype": "uint8", "crs": crs}
        with memory.open(**profile, **({"transform": transform} if transform else {})) as dataset:
            dataset.write(np.zeros((3, 30, 50), np.uint8))
            dataset.update_tags(**tags)
        return memory.read()


def tie_point(data: bytes) -> tuple[float, ...]:
    """ModelTiepoint (tag 33922) as it stands in the bytes, by the TIFF 6.0 book."""
    order = "<" if data[:2] == b"II" else ">"
    at = struct.unpack(order + "I", data[4:8])[0]
    for entry in range(struct.unpack(order + "H", data[at : at + 2])[0]):
        tag, _, count, where = struct.unpack(order + "HHII", data[at + 2 + 12 * entry : at + 14 + 12 * entry])
        if tag == 33922:
            return struct.unpack(f"{order}{count}d", data[where : where + 8 * count])
    raise AssertionError("no tie point")


class TestTags:
    def test_area(self):
        tags = read_geotags(tiff(Affine(0.5, 0, 480_000, 0, -0.5, 4_301_000)))
        assert tags.geotransform == (480_000, 0.5, 0, 4_301_000, 0, -0.5)
        assert tags.crs == "EPSG:26913"

    def test_point_and_area_are_the_same_ground_in_different_bytes(self):
        transform = Affine(0.5, 0, 480_000, 0, -0.5, 4_301_000)
        area, point = tiff(transform), tiff(transform, AREA_OR_POINT="Point")
        assert tie_point(area)[3:5] == (480_000, 4_301_000)
        assert tie_point(point)[3:5] == (480_000.25, 4_300_999.75)  # the centre of the first pixel
        assert read_geotags(point) == read_geotags(area)

    def test_rotated(self):
        transform = Affine(0.4, 0.1, 100, 0.12, -0.35, 200)
        assert read_geotags(tiff(transform)).geotransform == (100, 0.4, 0.1, 200, 0.12, -0.35)

    def test_without_georeference(self):
        assert read_geotags(tiff(None, None)) is None

    def test_without_crs(self):
        assert read_geotags(tiff(Affine(0.5, 0, 10, 0, -0.5, 20), None)).crs is None

    @pytest.mark.parametrize("data", [b"", b"no picture", b"II*\0"])
    def test_rubbish(self, data):
        with pytest.raises(UnusableFrame, match="malformed"):
            read_geotags(data)


class TestWriting:
    pixels = np.random.default_rng(1).integers(0, 255, (30, 50, 3), np.uint8)
    valid = np.arange(30 * 50).reshape(30, 50) % 7 > 0

    def test_comes_back(self, tmp_path):
        write_geotiff(tmp_path / "a.tif", self.pixels, self.valid, GRID)
        with rasterio.open(tmp_path / "a.tif") as found:
            np.testing.assert_array_equal(np.moveaxis(found.read([1, 2, 3]), 0, 2), self.pixels)
            np.testing.assert_array_equal(found.dataset_mask() > 0, self.valid)
            assert found.crs.to_epsg() == 26913
            assert found.transform == Affine(0.5, 0, 480_000, 0, -0.5, 4_301_000)
            assert found.colorinterp[3].name == "alpha"

    def test_same_bytes_and_nothing_left_over(self, tmp_path):
        for name in ("a.tif", "b.tif"):
            write_geotiff(tmp_path / name, self.pixels, self.valid, GRID)
        assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()
        assert sorted(path.name for path in tmp_path.iterdir()) == ["a.tif", "b.tif"]

    def test_local_frame(self, tmp_path):
        write_geotiff(tmp_path / "a.tif", self.pixels, self.valid, GroundGrid(None, 0.0, 15.0, 0.5, (30, 50)))
        assert read_geotags((tmp_path / "a.tif").read_bytes()).crs is None

    def test_folder_that_is_not_there(self, tmp_path):
        with pytest.raises(OSError, match="absent"):
            write_geotiff(tmp_path / "absent" / "a.tif", self.pixels, self.valid, GRID)

    def test_failed_writing_leaves_the_old_file(self, tmp_path):
        (tmp_path / "a.tif").write_bytes(b"old")
        with pytest.raises(ValueError, match="fit"):
            write_geotiff(tmp_path / "a.tif", self.pixels, self.valid, GroundGrid(None, 0, 0, 0.5, (31, 50)))
        assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"old"]

    def test_a_full_disk_is_an_error_and_leaves_nothing(self, tmp_path):
        room, most = resource.getrlimit(resource.RLIMIT_FSIZE)
        noise = np.random.default_rng(1).integers(0, 255, (600, 600, 3), np.uint8)
        grid = GroundGrid(None, 0.0, 0.0, 0.5, (600, 600))
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, most))
        try:
            with pytest.raises(OSError, match=r"a\.tif|disk"):
                write_geotiff(tmp_path / "a.tif", noise, np.ones((600, 600), bool), grid)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, most))
        assert not list(tmp_path.iterdir())


class TestMerging:
    def write(self, path, x_min_m, y_max_m, value, *, holes=False):
        valid = np.ones((600, 40), bool)
        valid[:, :10] = not holes
        write_geotiff(
            path,
            np.full((600, 40, 3), value, np.uint8),
            valid,
            GroundGrid("EPSG:26913", x_min_m, y_max_m, 0.33, (600, 40)),
        )

    def test_union_first_valid_wins(self, tmp_path):
        self.write(tmp_path / "a.tif", 330.0, 990.0, 10, holes=True)
        self.write(tmp_path / "b.tif", 330.0 - 5 * 0.33, 990.0 + 20 * 0.33, 20)
        merge_geotiffs([tmp_path / "a.tif", tmp_path / "b.tif"], tmp_path / "c.tif")
        with rasterio.open(tmp_path / "c.tif") as found:
            red, alpha = found.read(1), found.read(4)
            assert (found.transform.c, found.transform.f) == pytest.approx((330 - 5 * 0.33, 990 + 20 * 0.33))
        assert red.shape == (620, 45)
        assert (red[:20, :40] == 20).all()
        assert (red[20:600, :15] == 20).all()  # left of the first picture, and its hole
        assert (red[20:, 15:] == 10).all()
        assert (alpha[:20, 40:] == 0).all()
        assert (alpha[600:, :15] == 0).all()

    def test_one_and_none(self, tmp_path):
        self.write(tmp_path / "a.tif", 330.0, 990.0, 10)
        merge_geotiffs([tmp_path / "a.tif"], tmp_path / "c.tif")
        assert (tmp_path / "c.tif").read_bytes() == (tmp_path / "a.tif").read_bytes()
        merge_geotiffs([], tmp_path / "d.tif")
        assert not (tmp_path / "d.tif").exists()

    def test_strangers_are_refused(self, tmp_path):
        self.write(tmp_path / "a.tif", 330.0, 990.0, 10)
        write_geotiff(tmp_path / "b.tif", np.zeros((30, 50, 3), np.uint8), np.ones((30, 50), bool), GRID)
        with pytest.raises(UnusableData, match="different"):
            merge_geotiffs([tmp_path / "a.tif", tmp_path / "b.tif"], tmp_path / "c.tif")


@pytest.mark.real
class TestRealFiles:
    def test_colorado(self, shared_data):
        tags = read_geotags((shared_data / "georeferenced" / "colorado.tif").read_bytes())
        fix = find_fix(GeoreferenceParams(), 383, 232, tags=tags)
        assert fix.crs == "EPSG:26913"
        assert fix.gsd_m == pytest.approx((0.1498155, 0.1499979), abs=1e-6)
        first = homography.apply(fix.reference_to_ground, np.zeros((1, 2)))[0]
        np.testing.assert_allclose(first, [519467.4957275815 + 0.0749078, 4311669.7657353515 - 0.0749989], atol=1e-6)

    def test_roundabout_in_degrees(self, shared_data):
        tags = read_geotags((shared_data / "georeferenced" / "roundabout.tif").read_bytes())
        with pytest.raises(ConfigError, match="EPSG:32629"):
            find_fix(GeoreferenceParams(), 1362, 624, tags=tags)
        fix = find_fix(GeoreferenceParams(crs="EPSG:32629"), 1362, 624, tags=tags)
        assert fix.gsd_m == pytest.approx((0.163, 0.213), abs=0.002)
        assert fix.residual_m < 0.001


@pytest.mark.parametrize("most_px", [1000, 40, 26, 7])
def test_a_reduced_picture_lies_where_the_whole_one_does(tmp_path, most_px):
    pixels, valid = np.zeros((60, 104, 3), np.uint8), np.ones((60, 104), bool)
    pixels[36:48, 16:32] = 240  # its middle is 24 px to the right of the corner, and 42 below it
    valid[:, 96:] = False
    grid = GroundGrid(None, 300.0, 900.0, 0.5, (60, 104))
    write_geotiff(tmp_path / "whole.tif", pixels, valid, grid)
    reduced, to_ground = read_reduced(tmp_path / "whole.tif", most_px)
    assert max(reduced.shape[:2]) <= most_px
    rows, columns = np.nonzero((reduced[:, :, 0] > 100) & (reduced[:, :, 0] <= 240) & (reduced[:, :, 0] != 235))
    x, y, _ = to_ground @ [columns.mean(), rows.mean(), 1]
    pixel_m = 0.5 * 104 / reduced.shape[1]
    assert abs(x - (300 + 24 * 0.5)) <= 0.5 * pixel_m
    assert abs(y - (900 - 42 * 0.5)) <= 0.5 * pixel_m
    assert (reduced[:, -1] == 235).all() or most_px == 7
