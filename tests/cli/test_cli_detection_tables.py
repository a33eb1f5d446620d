"""``match``, ``track``, ``learn`` take anybody's tables in any unit that is declared, and tell what they cannot use."""

import json

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from vtrack_batch.cli import _outcome, group, options
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.model.tables import TABLES
from vtrack_batch.storage.parquet import arrow_schema

START = pd.Timestamp("2026-05-17T08:00:00Z")


def street(frames=8, vehicles=6, interval_s=1.0):
    """Vehicles 30 m apart eastward at 12 m/s, on an oblong street, in shuffled rows; the id tells frame and vehicle."""
    rng = np.random.default_rng(4)
    frame, vehicle = (a.ravel() for a in np.meshgrid(np.arange(frames), np.arange(vehicles)))
    paint = rng.uniform(30, 220, (vehicles, 3))[vehicle]
    table = pd.DataFrame(
        {
            "detection_id": [f"f{f}v{v}" for f, v in zip(frame, vehicle, strict=True)],
            "t_utc": START + pd.to_timedelta(frame * interval_s, unit="s"),
            "x_m": 30.0 * vehicle + 12.0 * interval_s * frame + rng.normal(0, 0.2, len(frame)),
            "y_m": 3.0 + rng.normal(0, 0.2, len(frame)),
        }
    )
    table[["red", "green", "blue"]] = np.clip(paint + rng.normal(0, 3, paint.shape), 0, 255)
    return table.sample(frac=1, random_state=2).reset_index(drop=True)


def image(frame):
    rows = street()
    return rows[rows["detection_id"].str.startswith(f"f{frame}")]


def run(*arguments):
    result = CliRunner().invoke(group, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def refused(capsys, *arguments):
    """Return code and message of a mistake."""
    code = _outcome([str(a) for a in arguments])
    told = capsys.readouterr()
    assert told.out == ""
    assert "Traceback" not in told.err
    return code, told.err


def linked(path):
    both = pd.read_parquet(path).dropna(subset=["detection_id_from", "detection_id_to"])
    return dict(zip(both["detection_id_from"], both["detection_id_to"], strict=True))


def one_track_a_vehicle(folder, vehicles=6):
    points = pd.read_parquet(folder / "track_points.parquet")
    vehicle = points["detection_id"].str.split("v").str[1]
    assert points.groupby("vehicle_id").size().tolist() == [8] * vehicles
    assert (vehicle.groupby(points["vehicle_id"]).nunique() == 1).all()
    return points


@pytest.mark.parametrize("kind", ["parquet", "csv"])
@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("method", ["default", "proposed", "regions"])
def test_match_takes_csv_and_parquet_with_and_without_colour(tmp_path, kind, colour, method):
    paths = [tmp_path / f"{name}.{kind}" for name in ("a", "b")]
    for path, frame in zip(paths, (0, 1), strict=True):
        rows = image(frame) if colour else image(frame).drop(columns=["red", "green", "blue"])
        rows.to_csv(path, index=False) if kind == "csv" else rows.to_parquet(path)
    answer = json.loads(run("match", *paths, "--out", tmp_path / "out", "--method", method, "--json"))
    assert answer["linked"] == len(linked(tmp_path / "out" / "matches.parquet")) >= 5
    if method == "default":
        assert linked(tmp_path / "out" / "matches.parquet") == {f"f0v{n}": f"f1v{n}" for n in range(6)}


def test_what_is_written_has_the_declared_schema(tmp_path):
    street().to_parquet(tmp_path / "d.parquet")
    run("track", tmp_path / "d.parquet", "--out", tmp_path / "out")
    for name in ("matches", "trajectories", "track_points"):
        written = pq.read_schema(tmp_path / "out" / f"{name}.parquet")
        declared = arrow_schema(TABLES[name])
        assert written.names == declared.names
        assert written.types == declared.types
        assert written.metadata[b"vtrack.schema"] == declared.metadata[b"vtrack.schema"]
        assert written.field(0).metadata[b"description"] == declared.field(0).metadata[b"description"]


def test_match_without_times_leaves_them_null(tmp_path):
    for name, frame in (("a", 0), ("b", 1)):
        image(frame).drop(columns="t_utc").to_parquet(tmp_path / f"{name}.parquet")
    out = tmp_path / "out"
    run("match", tmp_path / "a.parquet", tmp_path / "b.parquet", "--out", out, "--elapsed-s", "1")
    found = pd.read_parquet(out / "matches.parquet")
    assert found["t_from_utc"].isna().all()
    assert list(found.columns) == list(TABLES["matches"].column_names)
    assert set(found["sequence"]) == {"all"}


def test_declared_units_and_names_give_the_same_tracks(tmp_path):
    rows = street()
    rows.to_parquet(tmp_path / "ours.parquet")
    theirs = pd.DataFrame(
        {
            "Object": rows["detection_id"],
            "Frame": ((rows["t_utc"] - START).dt.total_seconds() * 30).round().astype(int),
            "col": rows["x_m"] / 0.33,
            "row": 500 - rows["y_m"] / 0.33,
        }
    )
    theirs.to_csv(tmp_path / "theirs.csv", index=False)
    plain = tmp_path / "plain.parquet"
    rows.drop(columns=["red", "green", "blue"]).to_parquet(plain)
    run("track", plain, "--out", tmp_path / "one")
    named = ["detection_id=Object", "t_utc=Frame", "x_m=col", "y_m=row"]
    declared = [word for pair in named for word in ("--column", pair)]
    declared += ["--metres-per-unit", "0.33", "--y-down", "--seconds-per-unit", str(1 / 30)]
    run("track", tmp_path / "theirs.csv", "--out", tmp_path / "two", *declared)
    one, two = (one_track_a_vehicle(tmp_path / name) for name in ("one", "two"))
    np.testing.assert_allclose(one["x_m"], two["x_m"], atol=1e-6)
    np.testing.assert_allclose(one["y_m"], two["y_m"] + 165.0, atol=1e-6)
    np.testing.assert_allclose(one["heading_deg"], two["heading_deg"], atol=1e-4)
    assert two["t_utc"].min() == pd.Timestamp(0, tz="UTC")


def test_times_without_a_zone_want_one(tmp_path, capsys):
    rows = street().assign(t_utc=lambda t: t["t_utc"].dt.tz_localize(None))
    rows.to_csv(tmp_path / "d.csv", index=False)
    code, told = refused(capsys, "track", tmp_path / "d.csv", "--out", tmp_path / "o")
    assert code == 78
    assert "--time-zone" in told
    run("track", tmp_path / "d.csv", "--out", tmp_path / "o", "--time-zone", "Asia/Seoul")
    assert one_track_a_vehicle(tmp_path / "o")["t_utc"].min() == START - pd.Timedelta(hours=9)


def test_a_learned_map_can_be_used_by_both(tmp_path):
    street(frames=20).to_parquet(tmp_path / "archive.parquet")
    answer = json.loads(run("learn", tmp_path / "archive.parquet", "--out", tmp_path / "sub" / "place.flow", "--json"))
    learned = FlowMap.load(tmp_path / "sub" / "place.flow")
    assert answer["motions"] == len(learned.xy) > 50
    np.testing.assert_allclose(np.median(learned.velocity, axis=0), [12.0, 0.0], atol=0.3)
    given = ["--flow-map", tmp_path / "sub" / "place.flow"]
    street().to_parquet(tmp_path / "d.parquet")
    run("track", tmp_path / "d.parquet", "--out", tmp_path / "t", *given)
    one_track_a_vehicle(tmp_path / "t")
    for name, frame in (("a", 0), ("b", 1)):
        image(frame).to_parquet(tmp_path / f"{name}.parquet")
    run("match", tmp_path / "a.parquet", tmp_path / "b.parquet", "--out", tmp_path / "m", *given)
    assert linked(tmp_path / "m" / "matches.parquet") == {f"f0v{n}": f"f1v{n}" for n in range(6)}


def test_nothing_to_learn_from_is_told(tmp_path, capsys):
    street(frames=1).to_parquet(tmp_path / "d.parquet")
    code, told = refused(capsys, "learn", tmp_path / "d.parquet", "--out", tmp_path / "place.flow")
    assert code == 65
    assert "more frames" in told
    assert not (tmp_path / "place.flow").exists()


@pytest.mark.parametrize("rows", [0, 1])
def test_none_and_one_are_answered(tmp_path, rows):
    street().head(rows).to_parquet(tmp_path / "d.parquet")
    run("track", tmp_path / "d.parquet", "--out", tmp_path / "t")
    assert len(pd.read_parquet(tmp_path / "t" / "trajectories.parquet")) == 0
    run("match", tmp_path / "d.parquet", tmp_path / "d.parquet", "--out", tmp_path / "m", "--elapsed-s", "1")
    assert len(linked(tmp_path / "m" / "matches.parquet")) == rows


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda t: t.drop(columns="x_m"), 65, "x_m"),
        (lambda t: t.drop(columns=["detection_id", "t_utc"]), 65, "detection_id, t_utc"),
        (lambda t: t.assign(x_m=t["x_m"].mask(t.index < 3)), 65, "x_m is missing or not finite in 3 rows"),
        (lambda t: t.assign(t_utc=t["t_utc"].mask(t.index < 2)), 65, "t_utc is missing in 2 rows"),
        (lambda t: t.assign(t_utc="soon"), 65, "t_utc is not all times"),
        (lambda t: t.assign(t_utc=3.0), 78, "--seconds-per-unit"),
        (lambda t: t.assign(detection_id="x"), 65, "repeated"),
        (lambda t: t.assign(y_m="far"), 65, "y_m is not numeric"),
        (
            lambda t: t.assign(x_m=0.0, y_m=0.0).sample(3000, replace=True).assign(detection_id=range(3000)),
            65,
            "metres",
        ),
    ],
)
def test_bad_tables_are_refused_in_words(tmp_path, capsys, change, code, words):
    change(street(frames=20)).to_parquet(tmp_path / "bad.parquet")
    found, told = refused(capsys, "track", tmp_path / "bad.parquet", "--out", tmp_path / "o")
    assert (found, words in told) == (code, True), told
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--column", "x_m=Easting"], 78, "no column Easting"),
        (["--column", "speed=x_m"], 78, "no column is called speed"),
        (["--column", "x_m"], 2, "OURS=THEIRS"),
        (["--time-zone", "Mars/Olympus", "--column", "t_utc=naive"], 78, "Mars/Olympus"),
        (["--metres-per-unit", "0"], 2, "0"),
        (["--method", "magic"], 2, "magic"),
        (["--flow-map", "nowhere.flow"], 78, "no such file"),
        (["--flow-map", "d.parquet"], 65, "not a flow map"),
    ],
)
def test_bad_options_are_refused_in_words(tmp_path, monkeypatch, capsys, arguments, code, words):
    monkeypatch.chdir(tmp_path)
    rows = street()
    rows.assign(naive=rows["t_utc"].dt.tz_localize(None)).to_parquet("d.parquet")
    found, told = refused(capsys, "track", "d.parquet", "--out", "o", *arguments)
    assert (found, words in told) == (code, True), told


def test_a_file_that_is_no_table_is_told(tmp_path, capsys):
    (tmp_path / "d.parquet").write_bytes(b"no table")
    (tmp_path / "d.csv").write_bytes(b"")
    for name in ("d.parquet", "d.csv"):
        code, told = refused(capsys, "track", tmp_path / name, "--out", tmp_path / "o")
        assert (code, name in told) == (65, True)


def test_match_takes_one_image_a_table(tmp_path, capsys):
    street().to_parquet(tmp_path / "all.parquet")
    image(1).to_parquet(tmp_path / "b.parquet")
    code, told = refused(capsys, "match", tmp_path / "all.parquet", tmp_path / "b.parquet", "--out", tmp_path / "o")
    assert (code, "8 different times" in told) == (65, True)


def test_unsorted_rows_and_frames_that_share_a_time_change_nothing(tmp_path):
    rows = street()
    for name, table in (("a", rows), ("b", rows.sort_values("x_m", ascending=False))):
        table.to_parquet(tmp_path / f"{name}.parquet")
        run("track", tmp_path / f"{name}.parquet", "--out", tmp_path / name)
    for table in ("matches", "trajectories", "track_points"):
        one, two = ((tmp_path / name / f"{table}.parquet").read_bytes() for name in ("a", "b"))
        assert one == two


def test_the_methods_offered_are_those_there_are():
    from typing import get_args

    from vtrack_batch.matching.params import Method

    assert set(options.METHODS) == set(get_args(Method))
