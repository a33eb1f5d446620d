"""A simulated archive: truth and pictures say the same, and a seed says it all."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
import simplejpeg
from simulation_scenes import BARE, scenario

from vtrack_batch.archive.params import ArchiveParams
from vtrack_batch.errors import CannotCreate, ConfigError
from vtrack_batch.model.homography import apply, corners
from vtrack_batch.model.tables import TABLES
from vtrack_batch.model.views import Views
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.write import simulate
from vtrack_batch.traffic.measure import measure
from vtrack_batch.traffic.zones import parse_zones

SMALL = Scenario.model_validate(
    {
        "duration_s": 9.0,
        "warm_up_s": 90.0,
        "seed": 11,
        "camera": {"width_px": 600, "height_px": 330, "drift_px": 9.0, "azimuth_deg": 12.0},
        "ground": {"parked": 12},
    }
)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("small") / "archive"
    summary = simulate(SMALL, out)
    assert summary["frames"] == 6
    return out


@pytest.fixture(scope="module")
def long_truth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four minutes of truth without pictures."""
    out = tmp_path_factory.mktemp("long") / "archive"
    camera = {"width_px": 1400, "height_px": 900}
    simulate(scenario(duration_s=240.0, warm_up_s=120.0, seed=6, camera=camera), out)
    return out


def table(out: Path, name: str) -> pd.DataFrame:
    return pd.read_parquet(out / "truth" / f"{name}.parquet")


def poses(out: Path) -> np.ndarray:
    return pd.read_csv(out / "truth" / "poses.csv").drop(columns="frame").to_numpy().reshape(-1, 3, 3)


def digest(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def test_same_seed_same_bytes_whatever_the_workers(small: Path, tmp_path: Path) -> None:
    simulate(SMALL, tmp_path / "again", workers=2)
    assert digest(tmp_path / "again") == digest(small)


def test_a_second_day_is_of_the_same_place_with_other_traffic(small: Path, tmp_path: Path) -> None:
    summary = simulate(SMALL.model_copy(update={"days": 2}), tmp_path / "two")
    assert summary["frames"] == 12
    alone, both = digest(small / "frames"), digest(tmp_path / "two" / "frames")
    assert alone.items() < both.items()
    assert len(set(both.values())) == 12
    for name in ("frames", "detections", "trajectories", "track_points"):
        day, days = table(small, name), table(tmp_path / "two", name)
        first = days.iloc[: len(day)]
        pd.testing.assert_frame_equal(pd.DataFrame(first), pd.DataFrame(day), check_dtype=False)
        second = days.iloc[len(day) :]
        assert 0.6 * len(day) < len(second) < 1.7 * len(day), name
        if "sequence" in days:
            assert set(second["sequence"]).isdisjoint(first["sequence"])
        if "vehicle_id" in days:
            assert set(second["vehicle_id"]).isdisjoint(first["vehicle_id"])
    t_utc = table(tmp_path / "two", "frames")["t_utc"]
    assert (t_utc.iloc[6:].to_numpy() - t_utc.iloc[:6].to_numpy() == np.timedelta64(1, "D")).all()
    assert len(poses(tmp_path / "two")) == 12
    assert (tmp_path / "two" / "zones.geojson").read_bytes() == (small / "zones.geojson").read_bytes()
    assert digest(tmp_path / "two")["truth/parked.csv"] == digest(small)["truth/parked.csv"]
    ids = pd.read_parquet(tmp_path / "two" / "detections.parquet")["detection_id"]
    assert ids.is_unique


def test_other_seed_other_bytes(small: Path, tmp_path: Path) -> None:
    simulate(SMALL.model_copy(update={"seed": 12}), tmp_path / "other")
    first, second = digest(small), digest(tmp_path / "other")
    assert first.keys() == second.keys()
    same = {name for name in first if first[name] == second[name]}
    assert same <= {"zones.geojson", "survey.yaml", *(name for name in first if name.startswith("sumo/plain"))} | {
        "sumo/loops.add.xml",
        "truth/frames.parquet",
        "truth/queues.parquet",
    }


def test_tables_have_the_declared_columns(small: Path) -> None:
    for name in (
        "frames",
        "detections",
        "track_points",
        "trajectories",
        "crossings",
        "od_pairs",
        "turns",
        "speeds",
        "flows",
    ):
        rows = table(small, name)
        declared = TABLES[name]
        assert set(declared.column_names) <= set(rows.columns), name
        assert not rows.duplicated(list(declared.key)).any(), name
        for column in declared.columns:
            if not column.nullable and len(rows):
                assert rows[column.name].notna().all(), (name, column.name)
            if column.type == "time":
                assert str(rows[column.name].dtype) == "datetime64[us, UTC]", (name, column.name)


def test_pixels_and_metres_agree_through_the_poses(small: Path) -> None:
    rows = table(small, "detections")
    frame = rows["t_utc"].rank(method="dense").to_numpy(int) - 1
    reference = np.column_stack([rows["x_m"] / 0.33 - 0.5, -rows["y_m"] / 0.33 - 0.5])
    seen = np.concatenate([apply(poses(small)[k], reference[[i]]) for i, k in enumerate(frame)])
    assert np.abs(seen - rows[["col_px", "row_px"]].to_numpy()).max() < 1e-6
    assert (frame == 5).any()
    assert np.abs(poses(small)[0] - np.eye(3)).max() == 0
    assert 0.5 < np.abs(poses(small)[5][:2, 2]).max() < 40
    inside = rows["col_px"].between(-0.5, 599.5) & rows["row_px"].between(-0.5, 329.5)
    assert inside.all()


def test_file_names_give_the_times(small: Path) -> None:
    names = sorted(path.name for path in (small / "frames").iterdir())
    assert names[:2] == ["crossing_20260517T060000.000Z.jpg", "crossing_20260517T060001.500Z.jpg"]
    assert names == sorted(names)
    assert len(names) == table(small, "detections")["t_utc"].nunique() == 6


def clean(**changes: object) -> Scenario:
    """The small archive without noise, on bare ground; *changes* are keys of any section, or of none."""
    changes = {"noise_dn": 0.0, "exposure_drift": 0.0, "cloud": 0.0, "shadow": False, "jpeg_quality": 100} | changes
    made = SMALL.model_dump() | {"ground": BARE}
    for key, value in changes.items():
        section = next((name for name in ("camera", "light", "traffic") if key in made[name]), None)
        (made if section is None else made[section])[key] = value
    return Scenario.model_validate(made)


def test_vehicles_stand_where_the_truth_says(tmp_path: Path) -> None:
    simulate(clean(duration_s=7.5), tmp_path / "with")
    simulate(clean(duration_s=7.5, demand_vph=0.0), tmp_path / "without")
    rows = table(tmp_path / "with", "detections")
    found, sizes = [], []
    names = sorted(path.name for path in (tmp_path / "with" / "frames").iterdir())
    for k, name in enumerate(names):
        a, b = ((tmp_path / d / "frames" / name).read_bytes() for d in ("with", "without"))
        difference = np.abs(simplejpeg.decode_jpeg(a).astype(int) - simplejpeg.decode_jpeg(b).astype(int)).max(axis=2)
        # filled outlines, so that glass and dark trim of the ground's own grey do not shift the centre
        mask = cv2.morphologyEx((difference > 14).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
        _, _, stats, centres = cv2.connectedComponentsWithStats(mask)
        here = rows[rows["t_utc"] == rows["t_utc"].drop_duplicates().sort_values().iloc[k]]
        for col, row, length, width, flags in here[["col_px", "row_px", "length_m", "width_m", "flags"]].to_numpy():
            nearest = 1 + np.argmin(np.hypot(*(centres[1:] - [col, row]).T))
            area = stats[nearest, cv2.CC_STAT_AREA] * 0.33**2
            if not flags and 0.85 < area / (length * width) < 1.25:
                found.append(centres[nearest] - [col, row])
                sizes.append(area / (length * width))
    errors = np.array(found)
    assert len(errors) > 35
    assert np.abs(np.median(errors, axis=0)).max() < 0.1
    assert np.median(np.hypot(*errors.T)) < 0.3
    assert 0.95 < np.median(sizes) < 1.2


def test_frames_without_noise_are_the_warped_reference(tmp_path: Path) -> None:
    out = tmp_path / "still"
    simulate(clean(demand_vph=0.0), out)
    frames = [simplejpeg.decode_jpeg(path.read_bytes()) for path in sorted((out / "frames").iterdir())]
    for k in (2, 5):
        back = cv2.warpPerspective(frames[k], np.linalg.inv(poses(out)[k]), (600, 330), flags=cv2.INTER_LINEAR)
        inner = np.abs(back.astype(int) - frames[0])[60:-60, 60:-60]
        shifted = np.abs(frames[k].astype(int) - frames[0])[60:-60, 60:-60]
        assert inner.mean() < 4.0 < shifted.mean()


def test_shadows_darken_the_ground_away_from_the_sun(tmp_path: Path) -> None:
    frames = {}
    for shadow in (True, False):
        out = tmp_path / str(shadow)
        simulate(clean(duration_s=1.5, shadow=shadow, sun_azimuth_deg=90.0), out)
        frames[shadow] = simplejpeg.decode_jpeg(next((out / "frames").iterdir()).read_bytes()).astype(int)
        rows = table(out, "detections")
    darker = (frames[False] - frames[True]).mean(axis=2) > 15
    at = rows[["col_px", "row_px"]].to_numpy()
    near = np.hypot(*(at[:, None] - at[None]).transpose(2, 0, 1)) + 1e9 * np.eye(len(at))
    alone = (near.min(axis=1) > 13) & ((rows["heading_deg"] - 90).abs() > 60)
    places = [(int(r + 0.5), c) for c, r in at[alone] if 8 < c < 590]
    west, east = ([darker[r, int(c + side)] for r, c in places] for side in (-4, 4))
    assert len(places) >= 3
    assert np.mean(west) > 0.6 > 0.3 > np.mean(east)


def test_speeds_follow_from_places(long_truth: Path) -> None:
    points = table(long_truth, "track_points").sort_values(["vehicle_id", "t_utc"])
    same = (points["vehicle_id"] == points["vehicle_id"].shift(2)).to_numpy()
    xy, v = points[["x_m", "y_m"]].to_numpy(), points[["vx_mps", "vy_mps"]].to_numpy()
    measured = (xy - np.roll(xy, 2, axis=0)) / 3.0
    error = np.hypot(*(measured - np.roll(v, 1, axis=0))[same].T)
    assert 0 < np.median(error) < 0.2
    assert np.quantile(error, 0.98) < 2.5
    assert np.allclose(np.hypot(*v.T), points["speed_mps"])


def test_what_is_known_is_what_was_seen(long_truth: Path) -> None:
    trips, crossings = table(long_truth, "trajectories"), table(long_truth, "crossings")
    assert 0.3 < (trips["origin"] != "unknown").mean() < 1
    began = trips["start_reason"] == "start_of_data"
    assert 15 < began.sum() < 150
    # those in view from the first frame can only be known if they still had their gate before them
    assert (trips.loc[began, "origin"] == "unknown").mean() > 0.7
    assert (trips.loc[~began, "origin"] != "unknown").mean() > 0.9
    through = trips[(trips["origin"] != "unknown") & (trips["destination"] != "unknown")]
    assert len(through) > 60
    assert (through["origin"] != through["destination"]).all()
    assert (through["movement"].isin(["left", "through", "right"])).all()
    both = crossings[crossings["vehicle_id"].isin(through["vehicle_id"])].sort_values(["vehicle_id", "t_utc"])
    assert (both.groupby("vehicle_id")["direction"].agg("-".join) == "forward-backward").all()


def test_tables_of_counts_add_up(long_truth: Path) -> None:
    trips, od, turns = (table(long_truth, name) for name in ("trajectories", "od_pairs", "turns"))
    every = od[od["vehicle_class"] == "all"]
    assert every["count"].sum() == len(trips)
    assert od[od["vehicle_class"] != "all"]["count"].sum() == len(trips)
    pair = trips.groupby(["origin", "destination"]).size()
    for (origin, destination), count in pair.items():
        cell = every[(every["origin"] == origin) & (every["destination"] == destination)]
        assert cell["count"].sum() == count
    whole = turns[turns["vehicle_class"] == "all"]
    assert whole["count"].sum() == trips["movement"].notna().sum()
    known = whole[whole["movement"] != "unknown"]
    assert np.allclose(known.groupby(["approach", "bin_start_utc"])["share"].sum(), 1.0)
    assert set(known["movement"]) == {"left", "through", "right"}


def test_traffic_measured_on_the_truth_is_the_truth(long_truth: Path) -> None:
    trips, points = table(long_truth, "trajectories"), table(long_truth, "track_points")
    to_ground = np.array([[0.33, 0, 0.165], [0, -0.33, -0.165], [0, 0, 1]])
    outline = corners(1400, 900)
    footprints = np.stack([apply(to_ground @ np.linalg.inv(pose), outline) for pose in poses(long_truth)])
    start = trips["t_start_utc"].min().tz_convert(None).to_datetime64().astype("datetime64[us]")
    times = start + (np.arange(160) * 1_500_000).astype("timedelta64[us]")
    sequence = trips["sequence"].iloc[0]
    drawn = parse_zones((long_truth / "zones.geojson").read_text(), crs=None, source="zones")
    found = measure(
        trips.drop(columns=["origin", "destination", "movement"]),
        points,
        drawn,
        {sequence: Views(sequence, times, footprints, np.zeros(160))},
        time_zone="Europe/Berlin",
    )
    for name, keys in (("od_pairs", ["origin", "destination"]), ("turns", ["approach", "movement"])):
        keys = [*keys, "vehicle_class", "bin_start_utc"]
        sides = [rows.groupby(keys, observed=True)["count"].sum() for rows in (found[name], table(long_truth, name))]
        both = pd.concat(sides, axis=1, keys=["found", "true"]).fillna(0)
        assert (both["found"] == both["true"]).all(), name
        assert both["true"].sum() > 150


def test_ids_carry_no_order(long_truth: Path) -> None:
    trips = table(long_truth, "trajectories")
    order = trips["t_start_utc"].rank().corr(trips["vehicle_id"].rank())
    assert abs(order) < 0.2
    assert trips["vehicle_id"].is_unique


def test_zones_are_valid_and_face_inwards(small: Path) -> None:
    zones = json.loads((small / "zones.geojson").read_text())
    assert zones["vtrack_coordinates"] == "local_m"
    by_role = {role: [f for f in zones["features"] if f["properties"]["role"] == role] for role in ("gate", "approach")}
    assert {role: len(features) for role, features in by_role.items()} == {"gate": 4, "approach": 4}
    centre = np.array([600 * 0.33 / 2, -330 * 0.33 / 2])
    for feature in by_role["gate"]:
        (x0, y0), (x1, y1) = feature["geometry"]["coordinates"]
        assert (x1 - x0) * (centre[1] - y0) - (y1 - y0) * (centre[0] - x0) < 0, "the inside is on the right"
    east = next(f for f in by_role["gate"] if f["properties"]["id"] == "E")
    assert np.mean([x for x, _ in east["geometry"]["coordinates"]]) > centre[0] + 40


def test_survey_file_is_read_by_the_archive_chapter(small: Path) -> None:
    from ruamel.yaml import YAML

    survey = YAML(typ="safe").load((small / "survey.yaml").read_text())
    ArchiveParams(**survey["archive"])
    assert survey["georeference"] == {"gsd_m": 0.33}
    assert (small / survey["zones"]).is_file()
    assert (small / survey["archive"]["root"]).is_dir()


def test_a_folder_that_holds_something_else_is_refused(small: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("keep me")
    with pytest.raises(CannotCreate, match="not empty"):
        simulate(SMALL, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    with pytest.raises(CannotCreate, match="not empty"):
        simulate(SMALL.model_copy(update={"seed": 99}), small)
    with pytest.raises(CannotCreate, match="cannot be created"):
        simulate(SMALL, tmp_path / "mine.txt" / "below")


def test_no_traffic_writes_empty_tables(tmp_path: Path) -> None:
    made = scenario(traffic={"demand_vph": 0.0}, duration_s=6.0, warm_up_s=5.0)
    summary = simulate(made, tmp_path / "empty")
    assert summary["vehicles"] == 0
    assert len(table(tmp_path / "empty", "od_pairs")) == 0


def test_missing_orthophoto_is_a_mistake_of_the_scenario(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.tif"):
        simulate(scenario(scene="street", ground={"orthophoto": "nowhere.tif"}), tmp_path / "out")
