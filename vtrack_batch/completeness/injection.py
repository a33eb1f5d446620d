"""Which vehicle is painted where in which frame: on free road where others drive, and over those that stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.completeness.boxes import grown, mapped, overlaps
from vtrack_batch.completeness.params import CompletenessParams
from vtrack_batch.model.homography import Array

Ints = NDArray[np.int64]

_CLEAR_M = 0.4
_TURN = np.radians(25.0)
_LONGER = np.log(1.25)
_TRIES = 4
_ALONE_M = 2.0


@dataclass(frozen=True, eq=False)
class Glimpse:
    """What was found in one frame: ``boxes`` (n, 6) in its px, ``pose`` (3, 3) from its px to the reference's.

    ``stay`` (n,) the number of the stay that each belongs to, -1 = none; ``moving`` (n,) bool: surely moves.
    """

    t_s: float
    pose: Array
    boxes: Array
    stay: Ints
    moving: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Injections:
    """What is painted into one frame: ``boxes`` (k, 6) in its px, numbers of the ``donor`` and of the ``stay`` (k,).

    Stay -1 moves, in the place of another or on free road; the rest stand, in the place of others. ``replaced`` (n,)
    bool: which boxes of the frame are painted over.
    """

    boxes: Array
    donor: Ints
    stay: Ints
    replaced: NDArray[np.bool_]


def lone(glimpse: Glimpse, px_per_m: float) -> Ints:
    """Return the rows of the moving vehicles that nothing is near to: those that can be cut out."""
    wide = grown(glimpse.boxes, _ALONE_M * px_per_m)
    near = overlaps(wide, glimpse.boxes).sum(axis=1)
    return np.flatnonzero(glimpse.moving & (near == 1))


def plan_injections(
    glimpses: Sequence[Glimpse],
    sampled: Sequence[int],
    donors: Array,
    *,
    metres_per_px: tuple[float, float],
    params: CompletenessParams,
    seed: tuple[int, ...],
) -> list[Injections]:
    """Return what is painted into each of the *sampled* frames, by their numbers in *glimpses* (all frames of a block).

    *donors* (d, 2): the half axis along each donor in reference px, d > 0. The same *seed* gives the same plan.
    """
    rng = np.random.default_rng([params.seed, *seed])
    scale = np.array([*metres_per_px] * 3)
    boxes = [mapped(g.boxes, g.pose) * scale for g in glimpses]
    times_s = np.array([g.t_s for g in glimpses])
    stays = Stays.of(boxes, times_s, [g.stay for g in glimpses])
    everywhere = np.concatenate([b[g.stay < 0] for b, g in zip(boxes, glimpses, strict=True)])
    donors = donors * scale[:2]
    donor_of = _donors_for(stays.middle, donors, rng)
    chosen = rng.random(len(donor_of)) < params.stay_share
    per_frame = -(-params.injections_per_unit // max(1, len(sampled)))
    plan = []
    for k in sampled:
        here = stays.at(times_s[k])
        here = here[chosen[here]][:per_frame]
        standing = stays.boxes_at(times_s[k])[here]
        most = min(per_frame - len(here), int(np.ceil(params.crowd_share * len(boxes[k]))))
        own = np.flatnonzero(glimpses[k].stay < 0)
        own = own[rng.permutation(len(own))[: most // 2]]
        taken = np.concatenate([boxes[k], standing])
        free = _free(everywhere[rng.permutation(len(everywhere))[: _TRIES * most]], taken, most - len(own))
        moving = np.concatenate([boxes[k][own], free])
        of_moving = _donors_for(moving, donors, rng)
        donor = np.concatenate([donor_of[here], of_moving])
        placed = _facing(np.concatenate([standing, moving]), donors[donor]) / scale
        replaced = np.isin(glimpses[k].stay, here)
        replaced[own] = True
        plan.append(
            Injections(
                boxes=mapped(placed, np.asarray(np.linalg.inv(glimpses[k].pose), float)),
                donor=donor,
                stay=np.concatenate([here, np.full(len(moving), -1)]),
                replaced=replaced,
            )
        )
    return plan


@dataclass(frozen=True, eq=False)
class Stays:
    """Who stands where and when: ``stay``, ``t_s``, ``boxes`` by sighting, the rest by stay."""

    stay: Ints
    t_s: Array
    boxes: Array
    begin_s: Array
    end_s: Array
    middle: Array
    """(n, 6) a box of each stay."""

    @classmethod
    def of(cls, boxes: Sequence[Array], times_s: Array, stays: Sequence[Ints]) -> Stays:
        """Gather the *stays* of *boxes*, frame by frame."""
        stay, every = np.concatenate(stays), np.concatenate(boxes)
        t_s = np.repeat(times_s, [len(b) for b in boxes])
        rows = np.flatnonzero(stay >= 0)
        rows = rows[np.lexsort((t_s[rows], stay[rows]))]
        stay, t_s, every = stay[rows], t_s[rows], every[rows]
        first = np.flatnonzero(np.diff(stay, prepend=-1))
        last = np.append(first[1:], len(stay)) - 1 if len(first) else first
        return cls(stay, t_s, every, t_s[first], t_s[last], every[(first + last) // 2])

    def at(self, t_s: float) -> Ints:
        """Return the stays that last at a time."""
        return np.flatnonzero((self.begin_s <= t_s) & (t_s <= self.end_s))

    def boxes_at(self, t_s: float) -> Array:
        """Return (n, 6) for every stay the box that was seen of it nearest in time."""
        order = np.lexsort((np.abs(self.t_s - t_s), self.stay))
        return self.boxes[order[np.flatnonzero(np.diff(self.stay[order], prepend=-1))]]


def _free(spots: Array, taken: Array, most: int) -> Array:
    """Return up to *most* of the *spots* that overlap nothing that is *taken*, nor each other."""
    wide = grown(spots, _CLEAR_M)
    open_ = ~overlaps(wide, taken).any(axis=1)
    meet = np.tril(overlaps(wide, wide), -1)
    kept = np.zeros(len(spots), np.bool_)
    for i in np.flatnonzero(open_):
        kept[i] = not (meet[i] & kept).any()
    return spots[np.flatnonzero(kept)[:most]]


def _donors_for(spots: Array, donors: Array, rng: np.random.Generator) -> Ints:
    """Return a donor for each spot: any that lies and measures alike, else the one that comes nearest."""
    own, theirs = (np.arctan2(a[:, 1], a[:, 0]) for a in (spots[:, 2:4], donors))
    turn = np.abs((own[:, None] - theirs[None, :] + np.pi / 2) % np.pi - np.pi / 2) / _TURN
    longer = np.log(np.hypot(*spots[:, 2:4].T)[:, None] / np.hypot(*donors.T)[None, :])
    unlike = np.maximum(turn, np.abs(longer) / _LONGER)
    draw = rng.random(unlike.shape)
    return np.asarray(np.argmin(np.where(unlike <= 1, draw, unlike + 1), axis=1), np.int64)


def _facing(boxes: Array, donors: Array) -> Array:
    """Return *boxes* with the axes of the donors' lengths, turned to the front that is nearer to the donor's."""
    half = np.hypot(*boxes[:, 2:4].T)
    forward = np.where((boxes[:, 2:4] * donors).sum(axis=1) >= 0, 1.0, -1.0)
    out = boxes.copy()
    out[:, 2:4] *= (forward * np.hypot(*donors.T) / half)[:, None]
    return out
