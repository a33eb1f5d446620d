"""A long sequence tracked in windows gives what it gives as a whole; parts hold whole chains, each sighting once."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from tracking_worlds import street, utc

from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.tracking.pairs import chain_pairs
from vtrack_batch.tracking.params import TrackingParams, WindowParams
from vtrack_batch.tracking.sightings import of_frames, read_detections, sightings_of
from vtrack_batch.tracking.track import track, track_runs
from vtrack_batch.tracking.windows import linked_in_windows

SMALL = TrackingParams(windows=WindowParams(window_sightings=1000, context_frames=12))


@pytest.fixture(scope="module")
def world():
    return utc(street(1.5, frames=260, vehicles=140, missed=0.1, seed=1))


@pytest.mark.parametrize("method", ["untrained", "regions", "nearest"])
def test_windows_change_nothing(world, method):
    whole, parts = track(world, method=method), track(world, method=method, params=SMALL)
    joint = [(*pair,) for pair in whole.matches[["detection_id_from", "detection_id_to"]].dropna().to_numpy()]
    again = [(*pair,) for pair in parts.matches[["detection_id_from", "detection_id_to"]].dropna().to_numpy()]
    assert len(set(joint) ^ set(again)) <= 0.002 * len(joint)
    points = [t.track_points.dropna(subset=["detection_id"]) for t in (whole, parts)]
    assert abs(len(points[0]) - len(points[1])) <= 0.002 * len(points[0])
    both = points[0].merge(points[1], on="detection_id", suffixes=("", "_part"))
    assert (both["vehicle_id"] == both["vehicle_id_part"]).mean() >= 0.995
    np.testing.assert_allclose(both["x_m"], both["x_m_part"], atol=0.5)


def test_windows_are_used_and_every_sighting_is_told_once(world):
    s = sightings_of(read_detections(world), "all", None, 0.4)
    parts = list(track_runs([s], "untrained", None, MatchingParams(), SMALL))
    assert 3 <= len(parts) <= 20
    matches = pd.concat([part.matches for part in parts])
    assert matches["match_id"].is_unique
    assert matches["detection_id_from"].dropna().is_unique
    assert matches["detection_id_to"].dropna().is_unique
    last, first = world["t_utc"].max(), world["t_utc"].min()
    assert set(matches["detection_id_from"].dropna()) == set(world["detection_id"][world["t_utc"] < last])
    assert set(matches["detection_id_to"].dropna()) == set(world["detection_id"][world["t_utc"] > first])
    assert pd.concat([part.trajectories for part in parts])["vehicle_id"].is_unique


@pytest.mark.parametrize("frames", [7, 100])
def test_runs_of_frames_give_what_the_whole_gives(world, frames):
    s = sightings_of(read_detections(world), "all", None, 0.4)
    cuts = [*range(0, len(s.frame_s), frames), len(s.frame_s)]
    runs = [of_frames(s, low, high) for low, high in pairwise(cuts)]
    whole = list(track_runs([s], "nearest", None, MatchingParams(), SMALL))
    pieces = list(track_runs(iter(runs), "nearest", None, MatchingParams(), SMALL))
    assert len(whole) == len(pieces)
    for one, two in zip(whole, pieces, strict=True):
        for name in ("matches", "trajectories", "track_points"):
            pd.testing.assert_frame_equal(getattr(one, name), getattr(two, name))


def test_a_sequence_that_fits_is_one_window(world):
    short = world[world["t_utc"] < world["t_utc"].min() + pd.Timedelta(seconds=60)]
    s = sightings_of(read_detections(short), "all", None, 0.4)
    assert len(list(track_runs([s], "nearest", None, MatchingParams(), TrackingParams()))) == 1


def test_long_silence_between_windows(world):
    first = world["t_utc"].min()
    later = world.assign(t_utc=world["t_utc"].where(world["t_utc"] < first + pd.Timedelta(seconds=200),
                                                    world["t_utc"] + pd.Timedelta(hours=2)))  # fmt: skip
    found = track(later, method="untrained", params=SMALL).trajectories
    assert ((found["t_end_utc"] - found["t_start_utc"]) < pd.Timedelta(hours=1)).all()
    assert len(found) >= 140


@pytest.mark.parametrize("times", [3, 9])
def test_what_is_held_at_once_does_not_grow_with_the_sequence(world, times):
    s = sightings_of(read_detections(world), "all", None, 0.4)
    frames = len(s.frame_s)
    runs = [of_frames(s, low, min(low + 20, frames)) for low in range(0, frames, 20)]
    gap = s.frame_s[-1] + 1.5
    again = [replace(run, start=run.start + pd.Timedelta(seconds=turn * gap)) for turn in range(times) for run in runs]
    asked, read, told, most_held = [], 0, 0, 0

    def reading():
        nonlocal read
        for run in again:
            read += len(run)
            yield run

    def linked(window):
        asked.append(len(window))
        return chain_pairs(window, "nearest", MatchingParams(), None)

    for part, _ in linked_in_windows(reading(), linked, SMALL.windows, 9.0):
        most_held = max(most_held, read - told)
        told += len(part)
    assert told == read == times * len(s)
    a_frame = int(np.diff(s.first).max())
    window = SMALL.windows.window_sightings + 2 * SMALL.windows.context_frames * a_frame
    assert SMALL.windows.window_sightings <= max(asked) <= window + 20 * a_frame
    assert max(asked) <= most_held <= 2 * window + 20 * a_frame
