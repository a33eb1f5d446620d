"""Frames and archives that nobody on this project made, or made for the program's sake, run from end to end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import vtrack_batch as vt
from vtrack_batch.evaluation.evaluate import evaluate
from vtrack_batch.evaluation.load import load_result, load_truth
from vtrack_batch.pipeline.run import RunReport
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.write import simulate

pytestmark = pytest.mark.real


def run_archive(folder: Path, archive: Path, gsd_m: float) -> RunReport:
    survey = {
        "archive": {"root": str(archive / "frames"), "index": str(archive / "times.csv")},
        "georeference": {"gsd_m": gsd_m},
    }
    (folder / "survey.yaml").write_text(json.dumps(survey))
    return vt.run_survey(vt.load_survey(folder / "survey.yaml"), workers=1)


def moving(folder: Path) -> pd.DataFrame:
    trajectories = vt.open_results(folder / "results")["trajectories"]
    return trajectories.loc[(trajectories["path_m"] > 8.0) & (trajectories["points"] >= 5)]


def test_movers_of_munich_street_are_found_and_linked(shared_data: Path, tmp_path: Path) -> None:
    archive = shared_data / "kit-ais" / "MunichStreet02"
    report = run_archive(tmp_path, archive, 0.12)
    assert (report.frames_used, report.frames_quarantined) == (20, 0)
    numbers = evaluate(load_result(tmp_path / "results"), load_truth(archive)).numbers
    movers = numbers["detection"]["movers"]
    assert movers["recall"]["value"] >= 0.75
    assert movers["precision"]["value"] >= 0.50
    assert numbers["links"]["precision"]["value"] >= 0.85


@pytest.mark.parametrize(
    ("name", "gsd_m", "frames", "movers"), [("StuttgartAutobahn01", 0.17, 23, 12), ("MunichAutobahn01", 0.15, 16, 5)]
)
def test_motorways_run_to_the_end_with_plausible_paths(
    shared_data: Path, tmp_path: Path, name: str, gsd_m: float, frames: int, movers: int
) -> None:
    report = run_archive(tmp_path, shared_data / "kit-ais" / name, gsd_m)
    assert report.frames_used == frames
    found = moving(tmp_path)
    assert len(found) >= movers
    assert found["mean_speed_mps"].quantile(0.9) > 5.0
    assert found["mean_speed_mps"].max() < 60.0


def test_a_rendered_city_is_seen(shared_data: Path, tmp_path: Path) -> None:
    archive = shared_data / "rendered" / "city"
    run_archive(tmp_path, archive, 0.33)
    numbers = evaluate(load_result(tmp_path / "results"), load_truth(archive)).numbers
    assert numbers["detection"]["detections"]["f1"]["value"] >= 0.85


def test_a_geotiff_archive_comes_out_in_its_own_crs(shared_data: Path, tmp_path: Path) -> None:
    photo = shared_data / "georeferenced" / "colorado.tif"
    ground = {"orthophoto": str(photo), "pedestrians_per_km": 0}
    times = {"duration_s": 45.0, "interval_s": 0.75}
    scenario = Scenario.model_validate({"scene": "street", "seed": 3, "ground": ground} | times)
    simulate(scenario, tmp_path)
    report = vt.run_survey(vt.load_survey(tmp_path / "survey.yaml"))
    assert report.exit_code == 0
    results = vt.open_results(tmp_path / "results")
    assert set(results["references"]["crs"].astype(str)) == {"EPSG:26913"}
    assert set(results["references"]["method"].astype(str)) == {"geotiff"}
    truth = pd.read_parquet(tmp_path / "truth" / "detections.parquet")
    found = results["detections"]
    offsets = []
    for t_utc, true in truth.groupby("t_utc"):
        near = found.loc[found["t_utc"] == t_utc, ["x_m", "y_m"]].to_numpy()
        for xy in true[["x_m", "y_m"]].to_numpy():
            offset = near - xy
            if len(near) and np.hypot(*offset.T).min() < 1.5:
                offsets.append(offset[np.hypot(*offset.T).argmin()])
    assert len(offsets) >= 20
    # a wrong convention would put all vehicles half a pixel (0.075 m) or more to one side
    assert np.hypot(*np.median(offsets, axis=0)) < 0.1
