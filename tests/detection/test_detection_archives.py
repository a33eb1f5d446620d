"""Whole chapters on archives of others: background, candidates and place, with known poses where there are some."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from scipy.optimize import linear_sum_assignment

from vtrack_batch.background.learn import Sample, learn_background
from vtrack_batch.background.params import BackgroundParams
from vtrack_batch.detection.candidates import find_candidates
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.detection.place import learn_place, select
from vtrack_batch.model import homography


def read(path: Path) -> np.ndarray:
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)


def matched(found: np.ndarray, true: np.ndarray, gate: float) -> tuple[np.ndarray, np.ndarray]:
    distance = np.hypot(found[:, None, 0] - true[None, :, 0], found[:, None, 1] - true[None, :, 1])
    i, j = linear_sum_assignment(np.minimum(distance, 10 * gate))
    near = distance[i, j] <= gate
    return i[near], j[near]


@pytest.mark.real
def test_rendered_city(shared_data: Path) -> None:
    folder = shared_data / "rendered" / "city"
    poses = [np.linalg.inv(row.reshape(3, 3)) for row in pd.read_csv(folder / "poses.csv").to_numpy()[:, 1:]]
    files = sorted((folder / "frames").iterdir())
    samples = [Sample(read(files[i]), poses[i]) for i in range(0, 80, 4)]
    background = learn_background(samples, params=BackgroundParams())
    params = DetectionParams()
    chosen = [10, 11, 12, 13, 14, 15]
    found = [
        find_candidates(read(files[i]), poses[i], background, metres_per_px=(0.33, 0.33), params=params) for i in chosen
    ]
    place = learn_place(
        found, [poses[i] for i in chosen], np.array(chosen) * 1.5, metres_per_px=(0.33, 0.33), params=params
    )
    truth, parked = pd.read_csv(folder / "truth.csv"), pd.read_csv(folder / "parked.csv")
    hits = wrong = total = 0
    for n, i in enumerate(chosen):
        kept = found[n].take(select(found[n], poses[i], place, frame=n, params=params))
        seen = np.stack([kept.col_px, kept.row_px], axis=1)
        true = truth.loc[truth["frame"] == i, ["col_px", "row_px"]].to_numpy()
        right, _ = matched(seen, true, 5.0)
        rest = np.delete(seen, right, axis=0)
        standing = homography.apply(np.linalg.inv(poses[i]), parked[["ref_col_px", "ref_row_px"]].to_numpy())
        rest = np.delete(rest, matched(rest, standing, 10.0)[0], axis=0)
        inside = ((rest > 12) & (rest < np.array([1920, 1080]) - 12)).all(axis=1)
        hits, wrong, total = hits + len(right), wrong + int(inside.sum()), total + len(true)
    precision, recall = hits / (hits + wrong), hits / total
    assert 0.88 < 2 * precision * recall / (precision + recall) <= 1
    assert precision > 0.88
