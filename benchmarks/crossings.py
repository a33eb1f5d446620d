"""Rendered crossings of ten minutes, long enough for stands and for places with many vehicles."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.jobs import quick
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.view_params import CameraParams
from vtrack_batch.simulation.write import simulate


def crossings(first_seed: int) -> Iterator[tuple[int, Path]]:
    """Yield seed and folder of five archives (QUICK: of one); a folder is gone when all have been asked for."""
    camera = CameraParams(width_px=1280, height_px=800)
    with tempfile.TemporaryDirectory() as place:
        for seed in range(first_seed, first_seed + (1 if quick() else 5)):
            folder = Path(place) / str(seed)
            simulate(Scenario(seed=seed, duration_s=600.0, warm_up_s=420.0, camera=camera), folder)
            yield seed, folder
