"""A run publishes whole tables, does again only what is due, and gives the same bytes however it was dealt out."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import duckdb
import geopandas
import numpy as np
import pandas as pd
import polars as pl
import pyarrow.parquet as pq
import pytest

import vtrack_batch as vt
from vtrack_batch.errors import Busy, ConfigError, NoArchive, UnusableData
from vtrack_batch.matching.score import model_text
from vtrack_batch.model.tables import TABLES
from vtrack_batch.pipeline.detect import detect_unit
from vtrack_batch.pipeline.parts import read
from vtrack_batch.pipeline.prepare import prepare
from vtrack_batch.pipeline.run import RunReport, run_survey
from vtrack_batch.storage.output import Output


def run(folder: Path, **options: object) -> RunReport:
    return run_survey(vt.load_survey(folder / "survey.yaml"), **options)  # type: ignore[arg-type]


def tree(snapshot: Path) -> dict[str, str]:
    """Name → hash of every table file of a snapshot."""
    return {
        str(path.relative_to(snapshot)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(snapshot.rglob("*.parquet"))
    }


@pytest.fixture(scope="session")
def golden(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The archive after one undisturbed run."""
    folder = tmp_path_factory.mktemp("golden") / "survey"
    shutil.copytree(simulated, folder, ignore=shutil.ignore_patterns("truth"))
    report = run(folder)
    assert report.exit_code == 0
    assert report.published
    return folder


def test_every_table_is_published_and_read(golden: Path) -> None:
    results = vt.open_results(golden / "results")
    for name in TABLES:
        read = pd.read_parquet(golden / "results" / "current" / name)
        assert list(read.columns)[: len(TABLES[name].columns)] == list(TABLES[name].column_names)
        assert len(read) == len(results[name])
    for name in ("frames", "registrations", "references", "detections", "matches", "trajectories", "track_points"):
        assert len(results[name]), name
    for name in ("crossings", "od_pairs", "turns", "speeds", "flows", "coverage"):
        assert name in TABLES
        assert set(pd.read_parquet(golden / "results" / "current" / name)["date"].astype(str)) <= {"2026-05-17"}


def test_tables_agree_with_each_other(golden: Path) -> None:
    results = vt.open_results(golden / "results")
    frames, detections, points = results["frames"], results["detections"], results["track_points"]
    assert set(detections["frame_id"]) <= set(frames["frame_id"])
    assert set(points["detection_id"].dropna()) <= set(detections["detection_id"])
    assert set(points["vehicle_id"]) == set(results["trajectories"]["vehicle_id"])
    assert not points.duplicated(["vehicle_id", "t_utc"]).any()
    everything = results["od_pairs"].loc[lambda t: t["vehicle_class"].astype(str) == "all", "count"].sum()
    assert everything == pytest.approx(len(results["trajectories"]))


def test_pictures_report_and_ground_are_there(golden: Path) -> None:
    snapshot = (golden / "results" / "current").resolve()
    names = {path.name for path in (snapshot / "report").iterdir()}
    assert "report.html" in names
    assert any(name.endswith("trajectories.png") for name in names)
    assert any(name.endswith("frames.png") for name in names)
    assert list((snapshot / "ground").glob("*.tif"))
    manifest = json.loads((snapshot / "manifest.json").read_text())
    assert manifest["frames"] == {"used": 40, "quarantined": 0}


def test_a_second_run_computes_nothing(golden: Path) -> None:
    before = (golden / "results" / "current").resolve()
    report = run(golden)
    assert not any(report.done.values())
    assert not report.published
    assert report.exit_code == 0
    assert (golden / "results" / "current").resolve() == before


def test_two_workers_and_a_shuffled_archive_give_the_same_bytes(golden: Path, archive: Path) -> None:
    frames = sorted((archive / "frames").iterdir())
    for path in reversed(frames):
        shutil.copy(path, archive / "moved.tmp")
        path.unlink()
        shutil.move(archive / "moved.tmp", path)
    run(archive, workers=2)
    assert tree((archive / "results" / "current").resolve()) == tree((golden / "results" / "current").resolve())


def test_a_late_frame_redoes_its_unit_and_its_day_only(golden: Path, archive: Path) -> None:
    late = sorted((archive / "frames").iterdir())[35]  # 52.5 s: in the second unit, out of the first one's halo
    held = archive / late.name
    shutil.move(late, held)
    assert run(archive).done == {"detect": 2, "track": 1, "traffic": 1, "picture": 1}
    shutil.move(held, late)
    due = prepare(vt.load_survey(archive / "survey.yaml")).due
    assert {(d.piece.step, d.reason) for d in due} == {
        ("detect", "changed: frames"),
        ("track", "changed: what it builds on"),
        ("traffic", "changed: what it builds on"),
        ("picture", "changed: what it builds on"),
    }
    assert run(archive).done == {"detect": 1, "track": 1, "traffic": 1, "picture": 1}
    assert tree((archive / "results" / "current").resolve()) == tree((golden / "results" / "current").resolve())


def test_a_changed_bin_redoes_the_traffic_only(archive: Path, golden: Path) -> None:
    shutil.copytree(golden / "results", archive / "results", symlinks=True)
    with (archive / "survey.yaml").open("a") as stream:
        stream.write("traffic:\n  bin_s: 300\n")
    assert run(archive).done == {"detect": 0, "track": 0, "traffic": 1, "picture": 1}


def name_a_missing_file(archive: Path, golden: Path, line: str, told: str) -> None:
    """Give the survey of a finished archive a *line* that names a file which is not there."""
    shutil.copytree(golden / "results", archive / "results", symlinks=True)
    with (archive / "survey.yaml").open("a") as stream:
        stream.write(line)
    with pytest.raises(ConfigError, match=told):
        run(archive)


def test_a_flow_map_is_part_of_what_tracks_are_made_of(archive: Path, golden: Path) -> None:
    name_a_missing_file(archive, golden, "flow_map: place.flow\n", r"no such file; see `flow_map`")
    for speed_mps, work in ((8.0, 1), (9.0, 1), (9.0, 0)):
        vt.FlowMap(np.array([[10.0, -20.0]]), np.array([[speed_mps, 0.0]])).save(archive / "place.flow")
        assert run(archive).done == {"detect": 0, "track": work, "traffic": work, "picture": work}


def test_a_model_of_links_is_part_of_what_tracks_are_made_of(archive: Path, golden: Path) -> None:
    name_a_missing_file(archive, golden, "matching: {model: site.json}\n", r"no such file; see `matching\.model`")
    (archive / "site.json").write_text("{}")
    with pytest.raises(UnusableData, match="is no model of links"):
        run(archive)
    (archive / "site.json").write_text(model_text(None))
    for work in (1, 0):
        assert run(archive).done == {"detect": 0, "track": work, "traffic": work, "picture": work}


def test_former_parameters_are_published_again_without_work(archive: Path, golden: Path) -> None:
    shutil.copytree(golden / "results", archive / "results", symlinks=True)
    former, before = (archive / "survey.yaml").read_text(), tree((archive / "results" / "current").resolve())
    assert prepare(vt.load_survey(archive / "survey.yaml")).up_to_date()
    (archive / "survey.yaml").write_text(former + "traffic:\n  bin_s: 300\n")
    run(archive)
    (archive / "survey.yaml").write_text(former)
    prepared = prepare(vt.load_survey(archive / "survey.yaml"))
    assert not prepared.due
    assert not prepared.up_to_date()
    assert run(archive).published
    assert tree((archive / "results" / "current").resolve()) == before


def test_force_does_a_step_and_what_follows_again(archive: Path, golden: Path) -> None:
    shutil.copytree(golden / "results", archive / "results", symlinks=True)
    due = prepare(vt.load_survey(archive / "survey.yaml"), force="traffic").due
    assert [(d.piece.step, d.reason) for d in due] == [("traffic", "forced"), ("picture", "forced")]
    report = run(archive, force="traffic")
    assert report.done == {"detect": 0, "track": 0, "traffic": 1, "picture": 1}
    assert not report.published, "the same bytes again"


def test_frames_outside_the_period_are_set_aside_but_no_loss(archive: Path) -> None:
    text = (archive / "survey.yaml").read_text()
    (archive / "survey.yaml").write_text(text.replace("survey:\n", 'survey:\n  end: "2026-05-17T06:00:15Z"\n'))
    report = run(archive)
    assert (report.exit_code, report.frames_used, report.frames_quarantined) == (0, 10, 0)
    assert len(vt.open_results(archive / "results")["quarantine"]) == 30


def test_the_manifest_lists_every_table_file_with_its_hash(golden: Path) -> None:
    snapshot = (golden / "results" / "current").resolve()
    listed = json.loads((snapshot / "manifest.json").read_text())["files"]
    assert {place: about["sha256"] for place, about in listed.items() if place.endswith(".parquet")} == tree(snapshot)


def test_a_bad_frame_is_set_aside_and_the_run_goes_on(archive: Path) -> None:
    frames = sorted((archive / "frames").iterdir())
    frames[10].write_bytes(frames[10].read_bytes()[: frames[10].stat().st_size // 2])
    frames[11].write_text("<html>not found</html>")
    frames[12].write_bytes(b"")
    frames[30].write_bytes(cv2.imencode(".jpg", np.zeros((360, 640, 3), np.uint8))[1].tobytes())
    frames[31].write_bytes(cv2.imencode(".jpg", np.full((100, 90, 3), 99, np.uint8))[1].tobytes())
    for repeat in frames[21:23]:
        repeat.write_bytes(frames[20].read_bytes())
    report = run(archive)
    assert report.exit_code == 3
    lost = vt.open_results(archive / "results")["quarantine"].set_index("path")["reason"].astype(str)
    assert lost.to_dict() == {
        frames[10].name: "truncated",
        frames[11].name: "not_an_image",
        frames[12].name: "empty",
        frames[30].name: "blank",
        frames[31].name: "geometry_changed",
        frames[21].name: "frozen",
        frames[22].name: "frozen",
    }
    assert report.frames_used == 33


def test_a_sequence_that_begins_blank_is_not_passed_over_in_silence(archive: Path) -> None:
    frames = sorted((archive / "frames").iterdir())
    for number, path in enumerate(frames[:5]):
        path.write_bytes(cv2.imencode(".jpg", np.full((360, 640, 3), number, np.uint8))[1].tobytes())
    with pytest.raises(UnusableData, match="5 blank, 35 no_site_frame"):
        run(archive)
    (archive / "survey.yaml").write_text(
        (archive / "survey.yaml")
        .read_text()
        .replace("gsd_m: 0.33\n", f"gsd_m: 0.33\n  reference_frame: {frames[7].name}\n")
    )
    assert run(archive).frames_used == 35


def test_nothing_usable_publishes_nothing(archive: Path) -> None:
    for path in (archive / "frames").iterdir():
        path.write_bytes(b"\xff\xd8\xff rubbish")
    with pytest.raises(UnusableData, match="none of 40"):
        run(archive)
    assert not (archive / "results" / "current").exists()


def test_two_frames_and_one_frame_are_enough_for_tables(archive: Path) -> None:
    for path in sorted((archive / "frames").iterdir())[1:]:
        path.unlink()
    assert run(archive).exit_code == 0
    results = vt.open_results(archive / "results")
    assert len(results["frames"]) == 1
    assert results["trajectories"].empty


def test_an_unmounted_archive_is_not_an_empty_survey(archive: Path, golden: Path) -> None:
    shutil.copytree(golden / "results", archive / "results", symlinks=True)
    before = tree((archive / "results" / "current").resolve())
    shutil.rmtree(archive / "frames")
    with pytest.raises(NoArchive, match="no such folder"):
        run(archive)
    (archive / "frames").mkdir()
    with pytest.raises(NoArchive):
        run(archive)
    assert tree((archive / "results" / "current").resolve()) == before


def test_a_second_run_at_once_is_refused(archive: Path) -> None:
    output = Output(archive / "results")
    output.create()
    with output.locked(), pytest.raises(Busy, match="process"):
        run(archive)
    command = [sys.executable, "-m", "vtrack_batch", "run", "survey.yaml", "-q"]
    with output.locked():
        held = subprocess.run(command, cwd=archive, capture_output=True, text=True, check=False)
    assert held.returncode == 75
    assert "Traceback" not in held.stderr


def test_an_output_in_the_way_is_told(archive: Path) -> None:
    (archive / "results").write_text("a file")
    command = [sys.executable, "-m", "vtrack_batch", "run", "survey.yaml", "-q"]
    told = subprocess.run(command, cwd=archive, capture_output=True, text=True, check=False)
    assert told.returncode == 73
    assert "output.root" in told.stderr


@pytest.mark.parametrize("zones", ["[1, 2]", '{"type": "FeatureCollection", "features": [{}]}', "not json"])
def test_a_broken_zone_file_stops_the_run_before_it_costs_time(archive: Path, zones: str) -> None:
    (archive / "zones.geojson").write_text(zones)
    with pytest.raises(ConfigError, match=r"zones\.geojson"):
        run(archive)
    assert not list((archive / "results" / "data").glob("detect/*"))


def test_without_zones_they_are_proposed_and_it_is_said(archive: Path) -> None:
    text = (archive / "survey.yaml").read_text().replace("zones: zones.geojson\n", "")
    (archive / "survey.yaml").write_text(text)
    run(archive)
    snapshot = (archive / "results" / "current").resolve()
    assert json.loads((snapshot / "manifest.json").read_text())["zones_proposed"]
    assert list((snapshot / "report").glob("proposed-zones-*.geojson"))
    assert "proposed" in (snapshot / "report" / "report.html").read_text()


def test_metres_a_pixel_are_never_guessed(archive: Path) -> None:
    text = (archive / "survey.yaml").read_text().replace("  gsd_m: 0.33\n", "  rotation_deg: 0.0\n")
    (archive / "survey.yaml").write_text(text)
    with pytest.raises(ConfigError, match="never guessed"):
        run(archive)


def test_a_file_that_changes_between_index_and_decode_is_set_aside(archive: Path) -> None:
    survey = vt.load_survey(archive / "survey.yaml")
    Output(archive / "results").create()
    prepared = prepare(survey)
    changed = sorted((archive / "frames").iterdir())[5]
    changed.write_bytes(sorted((archive / "frames").iterdir())[9].read_bytes())
    detect_unit(prepared.plan.detect[0], prepared.context)
    lost = read([prepared.context.part(prepared.plan.detect[0])], "quarantine")
    assert lost["path"].tolist() == [changed.name]
    assert lost["reason"].astype(str).tolist() == ["changed_while_running"]


@pytest.mark.parametrize("name", list(TABLES))
def test_the_snapshot_is_read_alike_by_all_readers(golden: Path, name: str) -> None:
    folder = (golden / "results" / "current").resolve() / name
    rows = len(pd.read_parquet(folder))
    assert pq.read_table(folder).num_rows == rows
    assert pl.read_parquet(folder / "**/*.parquet").height == rows
    assert duckdb.sql(f"select count(*) from '{folder}/**/*.parquet'").fetchall() == [(rows,)]
    if name == "trajectories":
        lines = geopandas.read_parquet(folder)
        assert len(lines) == rows
        assert set(lines.geometry.geom_type) <= {"LineString"}
