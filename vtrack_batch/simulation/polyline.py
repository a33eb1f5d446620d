"""Lines of points (n, 2): places along them, parallels, ribbons and dashes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vtrack_batch.model.homography import Array

_SHARPEST = 0.35
"""Least cosine of half a bend that a parallel line follows; a sharper corner is cut off."""


def lengths(line: Array) -> Array:
    """Return the arc length (n,) at each point."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])


def along(line: Array, s_m: ArrayLike) -> tuple[Array, Array]:
    """Return the points (k, 2) and unit directions (k, 2) at the arc lengths *s_m* (k,), kept within the line."""
    s, at = lengths(line), np.atleast_1d(np.asarray(s_m, float))
    steps = np.diff(line, axis=0)
    piece = np.clip(np.searchsorted(s, at, side="right") - 1, 0, len(steps) - 1)
    direction = steps[piece] / np.maximum(np.hypot(*steps[piece].T), 1e-9)[:, None]
    points = np.stack([np.interp(at, s, line[:, 0]), np.interp(at, s, line[:, 1])], axis=1)
    return points, direction


def clean(line: Array) -> Array:
    """Return the line without points that repeat the one before."""
    keep = np.concatenate([[True], np.hypot(*np.diff(line, axis=0).T) > 1e-3])
    return np.asarray(line[keep])


def parallel(line: Array, left_m: float) -> Array:
    """Return the line (n, 2) that runs *left_m* to the left (negative: to the right), mitred at its bends."""
    step = np.diff(line, axis=0)
    step /= np.hypot(*step.T)[:, None]
    before, after = np.vstack([step[:1], step]), np.vstack([step, step[-1:]])
    middle = before + after
    size = np.hypot(*middle.T)
    middle = np.where(size[:, None] > 1e-6, middle / np.maximum(size, 1e-6)[:, None], after)
    cosine = np.maximum((middle * after).sum(axis=1), _SHARPEST)
    return np.asarray(line + np.stack([-middle[:, 1], middle[:, 0]], axis=1) * (left_m / cosine)[:, None])


def ribbon(line: Array, right_m: float, left_m: float) -> Array:
    """Return the outline (2n, 2) of the band between the two parallels *right_m* (negative) and *left_m*."""
    return np.vstack([parallel(line, right_m), parallel(line, left_m)[::-1]])


def widened(outline: Array, by_m: float) -> Array:
    """Return a convex *outline* (n, 2) with each corner moved outwards along the mean of its two sides' normals."""
    around = outline if _area(outline) > 0 else outline[::-1]
    closed = np.vstack([around[-1:], around, around[:1]])
    return parallel(closed, -by_m)[1:-1]


def _area(outline: Array) -> float:
    x, y = outline.T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2


def cut(line: Array, begin_m: float, end_m: float) -> Array:
    """Return the part of the line between two arc lengths, at least two points; empty (0, 2) where there is none."""
    s = lengths(line)
    begin, end = max(begin_m, 0.0), min(end_m, float(s[-1]))
    if end - begin < 0.05:
        return np.zeros((0, 2))
    ends, _ = along(line, [begin, end])
    return np.vstack([ends[:1], line[(s > begin + 1e-6) & (s < end - 1e-6)], ends[1:]])


def dashes(line: Array, *, dash_m: float, pitch_m: float, width_m: float) -> list[Array]:
    """Return the outlines of dashes along the line; a pitch of the dash's own length gives pieces without gaps."""
    total = float(lengths(line)[-1])
    pieces = (cut(line, s, s + dash_m) for s in np.arange(0.0, total, pitch_m))
    return [ribbon(piece, -width_m / 2, width_m / 2) for piece in pieces if len(piece)]
