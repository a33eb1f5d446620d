"""Vehicles of known motion come out whole, with their speed, whatever the order of rows and in spite of misses."""

import numpy as np
import pandas as pd
import pytest
import shapely
from tracking_worlds import labels, street, times, utc

from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.model.flags import TrajectoryFlag
from vtrack_batch.model.tables import TABLES
from vtrack_batch.model.views import Views
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.tracking.track import track


@pytest.mark.parametrize("interval_s", [0.25, 0.5, 1.5, 2.5])
@pytest.mark.parametrize("missed", [0.0, 0.15])
def test_every_vehicle_is_one_track(interval_s, missed):
    world = utc(street(interval_s, frames=int(45 / interval_s), missed=missed))
    found = labels(track(world), world)
    assert (found.groupby("vehicle_id")["truth"].nunique() == 1).all()
    seen = world.groupby("truth").size()
    split = found.groupby("truth")["vehicle_id"].nunique().reindex(seen.index[seen > 3])
    assert (split == 1).mean() >= 0.9


def test_without_colour_motion_suffices():
    world = utc(street(1.0, frames=40, missed=0.1, colour=False))
    found = labels(track(world), world)
    assert (found.groupby("vehicle_id")["truth"].nunique() == 1).all()


def test_speeds_lie_within_their_stated_error():
    world = utc(street(1.5, frames=30))
    found = labels(track(world), world)
    inner = found[found.groupby("vehicle_id")["t_utc"].transform("size") > 6]
    error = inner["speed_mps"] - inner["speed"]
    assert 0.02 < error.abs().mean() < 0.4
    assert 0.2 < (error / inner["speed_sigma_mps"]).std() < 1.5
    assert (inner["state"] == "moving").all()


def test_headings_are_clockwise_from_north():
    found = track(utc(street())).track_points.dropna(subset=["heading_deg"])
    east = found["vx_mps"] > 5
    assert east.any()
    assert (~east).any()
    assert (found["heading_deg"][east] - 90).abs().max() < 15
    assert (found["heading_deg"][~east] - 270).abs().max() < 15


def test_misses_are_bridged_by_points_without_a_sighting():
    world = utc(street(1.5, missed=0.2, seed=3))
    tracks = track(world)
    bridged = tracks.track_points["detection_id"].isna()
    assert 0.1 < bridged.mean() < 0.3
    flags = tracks.trajectories.set_index("vehicle_id")["flags"].to_numpy() & int(TrajectoryFlag.BRIDGED_GAP)
    has_gap = bridged.groupby(tracks.track_points["vehicle_id"]).any()
    assert ((flags > 0) == has_gap.reindex(tracks.trajectories["vehicle_id"]).to_numpy()).all()
    spans = (tracks.matches["t_to_utc"] - tracks.matches["t_from_utc"]).dt.total_seconds()
    assert set(spans[tracks.matches.notna().all(axis=1)].round(2)) >= {1.5, 3.0}


def test_tables_have_the_declared_columns_and_keys():
    world = utc(street())
    tracks = track(world)
    for name in ("track_points", "trajectories", "matches"):
        table = getattr(tracks, name)
        assert list(table.columns) == list(TABLES[name].column_names)
        key = list(TABLES[name].key)
        assert not table.duplicated(key).any()
        assert table[key].equals(table.sort_values(key)[key])
        for column in TABLES[name].columns:
            assert column.nullable or table[column.name].notna().all(), (name, column.name)
    lines = shapely.from_wkb(tracks.trajectories["geometry"])
    assert (shapely.get_num_points(lines) == tracks.trajectories["points"]).all()
    np.testing.assert_allclose(shapely.length(lines), tracks.trajectories["path_m"], rtol=1e-9)


def test_every_sighting_has_one_future_and_one_past():
    world = utc(street(missed=0.1))
    matches = track(world).matches
    last, first = world["t_utc"].max(), world["t_utc"].min()
    assert sorted(matches["detection_id_from"].dropna()) == sorted(world["detection_id"][world["t_utc"] < last])
    assert sorted(matches["detection_id_to"].dropna()) == sorted(world["detection_id"][world["t_utc"] > first])
    assert matches["probability"].between(0, 1).all()


@pytest.mark.parametrize("method", ["default", "proposed", "nearest"])
def test_rows_in_any_order_give_the_same_tables(method):
    world = utc(street(missed=0.1, frames=15))
    one, two = track(world, method=method), track(world.sample(frac=1, random_state=9), method=method)
    for name in ("track_points", "trajectories", "matches"):
        pd.testing.assert_frame_equal(getattr(one, name), getattr(two, name))


def test_chains_begin_and_end_with_a_reason():
    trajectories = track(utc(street(1.5, frames=60, vehicles=12))).trajectories
    long = trajectories[trajectories["points"] > 10]
    assert set(long["start_reason"]) <= {"entered_view", "start_of_data"}
    assert (long["start_reason"] == "entered_view").sum() >= 8
    assert set(long["end_reason"]) <= {"left_view", "end_of_data"}


def test_a_vehicle_that_vanishes_inside_the_view_is_lost():
    world = utc(street(1.5, frames=40, vehicles=12))
    hidden = (world["truth"] == 4) & world["x_m"].between(200, 600)
    tracks = track(world[~hidden])
    of_four = labels(tracks, world).query("truth == 4")["vehicle_id"].iloc[0]
    assert tracks.trajectories.set_index("vehicle_id").loc[of_four, "end_reason"] == "lost"


def test_standing_all_its_life_is_parked_and_disturbs_nobody():
    world = utc(street(1.5, frames=40))
    t = np.arange(40) * 1.5
    rng = np.random.default_rng(1)
    standing = utc(
        pd.DataFrame(
            {
                "detection_id": [f"p{n:03d}" for n in range(40)],
                "t_utc": times(t),
                "x_m": 300 + rng.normal(0, 0.3, 40),
                "y_m": 5 + rng.normal(0, 0.3, 40),
                "truth": 99,
                "speed": 0.0,
                "red": 120.0,
                "green": 120.0,
                "blue": 120.0,
            }
        )
    )
    both = pd.concat([world, standing])
    tracks = track(both)
    found = labels(tracks, both)
    assert (found.groupby("vehicle_id")["truth"].nunique() == 1).all()
    assert set(found["state"][found["truth"] == 99]) == {"parked"}
    assert set(found["state"][found["truth"] != 99]) == {"moving"}
    row = tracks.trajectories.set_index("vehicle_id").loc[found["vehicle_id"][found["truth"] == 99].iloc[0]]
    assert (row["origin"], row["destination"], row["start_reason"], row["end_reason"]) == ("parked",) * 4


def test_flickering_false_alarms_leave_the_tracks_whole():
    world = utc(street(1.5, frames=40))
    rng = np.random.default_rng(2)
    count = len(world) // 8
    flicker = world.sample(count, random_state=1).assign(
        x_m=rng.uniform(0, 600, count), y_m=rng.uniform(-4, 4, count), truth=-1, speed=0.0
    )
    flicker["detection_id"] = [f"f{n:04d}" for n in range(count)]
    both = pd.concat([world, flicker])
    found = labels(track(both), both).query("truth >= 0")
    assert found.groupby("truth")["vehicle_id"].nunique().mean() < 1.15


def test_frames_without_detections_count_as_time():
    world = utc(street(1.5, frames=30))
    t = np.sort(world["t_utc"].unique())
    blind = world["t_utc"].isin(t[10:12])
    box = np.array([[-10.0, -20.0], [610.0, -20.0], [610.0, 20.0], [-10.0, 20.0]])
    views = Views(
        "all", pd.DatetimeIndex(t).tz_localize(None).to_numpy("datetime64[us]"), np.tile(box, (30, 1, 1)), np.zeros(30)
    )
    tracks = track(world[~blind], views={"all": views})
    assert tracks.track_points["t_utc"].isin(t[10:12]).any()
    found = labels(tracks, world)
    assert (found.groupby("truth")["vehicle_id"].nunique() == 1).mean() > 0.9


def test_sequences_are_strangers():
    world = utc(street(frames=12))
    twice = pd.concat(
        [world.assign(sequence="a"), world.assign(sequence="b", detection_id="x" + world["detection_id"])]
    )
    tracks = track(twice)
    counts = tracks.trajectories["sequence"].value_counts()
    assert counts["a"] == counts["b"] == len(track(world).trajectories)


@pytest.mark.parametrize("count", [0, 1, 2])
@pytest.mark.parametrize("method", ["default", "proposed"])
def test_hardly_any_detections(count, method):
    tracks = track(utc(street()).head(count), method=method, params=TrackingParams(min_sightings=1))
    assert tracks.track_points["detection_id"].notna().sum() == count
    assert tracks.trajectories["points"].sum() >= count


def test_classes_come_from_size():
    world = utc(street(frames=20, vehicles=8))
    size = world["truth"].map({0: (4.4, 1.8), 1: (6.8, 2.1), 2: (9.5, 2.5), 3: (17.5, 2.6)})
    sized = world.assign(
        length_m=[s[0] if s == s else np.nan for s in size], width_m=[s[1] if s == s else np.nan for s in size]
    )
    tracks = track(sized)
    kind = labels(tracks, world).merge(tracks.trajectories[["vehicle_id", "vehicle_class"]], on="vehicle_id")
    kind = kind.groupby("truth")["vehicle_class"].first()
    assert kind.loc[[0, 1, 2, 3, 4]].tolist() == ["car", "van", "lorry", "bus", "unknown"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.drop(columns="t_utc"), "t_utc"),
        (lambda t: t.assign(t_utc=t["t_utc"].dt.tz_localize(None)), "time zone"),
        (lambda t: t.assign(x_m=np.nan), "x_m"),
        (lambda t: t.assign(detection_id="same"), "repeated"),
        (lambda t: t.assign(t_utc=t["t_utc"].mask(t.index < 4)), "t_utc is missing in 4"),
        (lambda t: t.assign(x_m=7.0, y_m=1.0, t_utc=t["t_utc"].min()), "lie within 10 m of one another, near .7, 1."),
    ],
)
def test_unusable_detections_are_refused(change, words):
    with pytest.raises(UnusableData, match=words):
        track(change(utc(street())))


def test_unknown_methods_are_refused():
    with pytest.raises(ConfigError, match="magic"):
        track(utc(street()), method="magic")
    with pytest.raises(ConfigError, match="magic"):
        track(utc(street()), method="magic", matching=MatchingParams(method="nearest"))


def test_a_hundred_thousand_in_one_frame_are_nobodys_tracks():
    rng = np.random.default_rng(0)
    crowd = pd.DataFrame({"detection_id": np.arange(100_000), "t_utc": times(np.zeros(100_000))})
    crowd[["x_m", "y_m"]] = rng.uniform(0, 1, (len(crowd), 2)) * [9000, 2000]
    tracks = track(utc(crowd))
    assert len(tracks.trajectories) == len(tracks.track_points) == len(tracks.matches) == 0
    two = pd.concat([utc(crowd), utc(crowd.assign(detection_id=10**6 + crowd["detection_id"], t_utc=times([1.5])[0]))])
    with pytest.raises(UnusableData, match="pairs of 100000 and 100000"):
        track(two)


def test_all_at_one_point_is_answered():
    world = utc(street(1.5, frames=12)).assign(x_m=4.0, y_m=9.0)
    tracks = track(world)
    assert len(labels(tracks, world)) <= len(world)
    assert (tracks.track_points[["x_m", "y_m"]].to_numpy() == [4.0, 9.0]).all()
