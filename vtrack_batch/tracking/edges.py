"""Which sighting can be the next of which: between successive frames, and over misses where a vehicle is headed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.matching.candidates import Edges, candidates
from vtrack_batch.matching.colour import Paint
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.local_flow import LocalFlow
from vtrack_batch.matching.match import bayes_evidence, place_density
from vtrack_batch.matching.neighbours import neighbours_of
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.matching.score import against_none, link_probabilities, model_of
from vtrack_batch.tracking.motion import States
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.tracking.sightings import Array, Index, Sightings

KEEP_LOG_ODDS = -6.0
CONTEXT = 0.7  # weight of the learned score beside a vehicle's own motion: they share a part of what they know
LEAST_KNOWN = 1e-3


@dataclass(frozen=True)
class Links:
    """Possible links between sightings *i* and later ones *k*, (e,) int64, sorted by (i, k).

    ``log_alone`` (e,) is the log density (1/m2) of the displacement as the neighbours' motion has it; ``gain`` (e,) the
    log-odds of the link against a break.
    """

    i: Index
    k: Index
    log_alone: Array
    gain: Array
    log_known: Array
    """What the learned score adds where a vehicle's own motion is known: it knows neighbours and the place."""

    def __len__(self) -> int:
        return len(self.i)

    def above(self, least: float) -> Links:
        """Return the links with a gain of more than *least*."""
        keep = self.gain > least
        return Links(self.i[keep], self.k[keep], self.log_alone[keep], self.gain[keep], self.log_known[keep])


NO_LINKS = Links(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0))


@dataclass
class Judged:
    """The links of successive frames that were found last, and the frames: ``first`` sightings and times ``frame_s``.

    Of windows that overlap, the later one need not judge anew what the former one has judged.
    """

    frame_s: Array = field(default_factory=lambda: np.zeros(0))
    first: Index = field(default_factory=lambda: np.zeros(1, np.int64))
    links: Links = field(default_factory=lambda: NO_LINKS)

    def keep(self, s: Sightings, links: Links) -> None:
        """Remember the *links* between all successive frames of *s*."""
        self.frame_s, self.first, self.links = s.frame_s, s.first, links

    def of(self, s: Sightings) -> tuple[int, Links]:
        """Return how many frames *s* begins with have been judged, and the links between them."""
        low = int(np.searchsorted(self.frame_s, s.frame_s[0])) if len(s.frame_s) else len(self.frame_s)
        frames, at = min(len(self.frame_s) - low, len(s.frame_s)), int(self.first[low])
        same = np.array_equal(self.frame_s[low : low + frames], s.frame_s[:frames])
        if not (same and np.array_equal(self.first[low : low + frames + 1] - at, s.first[: frames + 1])):
            return 0, NO_LINKS
        links, end = self.links, int(self.first[low + frames])
        keep = (links.i >= at) & (links.k < end)
        links = Links(
            links.i[keep] - at, links.k[keep] - at, links.log_alone[keep], links.gain[keep], links.log_known[keep]
        )
        return frames, links


@dataclass(frozen=True)
class OpenEnds:
    """Which sightings, (n,) bool, may have a later, or an earlier, one that is not in the very next frame."""

    after: NDArray[np.bool_]
    before: NDArray[np.bool_]


def pair_links(
    s: Sightings,
    paint: Paint | None,
    log_colour: Array,
    matching: MatchingParams,
    limit_s: float,
    *,
    every: int = 1,
    flow_map: FlowMap | None = None,
    judged: Judged | None = None,
) -> Links:
    """Match successive frames without history, by colour and the neighbours' motion; keep what is not hopeless.

    *log_colour* (n,) is the log density of each sighting's colour in the sequence; *every* > 1 takes a sample. What is
    *judged* already is taken over, and all links are kept there.
    """
    frames, links = (0, NO_LINKS) if judged is None else judged.of(s)
    found = [(links.i, links.k, links.log_alone, links.gain, links.log_known)]
    for f in range(max(frames - 1, 0), len(s.frame_s) - 1, every):
        a, b, c = (int(first) for first in s.first[f : f + 3])
        dt = float(s.frame_s[f + 1] - s.frame_s[f])
        if a == b or b == c or dt > limit_s:
            continue
        edges = candidates(s.xy[a:b], s.xy[b:c], matching.reach_m(dt), limit=matching.max_candidate_pairs)
        flow = None if flow_map is None else flow_map.at(s.xy[a:b], s.xy[b:c], dt)
        if flow is not None:
            edges = edges.select(flow.possible(edges))
        i, k = edges.i + a, edges.k + b
        colour = None
        if paint is not None and s.rgb is not None:
            colour = paint.log_ratio(s.rgb[i], s.rgb[k], 0.5 * (log_colour[i] + log_colour[k]))
        log_odds, log_alone, log_known = _judged(s, edges, colour, paint, (a, b, c), matching, flow)
        keep = log_odds > KEEP_LOG_ODDS
        found.append((i[keep], k[keep], log_alone[keep], log_odds[keep], log_known[keep]))
    links = Links(*(np.concatenate(part) for part in zip(*found, strict=True)))
    if judged is not None:
        judged.keep(s, links)
    return links


def _judged(
    s: Sightings,
    edges: Edges,
    log_colour: Array | None,
    paint: Paint | None,
    rows: tuple[int, int, int],
    matching: MatchingParams,
    flow: LocalFlow | None,
) -> tuple[Array, Array, Array]:
    """Return the log-odds (e,) of edges between two frames against a break, and what of them is motion (1/m2).

    By the learned score, unless the method is ``untrained``; the score is told apart into colour and the rest, so that
    colours can be judged again when more of a vehicle is known.
    """
    a, b, c = rows
    earlier_xy, later_xy = s.xy[a:b], s.xy[b:c]
    dt = float(s.frame_s[s.frame[b]] - s.frame_s[s.frame[a]])
    neighbours = neighbours_of(edges, earlier_xy, later_xy, elapsed_s=dt, params=matching.neighbours)
    prior = place_density(edges, dt, matching, flow)
    colour = matching.colour if paint is None else paint.params
    evidence = bayes_evidence(edges, neighbours, prior, log_colour, dt, matching, colour)
    log_odds, log_known = evidence.log_odds, np.zeros(len(edges))
    if matching.method != "untrained":
        places, model = (earlier_xy, later_xy), model_of(matching.model)
        p = link_probabilities(edges, evidence, *places, elapsed_s=dt, flow=flow, model=model)
        log_odds, log_known = against_none(edges, p), CONTEXT * np.log(np.maximum(p, LEAST_KNOWN))
    return log_odds, log_odds - evidence.log_odds + evidence.log_prior, log_known


def gated_links(
    s: Sightings, forward: States, backward: States, ends: OpenEnds, limit_s: float, params: TrackingParams
) -> tuple[Index, Index]:
    """List pairs (i, k) in which k lies where i is headed, or i where k comes from; over misses only open ends."""
    motion = params.motion
    q = motion.jerkiness * (1 + motion.rough_share * motion.rough_factor)
    scale = np.array([params.link.gate_sigmas, q, motion.max_speed_mps, limit_s])
    place = s.first, s.frame_s, s.frame, s.xy, s.sigma_m
    ahead = _gate(*place, forward.mean, forward.cov, forward.moving, ends.after, ends.before, scale, 1)
    behind = _gate(*place, backward.mean, backward.cov, backward.moving, ends.before, ends.after, scale, -1)
    return np.concatenate([ahead[0], behind[1]]), np.concatenate([ahead[1], behind[0]])


@njit(cache=True, nogil=True)
def _gate(first, frame_s, frame, xy, sigma, mean, cov, moving, open_from, open_to, scale, step):  # type: ignore[no-untyped-def]
    gate, q, max_speed, limit_s = scale
    out_from, out_to = [np.int64(0) for _ in range(0)], [np.int64(0) for _ in range(0)]
    for i in range(len(frame)):
        if not moving[i]:
            continue
        f = frame[i] + step
        while 0 <= f < len(frame_s):
            dt = frame_s[f] - frame_s[frame[i]]
            h = abs(dt)
            gap = f != frame[i] + step
            if h > limit_s or (gap and not open_from[i]):
                break
            x, y = mean[i, 0] + dt * mean[i, 2], mean[i, 1] + dt * mean[i, 3]
            variance = cov[i, 0] + 2 * dt * cov[i, 1] + dt * dt * cov[i, 2] + q * h**3 / 3 + sigma[i] ** 2
            reach = min(gate * np.sqrt(variance), 2 * max_speed * h)
            a, b = first[f], first[f + 1]
            for k in range(a + np.searchsorted(xy[a:b, 0], x - reach), b):
                if xy[k, 0] > x + reach:
                    break
                if gap and not open_to[k]:
                    continue
                near = (xy[k, 0] - x) ** 2 + (xy[k, 1] - y) ** 2 <= reach**2
                slow = (xy[k, 0] - xy[i, 0]) ** 2 + (xy[k, 1] - xy[i, 1]) ** 2 <= (max_speed * h + 2.0) ** 2
                if near and slow:
                    out_from.append(np.int64(i))
                    out_to.append(np.int64(k))
            f += step
    return np.array(out_from, dtype=np.int64), np.array(out_to, dtype=np.int64)


@njit(cache=True, nogil=True)
def local_density(first, frame, xy, radius):  # type: ignore[no-untyped-def]
    """Return sightings per m2 (n,) around each sighting in its own frame, itself included."""
    out = np.zeros(len(frame))
    for i in range(len(frame)):
        a, b = first[frame[i]], first[frame[i] + 1]
        for k in range(a + np.searchsorted(xy[a:b, 0], xy[i, 0] - radius), b):
            if xy[k, 0] > xy[i, 0] + radius:
                break
            if (xy[k, 0] - xy[i, 0]) ** 2 + (xy[k, 1] - xy[i, 1]) ** 2 <= radius**2:
                out[i] += 1
    return out / (np.pi * radius**2)
