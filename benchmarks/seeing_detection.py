"""Detection by peers' backgrounds: everything else - poses, exposure, boxes, place model, scores - is as ours."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.seeing_registration import read
from vtrack_batch.background.exposure import expose, fit_exposure
from vtrack_batch.background.learn import Sample, learn_background
from vtrack_batch.background.params import BackgroundParams
from vtrack_batch.background.shadow import Shadows
from vtrack_batch.background.subtract import OBJECT, SHADOW, UNSEEN, Difference, subtract
from vtrack_batch.detection.candidates import candidates_in
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.detection.place import learn_place, select
from vtrack_batch.evaluation.blocks import time_blocks
from vtrack_batch.evaluation.detection import detection_scores, recall_by_stratum
from vtrack_batch.evaluation.frames import joined_frames
from vtrack_batch.evaluation.load import load_result, load_truth
from vtrack_batch.evaluation.pairing import pair
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.scene import ground_scale, make_scene, sightings
from vtrack_batch.model import homography
from vtrack_batch.model.ranks import take_ranks
from vtrack_batch.model.tables import TABLES
from vtrack_batch.pipeline.parts import matrices_of
from vtrack_batch.storage.parquet import read_table

Pixels = NDArray[np.uint8]
Settings = Mapping[str, float]

UNSEEN_LEVEL = 255
PARAMS = DetectionParams()


@dataclass(frozen=True)
class Aligned:
    """Frames of an archive on their reference's grid at its exposure, as a run registered them.

    ``pictures`` (n, h, w, 3), ``covered`` (n, h, w) bool; ``poses`` frame px to reference px; ``steps`` whole reduction
    of the frames; ``shadows`` as learned by ours and given to all.
    """

    pictures: Pixels
    covered: NDArray[np.bool_]
    poses: NDArray[np.float64]
    frame_ids: tuple[str, ...]
    times_s: NDArray[np.float64]
    gsd_m: float
    step: int
    shadows: Shadows


def aligned(frames: Path, results: Path, gsd_m: float) -> Aligned:
    """Warp all frames of one block to its reference and to its exposure."""
    snapshot = (results / "current").resolve()
    rows = read_table(sorted((snapshot / "registrations").rglob("*.parquet")), TABLES["registrations"])
    about = read_table(sorted((snapshot / "frames").rglob("*.parquet")), TABLES["frames"]).set_index("frame_id")
    rows = rows[rows["accepted"] & (rows["reference_frame_id"] == rows["reference_frame_id"].mode()[0])]
    rows = rows.assign(t_utc=rows["frame_id"].map(about["t_utc"])).sort_values("t_utc")
    step = max(1, round(PARAMS.grid_m / gsd_m))
    to_frame = np.array([[step, 0, (step - 1) / 2], [0, step, (step - 1) / 2], [0, 0, 1.0]])
    poses = matrices_of("h", rows)
    paths = rows["frame_id"].map(about["path"])
    target = reduced(read(frames / paths.iloc[_reference(rows)]), step)
    pictures = np.empty((len(rows), *target.shape), np.uint8)
    covered = np.empty(pictures.shape[:3], bool)
    size = (target.shape[1], target.shape[0])
    for i, path in enumerate(paths):
        picture = reduced(read(frames / path), step)
        to_reference = np.linalg.inv(to_frame) @ poses[i] @ to_frame
        pictures[i] = cv2.warpPerspective(picture, to_reference, size, flags=cv2.INTER_LINEAR)
        whole = np.full(picture.shape[:2], 255, np.uint8)
        covered[i] = cv2.warpPerspective(whole, to_reference, size) == 255
        exposure = fit_exposure(
            np.ascontiguousarray(pictures[i, ::3, ::3]), np.ascontiguousarray(target[::3, ::3]),
            covered[i, ::3, ::3], tile_px=PARAMS.gain_tile_m / gsd_m / step / 3,
        )  # fmt: skip
        expose(pictures[i], exposure.levels, exposure.gain_map(*target.shape[:2]), 0)
    chosen = np.unique(np.linspace(0, len(rows) - 1, 7).astype(int))
    shadows = learn_background([Sample(pictures[i], np.eye(3)) for i in chosen], params=BackgroundParams()).shadows
    times_s = (rows["t_utc"] - rows["t_utc"].iloc[0]).dt.total_seconds().to_numpy()
    return Aligned(pictures, covered, poses, tuple(rows["frame_id"]), times_s, gsd_m, step, shadows)


def _reference(rows: pd.DataFrame) -> int:
    return int(np.flatnonzero((rows["frame_id"] == rows["reference_frame_id"]).to_numpy())[0])


def reduced(picture: Pixels, step: int) -> Pixels:
    """Return *picture* averaged over *step* x *step* pixels."""
    size = (picture.shape[1] // step, picture.shape[0] // step)
    whole = picture[: size[1] * step, : size[0] * step]
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA)) if step > 1 else picture


# peers ----------------------------------------------------------------------------------------------------------------


def by_mixture(work: Aligned, make: Callable[..., Any], limit: str, settings: Settings) -> Iterator[Difference]:
    """MOG2 and KNN of OpenCV; the archive is shown twice, so that the first frames find a learned background."""
    model = make(history=int(settings["history"]), detectShadows=True, **{limit: settings[limit]})
    for picture in work.pictures:
        model.apply(picture)
    for i, picture in enumerate(work.pictures):
        mask = model.apply(picture)
        classes = np.select([~work.covered[i], mask == 255, mask > 0], [UNSEEN, OBJECT, SHADOW], 0).astype(np.uint8)
        evidence = np.where((mask > 0) & work.covered[i], np.uint8(100), np.uint8(0))
        yield Difference(evidence, classes, IDENTITY, np.asarray(model.getBackgroundImage(), np.uint8), np.eye(3))


def by_average(work: Aligned, settings: Settings) -> Iterator[Difference]:
    """Exponential running average, the archive shown twice."""
    mean = work.pictures[0].astype(np.float32)
    for turn, i in itertools.product(range(2), range(len(work.pictures))):
        if turn == 1:
            yield against(work, i, mean.round().astype(np.uint8), settings["threshold"])
        cv2.accumulateWeighted(work.pictures[i], mean, settings["alpha"], work.covered[i].view(np.uint8))


def by_sliding_median(work: Aligned, settings: Settings) -> Iterator[Difference]:
    """Median of the frames around each frame, before and after."""
    count, window = len(work.pictures), int(settings["frames"])
    for i in range(count):
        first = min(max(0, i - window // 2), max(0, count - window))
        stack = work.pictures[first : first + window].copy()
        yield against(work, i, take_ranks(stack, (len(stack) // 2,))[0], settings["threshold"])


def against(work: Aligned, i: int, ground: Pixels, threshold: float) -> Difference:
    """Our own difference from a peer's *ground*, with the tolerance that its edges deserve."""
    grey = cv2.cvtColor(ground, cv2.COLOR_RGB2GRAY)
    square = np.ones((3, 3), np.uint8)
    local_range = cv2.subtract(cv2.dilate(grey, square), cv2.erode(grey, square))
    tolerance = (BackgroundParams().range_share * local_range).astype(np.uint8)
    tolerance[~work.covered[i]] = UNSEEN_LEVEL
    return subtract(
        work.pictures[i],
        np.dstack([ground, tolerance]),
        np.eye(3),
        threshold=threshold,
        shadow_band=work.shadows.band,
        tile_px=PARAMS.gain_tile_m / work.gsd_m / work.step,
    )


IDENTITY = fit_exposure(np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8), bool), tile_px=8)
PEERS: dict[str, tuple[Callable[[Aligned, Settings], Iterator[Difference]], dict[str, Sequence[float]]]] = {
    "MOG2": (
        partial(by_mixture, make=cv2.createBackgroundSubtractorMOG2, limit="varThreshold"),
        {"history": (40, 200), "varThreshold": (9, 16, 36)},
    ),
    "KNN": (
        partial(by_mixture, make=cv2.createBackgroundSubtractorKNN, limit="dist2Threshold"),
        {"history": (40, 200), "dist2Threshold": (200, 400, 800)},
    ),
    "running average": (by_average, {"alpha": (0.01, 0.03, 0.1), "threshold": (9, 14)}),
    "sliding median": (by_sliding_median, {"frames": (15, 31), "threshold": (9, 14)}),
}
"""Name -> differences of all frames, and the grid of settings of which the best on the tuning archive is taken."""


# detections and scores ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Found:
    """Detections ``rows`` (frame_id, col_px, row_px), and ms a frame that the background and the rest took."""

    rows: pd.DataFrame
    background_ms: float


def detect(work: Aligned, name: str, settings: Settings) -> Found:
    """Detect vehicles in all frames with a peer's background."""
    px_per_m = 1 / (work.gsd_m * work.step)
    found, seconds, last = [], 0.0, time.process_time()
    for i, difference in enumerate(PEERS[name][0](work, settings=settings)):
        seconds += time.process_time() - last
        found.append(
            candidates_in(
                work.pictures[i],
                difference,
                px_per_m=(px_per_m, px_per_m),
                steps=(work.step, work.step),
                shadow=work.shadows.direction,
                params=PARAMS,
            )
        )
        last = time.process_time()
    still = [np.eye(3)] * len(found)
    place = learn_place(found, still, work.times_s, metres_per_px=(work.gsd_m, work.gsd_m), params=PARAMS)
    tables = []
    for i, candidates in enumerate(found):
        kept = candidates.take(select(candidates, still[i], place, frame=i, params=PARAMS))
        at = homography.apply(np.linalg.inv(work.poses[i]), np.stack([kept.col_px, kept.row_px], axis=1))
        tables.append(pd.DataFrame({"frame_id": work.frame_ids[i], "col_px": at[:, 0], "row_px": at[:, 1]}))
    return Found(pd.concat(tables, ignore_index=True), 1e3 * seconds / len(found))


def tuned(work: Aligned, results: Path, truth: Path, name: str) -> Settings:
    """Return the settings of a peer's grid with the best F1 on this archive."""
    grid = PEERS[name][1]
    choices = [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]
    worth = [scores(results, truth, detect(work, name, chosen).rows)["f1"]["value"] for chosen in choices]
    return choices[int(np.argmax(worth))]


def scores(results: Path, truth_folder: Path, rows: pd.DataFrame | None = None) -> dict[str, Any]:
    """Return the scores of detections *rows*, or, without them, of all that the run itself detected."""
    params, result, truth = EvaluationParams(), load_result(results), load_truth(truth_folder)
    m_per_px = ground_scale(result.detections)
    if rows is not None:
        names = [f"{frame}-{k}" for k, frame in enumerate(rows["frame_id"])]
        result = replace(result, detections=rows.assign(detection_id=names), track_points=result.track_points.iloc[:0])
    frames, _ = joined_frames(result, truth)
    blocks = time_blocks(frames["t_s"].to_numpy(float), params)
    scene = make_scene(truth, frames, "frame", params)
    paired = pair(sightings(result, truth, frames, "frame"), scene, params, movers_only=truth.scores_movers)
    numbers = detection_scores(paired, blocks)
    return {**numbers, "strata": recall_by_stratum(paired, blocks, params, m_per_px=m_per_px)}
