"""Frames that others took, and rendered ones with exact poses."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd
import pytest

from vtrack_batch.model import homography
from vtrack_batch.registration.alignment import register
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.reference import prepare_reference

pytestmark = pytest.mark.real
PARAMS = RegistrationParams()


def read(path):
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)


def test_rendered_city_within_a_seventh_of_a_pixel(shared_data):
    folder = shared_data / "rendered" / "city"
    poses = pd.read_csv(folder / "poses.csv").set_index("frame")
    reference = prepare_reference(read(folder / "frames" / "f0000.jpg"), params=PARAMS)
    grid = np.stack(np.meshgrid(np.linspace(0, 1919, 15), np.linspace(0, 1079, 9)), axis=-1).reshape(-1, 2)
    for index in range(3, 80, 8):
        found = register(read(folder / "frames" / f"f{index:04d}.jpg"), reference, params=PARAMS)
        exact = np.linalg.inv(poses.loc[index].to_numpy().reshape(3, 3))
        error = homography.apply(found.frame_to_reference, grid) - homography.apply(exact, grid)
        assert found.accepted
        assert 0.0005 < np.sqrt((error**2).sum(axis=1).mean()) < 0.05
        assert 0.01 < found.residual_px < 0.15


@pytest.mark.parametrize(
    ("name", "worst_px"), [("MunichStreet02", 2.5), ("StuttgartAutobahn01", 5.0), ("MunichAutobahn01", 5.0)]
)
def test_no_frame_of_a_real_clip_is_lost(shared_data, name, worst_px):
    frames = [read(path) for path in sorted((shared_data / "kit-ais" / name / "frames").glob("*.png"))]
    reference = prepare_reference(frames[len(frames) // 2], params=PARAMS)
    found = [register(frame, reference, params=PARAMS) for frame in frames]
    assert [pose.reason for pose in found] == [None] * len(frames)
    residuals = np.array([pose.residual_px for pose in found])
    assert residuals.max() < worst_px
    assert 0.3 < np.median(residuals) < 3.0
    # The platform moves smoothly. (In MunichAutobahn01 road and bridge lie on two planes, 9 px apart: either may win.)
    middles = [homography.apply(pose.frame_to_reference, np.array([[300.0, 180]]))[0] for pose in found]
    assert np.linalg.norm(np.diff(middles, axis=0), axis=1).max() < 20


def test_parked_vehicles_stand_still(shared_data):
    folder = shared_data / "kit-ais" / "MunichStreet02"
    frames = [read(path) for path in sorted((folder / "frames").glob("*.png"))]
    middle = len(frames) // 2
    reference = prepare_reference(frames[middle], params=PARAMS)
    poses = [register(frame, reference, params=PARAMS).frame_to_reference for frame in frames]
    boxes = pd.read_csv(folder / "tracks.csv")
    boxes = boxes[boxes["id"].map(pd.read_csv(folder / "vehicles.csv").set_index("id")["motion"]) == "parked"]
    centres = boxes[["left", "top"]].to_numpy() + boxes[["width", "height"]].to_numpy() / 2
    laid = [homography.apply(poses[f - 1], c)[0] for f, c in zip(boxes["frame"], centres, strict=True)]
    boxes = boxes.assign(x=[p[0] for p in laid], y=[p[1] for p in laid])
    first = boxes[boxes["frame"] == middle + 1].set_index("id")
    rest = boxes[(boxes["frame"] != middle + 1) & boxes["id"].isin(first.index)]
    away = np.hypot(rest["x"] - rest["id"].map(first["x"]), rest["y"] - rest["id"].map(first["y"]))
    assert 0.2 < away.groupby(rest["frame"]).median().median() < 1.1
    assert away.groupby(rest["frame"]).median().max() < 1.6


@pytest.mark.parametrize("name", ["MunichStreet02", "StuttgartAutobahn01", "MunichAutobahn01"])
def test_strangers_are_refused(shared_data, name):
    clips = {path.name: read(path / "frames" / "005.png") for path in sorted((shared_data / "kit-ais").iterdir())}
    reference = prepare_reference(clips[name], params=PARAMS)
    assert {other: register(frame, reference, params=PARAMS).accepted for other, frame in clips.items()} == {
        other: other == name for other in clips
    }
