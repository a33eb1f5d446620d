"""The empty ground of a real place can lie under simulated traffic, however it is georeferenced."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
import simplejpeg
from rasterio.transform import Affine

from vtrack_batch.errors import ConfigError
from vtrack_batch.simulation.ground import filled
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.write import simulate

GROUND, SPOT = (96, 98, 94), (30, 160, 60)


def write_background(path: Path, *, transform: Affine | None, crs: str | None = None, hole: bool = False) -> None:
    """Write 200 x 120 px with a green spot at columns 150 to 160, rows 20 to 30."""
    bands = np.empty((4, 120, 200), np.uint8)
    bands[:3] = np.array(GROUND)[:, None, None]
    bands[:3, 20:30, 150:160] = np.array(SPOT)[:, None, None]
    bands[3] = 255
    if hole:
        bands[:, :60, :100] = 0
    profile = {"driver": "GTiff", "dtype": "uint8", "count": 4, "height": 120, "width": 200, "photometric": "RGB"}
    profile["alpha"] = "YES"
    tags = {"transform": transform} if transform is not None else {}
    with rasterio.open(path, "w", crs=crs, **profile, **tags) as target:
        target.write(bands)


def first_frame(folder: Path) -> np.ndarray:
    quiet = {"exposure_drift": 0.0, "cloud": 0.0, "haze": 0.0}
    scenario = Scenario(
        scene="crossing", duration_s=1.5, warm_up_s=10.0, traffic={"demand_vph": 0.0}, light=quiet,
        camera={"width_px": 200, "height_px": 120, "gsd_m": 0.5, "drift_px": 2.0, "noise_dn": 0.0},
        ground={"background": "ground.tif", "pedestrians_per_km": 0.0},
    )  # fmt: skip
    simulate(scenario, folder / "out", base=folder)
    (path,) = (folder / "out" / "frames").iterdir()
    return simplejpeg.decode_jpeg(path.read_bytes())


@pytest.mark.parametrize("crs", [None, "EPSG:25832"])
def test_the_middle_of_the_picture_is_the_middle_of_the_frame_at_its_own_scale(tmp_path: Path, crs: str | None) -> None:
    corner = (0.0, 60.0) if crs is None else (519467.5, 5311669.8)
    write_background(tmp_path / "ground.tif", transform=Affine(0.75, 0, corner[0], 0, -0.75, corner[1]), crs=crs)
    image = first_frame(tmp_path).astype(int)
    green = np.argwhere(image[..., 1] - image[..., 0] > 60)
    # 0.75 m a pixel become 1.5 px of 0.5 m; the spot's middle is 55 px right of and 35 px above the picture's
    assert green.mean(axis=0) == pytest.approx([59.5 - 1.5 * 35, 99.5 + 1.5 * 55], abs=0.6)
    assert np.abs(image[60:, :140] - np.array(GROUND)).max() < 12


def test_without_a_georeference_a_pixel_is_a_pixel(tmp_path: Path) -> None:
    write_background(tmp_path / "ground.tif", transform=None)
    image = first_frame(tmp_path).astype(int)
    green = np.argwhere(image[..., 1] - image[..., 0] > 60)
    assert 80 < len(green) < 120
    assert green.mean(axis=0) == pytest.approx([24.5, 154.5], abs=0.5)


def test_holes_are_filled_from_beside_them_and_nothing_else_changes() -> None:
    rng = np.random.default_rng(2)
    rgb = rng.integers(0, 256, (40, 70, 3)).astype(np.uint8)
    valid = np.ones((40, 70), bool)
    valid[10:20, :30] = False
    result = filled(rgb, valid)
    np.testing.assert_array_equal(result[valid], rgb[valid])
    np.testing.assert_array_equal(result[10, :29], rgb[9, :29])
    np.testing.assert_array_equal(result[19, :29], rgb[20, :29])
    assert filled(rgb, np.ones((40, 70), bool)) is rgb


def test_a_hole_in_the_picture_is_not_black_in_the_frame(tmp_path: Path) -> None:
    write_background(tmp_path / "ground.tif", transform=None, hole=True)
    assert first_frame(tmp_path).min() > 20


def test_degrees_are_refused(tmp_path: Path) -> None:
    write_background(tmp_path / "ground.tif", transform=Affine(1e-5, 0, 9.0, 0, -1e-5, 48.0), crs="EPSG:4326")
    with pytest.raises(ConfigError, match="degrees"):
        first_frame(tmp_path)
