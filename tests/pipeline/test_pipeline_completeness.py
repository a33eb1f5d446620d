"""Completeness by injection as a run does it: told in coverage, and nowhere else to be seen."""

from __future__ import annotations

import shutil
from pathlib import Path

import pandas as pd
import pytest

import vtrack_batch as vt
from vtrack_batch.completeness.params import CompletenessParams
from vtrack_batch.completeness.table import INJECTIONS
from vtrack_batch.storage.output import Output
from vtrack_batch.storage.parquet import read_table


def run(folder: Path, injections: int) -> Path:
    survey = vt.load_survey(folder / "survey.yaml")
    changed = {
        "completeness": CompletenessParams(injections_per_unit=injections),
        "output": survey.output.model_copy(update={"root": f"results-{injections}"}),
    }
    survey = survey.model_copy(update=changed).based_at(folder)
    vt.run_survey(survey)
    return survey.resolve(survey.output.root)


@pytest.fixture(scope="module")
def folders(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("painted")
    (folder / "frames").symlink_to(simulated / "frames")
    for name in ("survey.yaml", "zones.geojson"):
        shutil.copy(simulated / name, folder / name)
    return run(folder, 0), run(folder, 60)


def table(out: Path, name: str) -> pd.DataFrame:
    return pd.read_parquet(out / "current" / name)


def test_nothing_that_is_painted_gets_into_a_table(folders: tuple[Path, Path]) -> None:
    plain, painted = folders
    for name in ("detections", "track_points", "trajectories", "od_pairs", "registrations"):
        pd.testing.assert_frame_equal(table(plain, name), table(painted, name))
    same = [name for name in table(plain, "coverage") if not name.startswith("completeness")]
    pd.testing.assert_frame_equal(table(plain, "coverage")[same], table(painted, "coverage")[same])


def test_coverage_tells_how_many_come_back(folders: tuple[Path, Path]) -> None:
    plain, painted = (table(out, "coverage") for out in folders)
    assert plain["completeness"].isna().all()
    told = painted[painted["completeness"].notna()]
    assert len(told) >= 1
    assert told["completeness"].between(0.7, 1.0).all()
    assert (told["completeness_lo"] <= told["completeness"]).all()
    assert (told["completeness"] <= told["completeness_hi"]).all()
    assert (told["completeness_lo"] < 1).all()


def test_what_was_painted_is_kept_with_the_unit(folders: tuple[Path, Path]) -> None:
    output = Output(folders[1])
    files = [output.part("detect", key).file(f"{INJECTIONS.name}.parquet") for key in sorted(output.keys("detect"))]
    rows = read_table(files, INJECTIONS)
    assert 60 <= rows["painted"].sum() <= 300
    assert rows["found"][~rows["painted"]].all()
    assert 0.7 < rows["found"][rows["painted"]].mean() <= 1.0
    assert set(rows["paint"]) <= {"dark", "grey", "light", "coloured"}
