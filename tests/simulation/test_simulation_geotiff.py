"""Frames rendered onto an orthophoto keep its CRS, and their tags say to the centimetre where they lie."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rasterio
from rasterio.transform import Affine

from vtrack_batch.errors import ConfigError
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.write import simulate

STREET_PX = ((-10.0, 90.0), (330.0, 40.0))
STREET = Scenario.model_validate(
    {
        "scene": "street", "duration_s": 6.0, "interval_s": 0.5, "warm_up_s": 40.0, "seed": 8,
        "traffic": {"demand_vph": 2400.0, "speed_limit_mps": 9.0},
        "camera": {"drift_px": 5.0, "jitter_px": 0.6},
        "ground": {"street_px": STREET_PX, "orthophoto": "photo.tif", "pedestrians_per_km": 0},
    }
)  # fmt: skip
TRANSFORM = Affine(0.15, 0.002, 519467.5, 0.003, -0.151, 4311669.8)


def write_photo(folder: Path, *, crs: str, dtype: str = "uint8") -> None:
    rng = np.random.default_rng(1)
    bands = rng.integers(60, 90, (3, 210, 340)).astype(dtype)
    profile = {"driver": "GTiff", "dtype": dtype, "count": 3, "height": 210, "width": 340}
    with rasterio.open(folder / "photo.tif", "w", crs=crs, transform=TRANSFORM, **profile) as target:
        target.write(bands)


def check(out: Path, crs: str, *, within_m: float) -> int:
    rows = pd.read_parquet(out / "truth" / "detections.parquet")
    times = np.sort(rows["t_utc"].unique())
    checked = 0
    for k, path in enumerate(sorted((out / "frames").iterdir())):
        with rasterio.open(path) as frame:
            assert frame.crs.to_string() == crs
            assert frame.dtypes == ("uint8",) * 3
            here = rows[rows["t_utc"] == times[k]]
            x, y = frame.transform @ np.array([here["col_px"] + 0.5, here["row_px"] + 0.5])
        error = np.hypot(x - here["x_m"], y - here["y_m"])
        assert (error < within_m).all()
        checked += len(here)
    return checked


def test_tags_and_truth_agree(tmp_path: Path) -> None:
    write_photo(tmp_path, crs="EPSG:26913")
    summary = simulate(STREET, tmp_path / "out", base=tmp_path)
    assert summary["frames"] == 12
    assert check(tmp_path / "out", "EPSG:26913", within_m=1e-4) > 20
    origins = []
    for path in sorted((tmp_path / "out" / "frames").iterdir()):
        assert path.name.startswith("street_2026")
        with rasterio.open(path) as frame:
            origins.append([frame.transform.c, frame.transform.f])
    moved = np.ptp(np.array(origins), axis=0)
    assert (moved > 0.05).all()
    assert (moved < 3.0).all()


def test_heading_is_that_of_the_street(tmp_path: Path) -> None:
    write_photo(tmp_path, crs="EPSG:26913")
    simulate(STREET.model_copy(update={"frames": False}), tmp_path / "out", base=tmp_path)
    rows = pd.read_parquet(tmp_path / "out" / "truth" / "detections.parquet")
    ends = [TRANSFORM @ end for end in STREET_PX]
    along = np.subtract(ends[1], ends[0])
    expected = np.rad2deg(np.arctan2(along[0], along[1])) % 180
    assert rows["heading_deg"].between(expected - 0.5, expected + 0.5).all()
    assert len(rows) > 20


def test_degrees_and_floats_are_refused(tmp_path: Path) -> None:
    write_photo(tmp_path, crs="EPSG:4326")
    with pytest.raises(ConfigError, match="projected"):
        simulate(STREET, tmp_path / "out", base=tmp_path)
    write_photo(tmp_path, crs="EPSG:26913", dtype="float32")
    with pytest.raises(ConfigError, match="8 bits"):
        simulate(STREET, tmp_path / "out", base=tmp_path)


@pytest.mark.real
def test_colorado(shared_data: Path, tmp_path: Path) -> None:
    ground = STREET.ground.model_copy(update={"orthophoto": "georeferenced/colorado.tif"})
    scenario = STREET.model_copy(update={"ground": ground})
    simulate(scenario, tmp_path / "out", base=shared_data)
    assert check(tmp_path / "out", "EPSG:26913", within_m=1e-4) > 20
