"""A small simulated archive that the tests of the pipeline share."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.write import simulate


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with frames, truth, zones and survey.yaml: 40 frames of 640 x 360."""
    folder = tmp_path_factory.mktemp("simulated")
    sections = {
        "camera": {"width_px": 640, "height_px": 360},
        "ground": {"parked": 8},
        "traffic": {"demand_vph": 500.0},
    }
    simulate(Scenario.model_validate({"duration_s": 60.0, "seed": 7} | sections), folder)
    # units of 30 s, so that there are several
    with (folder / "survey.yaml").open("a") as stream:
        stream.write("execution:\n  unit_s: 30.0\n  halo_s: 15.0\n")
    return folder


@pytest.fixture
def archive(simulated: Path, tmp_path: Path) -> Path:
    """A private copy of the simulated archive without its truth."""
    folder = tmp_path / "survey"
    folder.mkdir()
    shutil.copytree(simulated / "frames", folder / "frames")
    for name in ("survey.yaml", "zones.geojson"):
        shutil.copy(simulated / name, folder / name)
    return folder
