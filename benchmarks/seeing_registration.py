"""Registration, ours and peers', on frames whose true poses are known: error over the whole frame, and time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.environment import run_peer
from vtrack_batch.archive.decode import decode
from vtrack_batch.background.params import BackgroundParams
from vtrack_batch.model import homography
from vtrack_batch.registration.alignment import register
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.reference import prepare_reference
from vtrack_batch.registration.steady import steady_patches

Pixels = NDArray[np.uint8]
Matrix = NDArray[np.float64]
Timed = tuple[list[Matrix | None], NDArray[np.float64]]
"""A pose, frame to reference, or None, for each frame; seconds for each frame."""

MAX_PIXELS = 200_000_000
GRID = 15


@dataclass(frozen=True)
class Flown:
    """Frames with true poses (n, 3, 3), reference to frame; ``reference`` = index of the frame all are laid on."""

    paths: tuple[Path, ...]
    poses: Matrix
    reference: int


def flown(archive: Path) -> Flown:
    """Read the frames' paths and the true poses of a rendered archive."""
    place = archive / "truth" if (archive / "truth").is_dir() else archive
    poses = pd.read_csv(place / "poses.csv").set_index("frame").to_numpy().reshape(-1, 3, 3)
    paths = tuple(sorted(path for path in (archive / "frames").rglob("*") if path.is_file()))
    if len(paths) != len(poses):
        raise ValueError(f"{archive}: {len(paths)} frames but {len(poses)} poses")
    return Flown(paths, poses, len(paths) // 2)


def compare(work: Flown) -> pd.DataFrame:
    """Return one row a method: median and largest RMS over frames, frames lost, ms a frame."""
    methods: dict[str, Callable[[Flown], Timed]] = {
        "ours": ours,
        "stabilo, defaults (ORB)": stabilo,
        "ORB 3000, homography by MAGSAC": orb,
        "ECC homography, 1/4 scale": ecc,
    }
    rows = []
    for name, method in methods.items():
        poses, seconds = method(work)
        error = errors_px(work, poses)
        rows.append(
            {
                "method": name,
                "median_px": np.nanmedian(error) if np.isfinite(error).any() else np.nan,
                "max_px": np.nanmax(error) if np.isfinite(error).any() else np.nan,
                "lost": int(np.isnan(error).sum()),
                "ms": 1e3 * float(np.median(seconds)),
            }
        )
    return pd.DataFrame(rows)


def errors_px(work: Flown, poses: Sequence[Matrix | None]) -> NDArray[np.float64]:
    """Return the RMS distance (n,) in reference px over a grid of the whole frame; NaN where there is no pose."""
    height, width = read(work.paths[work.reference]).shape[:2]
    grid = np.stack(np.meshgrid(np.linspace(0, width - 1, GRID), np.linspace(0, height - 1, GRID)), axis=-1)
    grid = grid.reshape(-1, 2)
    error = np.full(len(work.paths), np.nan)
    for i, pose in enumerate(poses):
        if pose is not None and i != work.reference:
            true = work.poses[work.reference] @ np.linalg.inv(work.poses[i])
            distance = homography.apply(pose, grid) - homography.apply(true, grid)
            error[i] = np.sqrt((distance**2).sum(axis=1).mean())
    return np.delete(error, work.reference)


def ours(work: Flown) -> Timed:
    """Lay frames as a run does: on the patches that a first look at some of the frames finds steady."""
    params = RegistrationParams()
    reference = read(work.paths[work.reference])
    rough = prepare_reference(reference, params=params)
    most = max(3, min(BackgroundParams().samples, int(1e9 / reference.nbytes)))
    chosen = np.unique(np.linspace(0, len(work.paths) - 1, most).astype(int))
    laid = [register(read(work.paths[i]), rough, params=params) for i in chosen if i != work.reference]
    steady, _ = steady_patches(rough, [pose for pose in laid if pose.accepted], params=params)

    def pose_of(pixels: Pixels) -> Matrix | None:
        pose = register(pixels, steady, params=params)
        return pose.frame_to_reference if pose.accepted else None

    return timed(work, pose_of)


def orb(work: Flown) -> Timed:
    """ORB features of both frames, cross-checked; homography by MAGSAC++."""
    finder, matcher = cv2.ORB.create(nfeatures=3000), cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    there, target = finder.detectAndCompute(grey(read(work.paths[work.reference])), None)

    def laid(pixels: Pixels) -> Matrix | None:
        here, source = finder.detectAndCompute(grey(pixels), None)
        if source is None or len(here) < 8:
            return None
        pairs = matcher.match(source, target)
        cv2.setRNGSeed(1)
        matrix, _ = cv2.findHomography(
            np.array([here[pair.queryIdx].pt for pair in pairs]),
            np.array([there[pair.trainIdx].pt for pair in pairs]),
            cv2.USAC_MAGSAC,
            2.0,
            maxIters=5000,
            confidence=0.999,
        )
        return matrix

    return timed(work, laid)


def ecc(work: Flown) -> Timed:
    """Enhanced correlation coefficient (Evangelidis & Psarakis 2008) of frames at a quarter of their size."""
    reference = quarter(read(work.paths[work.reference]))
    up = np.array([[4.0, 0, 1.5], [0, 4.0, 1.5], [0, 0, 1]])
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-5)

    def laid(pixels: Pixels) -> Matrix | None:
        start = np.eye(3, dtype=np.float32)
        try:
            _, matrix = cv2.findTransformECC(reference, quarter(pixels), start, cv2.MOTION_HOMOGRAPHY, stop, None, 5)
        except cv2.error:
            return None  # "images are uncorrelated": it says so by an exception
        to_reference = np.linalg.inv(up @ matrix.astype(float) @ np.linalg.inv(up))
        return to_reference / to_reference[2, 2]

    return timed(work, laid)


def stabilo(work: Flown) -> Timed:
    """Stabilo with its defaults, in an environment of its own."""
    paths = pd.DataFrame({"path": [str(path) for path in work.paths]})
    answer = run_peer("stabilo", "stabilo", {"frames": paths}, reference=work.reference)
    matrices = answer["poses"].to_numpy().reshape(-1, 3, 3)
    return [m if np.isfinite(m).all() else None for m in matrices], answer["seconds"]["seconds"].to_numpy()


def timed(work: Flown, laid: Callable[[Pixels], Matrix | None]) -> Timed:
    """Lay every frame, and time all but the reading."""
    poses, seconds = [], []
    for path in work.paths:
        pixels = read(path)
        start = time.process_time()
        poses.append(laid(pixels))
        seconds.append(time.process_time() - start)
    return poses, np.array(seconds)


def read(path: Path) -> Pixels:
    """Return the pixels (H, W, 3) of a frame."""
    return decode(path.read_bytes(), max_pixels=MAX_PIXELS).pixels


def grey(pixels: Pixels) -> Pixels:
    """Return luminance (H, W)."""
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))


def quarter(pixels: Pixels) -> Pixels:
    """Return luminance at a quarter of the size."""
    image = grey(pixels)
    rows, columns = image.shape[0] // 4, image.shape[1] // 4
    return np.asarray(cv2.resize(image[: 4 * rows, : 4 * columns], (columns, rows), interpolation=cv2.INTER_AREA))
