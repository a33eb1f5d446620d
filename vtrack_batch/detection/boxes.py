"""Greedy fit of oriented boxes to the evidence: the best box first, its pixels taken, then the next.

Evidence inside counts for a box, occupied rims against it (two cars in a row are two boxes, not a lorry), and cast
shadow on the far side from the sun for it. So queues are split, and cars cut by their windscreen stay whole. Paint may
be as dark as a shadow; but a shadow has something that casts it, so what no box explains in the end is such paint.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from heapq import heapify, heappop, heappush

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.background.subtract import FULL, Difference
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.detection.seeds import HIDDEN, Layers, find_seeds, make_layers
from vtrack_batch.detection.templates import CAST, FRONT, INSIDE, LEFT, Templates

Boxes = NDArray[np.float64]
"""(n, 6): column, row (sub-pixel), direction, size (indices), score, share of it that is visible."""

Tried = Callable[[NDArray[np.float64]], NDArray[np.bool_]]
"""Tells of places (n, 2), column and row, which directions (n, d) are tried there."""

_TAKEN = -50
_MOST_TAKEN = 0.3
_FALLING_OFF = 0.8
_NEARLY_AS_FULL = 0.08
_HOPEFUL = 0.25
_HOPE = 0.7
_HEMMED_IN = 0.3


def fit_boxes(
    difference: Difference,
    templates: Templates,
    px_per_m: tuple[float, float],
    params: DetectionParams,
    tried: Tried | None = None,
) -> Boxes:
    """Return boxes whose score is at least ``weak_score``, best first, in a picture with *px_per_m* (x, y).

    *tried* tells which directions are tried where, None = all everywhere. Then come boxes of at least ``dark_score``
    that are made of shadow which nothing found before casts, and in what is left those of at least ``again_score``.
    """
    layers = make_layers(difference, templates.margin, params.shadow_evidence)
    boxes = [_fitted(layers, templates, px_per_m, params, params.weak_score, tried)]
    left = layers.inner.copy()
    # A shadow has something that casts it: what no box explains is dark paint.
    if _uncast(layers.inner, layers.cast, params.shadow_evidence):
        boxes.append(_fitted(layers, templates, px_per_m, params, params.dark_score, tried))
    if params.again_score < params.weak_score:
        left[layers.inner == _TAKEN] = _TAKEN
        again = _fitted(replace(layers, inner=left), templates, px_per_m, params, params.again_score, tried)
        # Larger boxes are tried sooner below a lower bar: what fits well only then stays doubtful.
        again[:, 4] = np.minimum(again[:, 4], np.nextafter(params.weak_score, 0.0))
        boxes.append(again)
    return np.concatenate(boxes)


def _fitted(
    layers: Layers,
    templates: Templates,
    px_per_m: tuple[float, float],
    params: DetectionParams,
    least: float,
    tried: Tried | None,
) -> Boxes:
    """Fit boxes of score *least* to what is left in *layers*, and take it out."""
    seeds = find_seeds(layers, px_per_m, params.seed_step_m)
    width = layers.inner.shape[1]
    start = templates.margin * width + templates.margin
    # A place is row * width + column of the frame; counted from the corner of the margin, offsets are never negative.
    # Unsigned indices spare the check for negative ones, which is half the time of a sum.
    offsets = (templates.offsets[:, 0] * width + templates.offsets[:, 1] + start).astype(np.uint32)
    places = (seeds.grid * seeds.step) @ np.array([width, 1])
    at = (seeds.grid * seeds.step)[:, ::-1].astype(float)
    allowed = np.ones((len(at), len(templates.starts)), np.bool_) if tried is None else tried(at)
    weights = np.array([params.rim_weight, params.shadow_weight, params.visible_share, least])
    flat = layers.inner.ravel(), layers.rim.ravel(), layers.cast.ravel()
    drawn = offsets, templates.starts, templates.half_axes, templates.shades
    return np.asarray(_fit(*flat, width, start, *drawn, seeds.grid, places, seeds.core, weights, allowed))


@njit(cache=True, nogil=True)
def _uncast(inner, cast, shadow_evidence):  # type: ignore[no-untyped-def]
    """Let shadow that is left in *inner* count like an object; return how many pixels do."""
    count = 0
    for r in range(inner.shape[0]):
        values, shaded, here = inner[r], cast[r], 0
        # Most rows hold none: that is soon seen.
        for c in range(len(values)):
            here += (shaded[c] == 1) & (values[c] > 0)
        if here == 0:
            continue
        for c in range(len(values)):
            if shaded[c] == 1 and values[c] > 0:
                values[c] = min(FULL, int(values[c] / shadow_evidence + 0.5))
        count += here
    return count


@njit(cache=True, nogil=True)
def _fit(inner, rim, cast, width, start, offsets, starts, half_axes, shades, grid, places, core, weights, allowed):  # type: ignore[no-untyped-def]
    best = np.zeros((len(places), 3))
    queue = [(0.0, 0)]
    queue.clear()
    weak = weights[3]
    cars = starts[:, :1]
    for i in range(len(places)):
        _best_box(inner, rim, cast, offsets, cars, places[i], weights, _HOPE * weak, allowed[i], best[i])
    peaks = _peaks(grid, best[:, 0])
    for i in range(len(places)):
        # Larger boxes are tried where a car fits better than beside, or, at every other seed, is hemmed in; the rest
        # waits for its turn.
        d = int(best[i, 1])
        if not peaks[i] and best[i, 0] > 0:
            peaks[i] = _rim_share(rim, offsets, starts[d, 0], places[i]) >= _HEMMED_IN
        if peaks[i]:
            _best_box(inner, rim, cast, offsets, starts, places[i], weights, weak, allowed[i], best[i])
        if best[i, 0] >= weak:
            queue.append((-best[i, 0], i))
    heapify(queue)
    boxes = np.zeros((len(queue), 6))
    found = 0
    while len(queue) > 0:
        _, i = heappop(queue)
        before, d, k = best[i, 0], int(best[i, 1]), int(best[i, 2])
        same = _score(inner, rim, cast, offsets, starts[d, k], places[i], weights, -9.0) >= before - 1e-9
        if not (same and peaks[i]):
            # Some of its pixels went to a better box, or only cars were tried: what fits best here?
            if _is_open(inner, width, places[i] + start, core):
                _best_box(inner, rim, cast, offsets, starts, places[i], weights, weak, allowed[i], best[i])
                if weak <= best[i, 0] and (best[i, 0] < before or not peaks[i]):
                    heappush(queue, (-best[i, 0], i))
                peaks[i] = True
            continue
        place, score = _climb(inner, rim, cast, width, offsets, starts[d, k], places[i], before, weights)
        if _share_of(inner, offsets, starts[d, k], place, _TAKEN) > _MOST_TAKEN:
            continue
        right, down = _sub_pixel(inner, rim, cast, width, offsets, starts[d, k], place, score, weights)
        boxes[found, 0], boxes[found, 1] = place % width + right, place // width + down
        boxes[found, 2], boxes[found, 3], boxes[found, 4] = d, k, score
        boxes[found, 5] = 1.0 - _share_of(inner, offsets, starts[d, k], place, HIDDEN)
        _take(inner, rim, cast, width, place + start, half_axes[d, k], shades[k])
        found += 1
    return boxes[:found]


@njit(cache=True, nogil=True)
def _is_open(inner, width, at, core):  # type: ignore[no-untyped-def]
    """Whether so much evidence is left around the place that it would still be a seed."""
    if inner[at] == _TAKEN:
        return False
    total = np.int64(0)
    for r in range(-core[0], core[0] + 1):
        for c in range(-core[1], core[1] + 1):
            total += max(inner[at + r * width + c], 0)
    return total >= core[2]


@njit(cache=True, nogil=True)
def _peaks(grid, score):  # type: ignore[no-untyped-def]
    """Which seeds, at row and column *grid* (n, 2) of the coarse grid, score no less than the eight around them."""
    around = np.full((grid[:, 0].max() + 3, grid[:, 1].max() + 3), -10.0) if len(grid) else np.zeros((1, 1))
    for i in range(len(grid)):
        around[grid[i, 0] + 1, grid[i, 1] + 1] = score[i]
    peaks = np.zeros(len(grid), np.bool_)
    for i in range(len(grid)):
        r, c = grid[i, 0], grid[i, 1]
        peaks[i] = score[i] > 0 and around[r : r + 3, c : c + 3].max() <= score[i] + 1e-9
    return peaks


@njit(cache=True, nogil=True)
def _best_box(inner, rim, cast, offsets, starts, place, weights, least, allowed, best):  # type: ignore[no-untyped-def]
    """Write the score, direction and size of the best box at *place* to *best*; below *least* none is looked for."""
    directions, sizes = starts.shape[0], starts.shape[1]
    filled = np.empty(directions)
    for d in range(0, directions, 2):
        filled[d] = _inside(inner, offsets, starts[d, 0], place, weights[2]) if allowed[d] else -10.0
    hopeful = filled[::2].max() - _HOPEFUL
    for d in range(1, directions, 2):
        # Between two directions that fit badly none fits well.
        filled[d] = -10.0
        after = (d + 1) % directions
        unknown = not (allowed[d - 1] or allowed[after])
        if allowed[d] and (filled[d - 1] >= hopeful or filled[after] >= hopeful or unknown):
            filled[d] = _inside(inner, offsets, starts[d, 0], place, weights[2])
    best[0] = least - 1e-9
    found = False
    enough = filled.max() - _NEARLY_AS_FULL
    for _ in range(directions):
        d = int(np.argmax(filled))
        fullest = filled[d]
        if fullest < enough or fullest + weights[1] <= best[0]:
            break
        filled[d] = -10.0
        for k in range(sizes):
            inside = fullest if k == 0 else _inside(inner, offsets, starts[d, k], place, weights[2])
            # Sizes ascend: once a box reaches far beyond what is there, larger ones do too.
            if inside < _FALLING_OFF * fullest:
                break
            if inside + weights[1] <= best[0]:
                continue
            score = inside + _around(rim, cast, offsets, starts[d, k], place, weights, best[0] - inside)
            if score > best[0]:
                best[0], best[1], best[2] = score, d, k
                found = True
    if not found:
        best[0] = -9.0


@njit(cache=True, nogil=True)
def _score(inner, rim, cast, offsets, starts, place, weights, least):  # type: ignore[no-untyped-def]
    """Score of one box; something below *least* as soon as it cannot exceed it."""
    inside = _inside(inner, offsets, starts, place, weights[2])
    if inside + weights[1] <= least:
        return -9.0
    return inside + _around(rim, cast, offsets, starts, place, weights, least - inside)


@njit(cache=True, nogil=True)
def _inside(inner, offsets, starts, place, visible_share):  # type: ignore[no-untyped-def]
    """Mean evidence inside the box; -9 where too little of it is visible."""
    base = np.uint64(place)
    first, last = starts[INSIDE], starts[INSIDE + 1]
    total, visible = np.int64(0), last - first
    for n in range(first, last):
        total += inner[base + offsets[n]]
    if total < 0:
        total, visible = np.int64(0), 0
        for n in range(first, last):
            value = inner[base + offsets[n]]
            if value != HIDDEN:
                visible += 1
                total += value
        if visible < visible_share * (last - first):
            return -9.0
    return total / (FULL * visible)


@njit(cache=True, nogil=True)
def _around(rim, cast, offsets, starts, place, weights, least):  # type: ignore[no-untyped-def]
    """What the rim takes from the score and the cast shadow adds; stops where that cannot exceed *least*."""
    shadowed = starts[CAST + 1] > starts[CAST]
    hope = weights[1] if shadowed else 0.0
    score = -weights[0] * _strips_share(rim, offsets, starts[LEFT], starts[CAST], place)
    if score + hope <= least:
        return score
    score -= weights[0] * _strips_share(rim, offsets, starts[FRONT], starts[LEFT], place)
    if not shadowed or score + hope <= least:
        return score
    base, shaded = np.uint64(place), np.int64(0)
    for n in range(starts[CAST], starts[CAST + 1]):
        shaded += cast[base + offsets[n]]
    return score + weights[1] * shaded / (starts[CAST + 1] - starts[CAST])


@njit(cache=True, nogil=True)
def _rim_share(rim, offsets, starts, place):  # type: ignore[no-untyped-def]
    """How much of the rim is occupied, every side counting alike."""
    ends = _strips_share(rim, offsets, starts[FRONT], starts[LEFT], place)
    return ends + _strips_share(rim, offsets, starts[LEFT], starts[CAST], place)


@njit(cache=True, nogil=True)
def _strips_share(rim, offsets, first, last, place):  # type: ignore[no-untyped-def]
    """Half of the share that is occupied of two strips of one length, first:last."""
    base, busy = np.uint64(place), np.int64(0)
    for n in range(first, last):
        busy += rim[base + offsets[n]]
    return busy / (2 * FULL * (last - first))


@njit(cache=True, nogil=True)
def _climb(inner, rim, cast, width, offsets, starts, place, score, weights):  # type: ignore[no-untyped-def]
    """Move the box to the best place nearby: seeds lie wider apart than pixels."""
    for _ in range(4):
        best, at = score, place
        for i in range(-1, 2):
            for j in range(-1, 2):
                other = _score(inner, rim, cast, offsets, starts, place + i * width + j, weights, best)
                if other > best + 1e-9:
                    best, at = other, place + i * width + j
        if at == place:
            break
        place, score = at, best
    return place, score


@njit(cache=True, nogil=True)
def _sub_pixel(inner, rim, cast, width, offsets, starts, place, score, weights):  # type: ignore[no-untyped-def]
    """Vertex of the parabolas through the score here and one pixel to each side: (to the right, down)."""
    left = _score(inner, rim, cast, offsets, starts, place - 1, weights, -9.0)
    right = _score(inner, rim, cast, offsets, starts, place + 1, weights, -9.0)
    above = _score(inner, rim, cast, offsets, starts, place - width, weights, -9.0)
    below = _score(inner, rim, cast, offsets, starts, place + width, weights, -9.0)
    return _vertex(left, score, right), _vertex(above, score, below)


@njit(cache=True, nogil=True)
def _vertex(before, here, after):  # type: ignore[no-untyped-def]
    bend = before - 2 * here + after
    if bend >= -1e-9:
        return 0.0
    return min(max(0.5 * (before - after) / bend, -0.5), 0.5)


@njit(cache=True, nogil=True)
def _share_of(inner, offsets, starts, place, what):  # type: ignore[no-untyped-def]
    base, count = np.uint64(place), 0
    for n in range(starts[INSIDE], starts[INSIDE + 1]):
        count += inner[base + offsets[n]] == what
    return count / (starts[INSIDE + 1] - starts[INSIDE])


@njit(cache=True, nogil=True)
def _take(inner, rim, cast, width, place, half_axes, shade):  # type: ignore[no-untyped-def]
    """Mark the pixels of the box with *half_axes* (along x, along y, across x, across y) in px as taken.

    Its shadow, at most as long as *shade* (x, y) in px, is explained by it and evidence of nothing else.
    """
    lx, ly, wx, wy = half_axes
    reach_r, reach_c = int(abs(ly) + abs(wy)) + 1, int(abs(lx) + abs(wx)) + 1
    determinant = abs(lx * wy - ly * wx)
    steps = int(np.ceil(max(abs(shade[0]), abs(shade[1]))))
    for y in range(-reach_r, reach_r + 1):
        for x in range(-reach_c, reach_c + 1):
            if abs(x * wy - y * wx) > determinant or abs(y * lx - x * ly) > determinant:
                continue
            at = place + y * width + x
            rim[at] = 0
            if inner[at] != HIDDEN:
                inner[at] = _TAKEN
            for step in range(1, steps + 1):
                moved = at + round(shade[1] * step / steps) * width + round(shade[0] * step / steps)
                if 0 <= moved < len(inner) and cast[moved] == 1 and inner[moved] > 0:
                    inner[moved] = 0
