"""Scenes with known motion for the tests of registration."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from vtrack_batch.model import homography

ROWS, COLUMNS, MARGIN = 300, 460, 120


def make_scene(seed: int, rows: int = ROWS + 2 * MARGIN, columns: int = COLUMNS + 2 * MARGIN) -> np.ndarray:
    """Land with fields, roofs and fine texture (rows, columns, 3) uint8; darker to the left, so that it is lopsided."""
    rng = np.random.default_rng(seed)
    ground = 120 + 25 * np.linspace(-1, 1, columns)[None, :] * np.ones((rows, 1))
    for size, height in ((40, 12), (9, 8), (2, 6)):
        ground += height * _unit(cv2.GaussianBlur(rng.normal(size=(rows, columns)), (0, 0), size))
    for _ in range(rows * columns // 1500):
        centre = tuple(float(v) for v in rng.uniform(0, (columns, rows)))
        box = cv2.boxPoints((centre, tuple(float(v) for v in rng.uniform(4, 22, 2)), float(rng.uniform(0, 180))))
        cv2.fillConvexPoly(ground, box.astype(np.int32), float(rng.uniform(30, 230)), lineType=cv2.LINE_AA)
    ground = cv2.GaussianBlur(ground, (0, 0), 0.8)
    return np.clip(np.stack([ground, ground * 0.95, ground * 0.9 + 5], axis=2), 0, 255).astype(np.uint8)


def _unit(image: np.ndarray) -> np.ndarray:
    return (image - image.mean()) / image.std()


def motion(
    *, shift: tuple[float, float] = (0, 0), turn_deg: float = 0, scale: float = 1, tilt: tuple[float, float] = (0, 0)
) -> np.ndarray:
    """Return frame px -> reference px: turned and scaled about the middle, then shifted."""
    middle = np.array([[1, 0, (COLUMNS - 1) / 2], [0, 1, (ROWS - 1) / 2], [0, 0, 1]])
    c, s = scale * np.cos(np.deg2rad(turn_deg)), scale * np.sin(np.deg2rad(turn_deg))
    h = middle @ np.array([[c, -s, shift[0]], [s, c, shift[1]], [*tilt, 1]]) @ np.linalg.inv(middle)
    return h / h[2, 2]


View = Callable[..., np.ndarray]


def camera() -> View:
    """Return a camera over one scene: ``view(frame_to_reference)`` gives the frame, with noise of its own."""
    scene = make_scene(7)

    def look(frame_to_reference: np.ndarray | None = None, *, noise: float = 2.0, seed: int = 1) -> np.ndarray:
        h = np.eye(3) if frame_to_reference is None else frame_to_reference
        inward = np.array([[1, 0, MARGIN], [0, 1, MARGIN], [0, 0, 1.0]])
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        pixels = cv2.warpPerspective(scene, inward @ h, (COLUMNS, ROWS), flags=flags, borderMode=cv2.BORDER_REFLECT)
        grain = np.random.default_rng(seed).normal(0, noise, pixels.shape)
        return np.clip(pixels + grain, 0, 255).astype(np.uint8)

    return look


SCENE = make_scene(7)
_INWARD = np.array([[1, 0, MARGIN], [0, 1, MARGIN], [0, 0, 1.0]])


def wave(size_px: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a smooth, lopsided displacement of points (n, 2) of up to *size_px*, in x more than in y."""

    def shift(points: np.ndarray) -> np.ndarray:
        x, y = np.asarray(points, float).T
        return size_px * np.stack([np.sin(x / 90 + 0.4), 0.6 * np.cos(y / 70 + x / 300)], axis=1)

    return shift


def view(
    pose: np.ndarray | None = None,
    shift: Callable[[np.ndarray], np.ndarray] | None = None,
    *,
    seed: int = 1,
    noise: float = 2.0,
    scene: np.ndarray = SCENE,
) -> np.ndarray:
    """Return a frame with a *pose* (3, 3): it shows at p what a straight one shows at p - shift(p)."""
    columns, rows = np.meshgrid(np.arange(COLUMNS, dtype=float), np.arange(ROWS, dtype=float))
    points = np.stack([columns.ravel(), rows.ravel()], axis=1)
    straight = points if shift is None else points - shift(points)
    at = homography.apply(_INWARD @ (np.eye(3) if pose is None else pose), straight).astype(np.float32)
    maps = at[:, 0].reshape(ROWS, COLUMNS), at[:, 1].reshape(ROWS, COLUMNS)
    pixels = cv2.remap(scene, *maps, cv2.INTER_CUBIC)
    grain = np.random.default_rng(seed).normal(0, noise, pixels.shape)
    return np.clip(np.rint(pixels + grain), 0, 255).astype(np.uint8)
