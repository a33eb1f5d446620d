"""Looking again: where frames before and after say that a vehicle is due, weaker boxes than elsewhere are vehicles.

A grey body fades into the asphalt in one frame and is seen in the next. What is taken in both neighbouring frames, at
one place or on one straight way, was at its middle in between; what has no such neighbours stays noise. Source:
hysteresis (Canny 1986), along time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.detection.candidates import Candidates
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.detection.place import Place
from vtrack_batch.model import homography
from vtrack_batch.model.flags import DetectionFlag
from vtrack_batch.model.homography import Array

_MISS_M, _CHANGE = 1.0, 0.1  # of the way from the frame before to the one after, speed may change so much
_COS_TURN = float(np.cos(np.radians(25.0)))


def seen_again(
    taken: Sequence[Candidates],
    faint: Sequence[Candidates],
    poses: Sequence[Array],
    times_s: Array,
    place: Place,
    *,
    params: DetectionParams,
) -> list[NDArray[np.bool_]]:
    """Return for every frame which of its *faint* candidates (n,) bool, whole and on the road, are due there.

    *taken* are its vehicles. Frames in any order of *times_s* (n,) seconds; *poses* take each frame's px to the
    reference's.
    """
    due = [np.zeros(len(found), np.bool_) for found in faint]
    if not place.learned:
        return due
    order = np.argsort(times_s, kind="stable")
    known = [_by_x(*_placed(found, pose, place)) for found, pose in zip(taken, poses, strict=True)]
    for before, now, after in zip(order[:-2], order[1:-1], order[2:], strict=True):
        if not (times_s[before] < times_s[now] < times_s[after]):
            continue
        share = (times_s[now] - times_s[before]) / (times_s[after] - times_s[before])
        limits = share, params.fastest_mps * (times_s[now] - times_s[before]), params.chain_colour
        xy, axis, colour = _placed(faint[now], poses[now], place)
        whole = (faint[now].flags & int(DetectionFlag.TOUCHES_BORDER)) == 0
        due[now] = whole & place.on_road(xy) & _due(xy, axis, colour, known[before], known[after], limits)
    return due


def _placed(found: Candidates, pose: Array, place: Place) -> tuple[Array, Array, Array]:
    """Return places (n, 2) in the reference's metres, unit axes (n, 2) there and colours (n, 3)."""
    centre = np.stack([found.col_px, found.row_px], axis=1)
    local = homography.jacobian(pose, centre)
    along = np.einsum("nij,nj->ni", local, np.stack([found.lx_px, found.ly_px], axis=1)) * place.metres_per_px
    axis = along / np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    colour = np.stack([found.red, found.green, found.blue], axis=1)
    return homography.apply(pose, centre) * place.metres_per_px, axis, colour


def _by_x(xy: Array, axis: Array, colour: Array) -> tuple[Array, Array, Array]:
    order = np.argsort(xy[:, 0], kind="stable")
    return xy[order], axis[order], colour[order]


@njit(cache=True, nogil=True)
def _due(xy, axis, colour, earlier, later, limits):  # type: ignore[no-untyped-def]
    """Return which places (n, 2) lie where the way from one of the *earlier* to one of the *later* ones leads by.

    Those of before and after come by x; only who is near enough is asked.
    """
    share, reach, colour_limit = limits
    due, earlier_x, later_x = np.zeros(len(xy), np.bool_), earlier[0][:, 0], later[0][:, 0]
    farthest = (reach + _MISS_M) / max(share - _CHANGE, _CHANGE)
    off = (_MISS_M + _CHANGE * farthest) / share
    for n in range(len(xy)):
        for i in range(np.searchsorted(earlier_x, xy[n, 0] - reach), np.searchsorted(earlier_x, xy[n, 0] + reach)):
            ax, ay = xy[n, 0] - earlier[0][i, 0], xy[n, 1] - earlier[0][i, 1]
            if due[n] or ax * ax + ay * ay > reach * reach:
                continue
            if not _alike(axis[n], earlier[1][i], colour[n], earlier[2][i], colour_limit):
                continue
            ahead = earlier[0][i, 0] + ax / share
            for k in range(np.searchsorted(later_x, ahead - off), np.searchsorted(later_x, ahead + off)):
                dx, dy = later[0][k, 0] - earlier[0][i, 0], later[0][k, 1] - earlier[0][i, 1]
                away = np.hypot(dx, dy)
                ex, ey = ax - share * dx, ay - share * dy
                if np.hypot(ex, ey) > _MISS_M + _CHANGE * away:
                    continue
                if not _alike(axis[n], later[1][k], colour[n], later[2][k], colour_limit):
                    continue
                # Who drives does so along the axis, and is not far aside.
                if away <= _MISS_M or (
                    abs(axis[n, 0] * dx + axis[n, 1] * dy) >= _COS_TURN * away
                    and abs(ex * dy - ey * dx) <= _MISS_M * away
                ):
                    due[n] = True
                    break
    return due


@njit(cache=True, nogil=True)
def _alike(axis, other, colour, its_colour, limit):  # type: ignore[no-untyped-def]
    same_way = abs(axis[0] * other[0] + axis[1] * other[1]) >= _COS_TURN
    return same_way and np.abs(colour - its_colour).max() <= limit
