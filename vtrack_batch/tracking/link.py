"""Link all sightings of a sequence into chains: repeated assignment over the whole sequence.

Every sighting has at most one predecessor and one successor, so the best set of chains is one sparse assignment of
successors (a minimum-cost path cover). What a link is worth depends on the velocities on both of its sides, and those
on the links: so links are found again and again, each round with the velocities of the round before. In a link's score
the past of its first sighting (forward filter) meets the future of its second (backward filter), never the link itself,
so that a wrong link does not defend itself, and births are no weak point: the future tells.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from vtrack_batch.matching.colour import Paint, learned_noise, opponent
from vtrack_batch.matching.decision import assign
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.match import MOVING_MPS
from vtrack_batch.matching.params import ColourParams, MatchingParams
from vtrack_batch.tracking.beliefs import Graph, distinct, link_gains
from vtrack_batch.tracking.edges import Judged, Links, OpenEnds, gated_links, local_density, pair_links
from vtrack_batch.tracking.motion import filter_chain
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.tracking.sightings import DENSITY_RADIUS_M, Array, Index, Sightings

SAMPLE_FRAMES = 40  # on which the spreads of colour are first learned
SURE_PAIR, SURE_LINK = 0.9, 0.99
HOPELESS = -6.0  # links of lower log-odds are not looked at again


@dataclass(frozen=True)
class Chains:
    """The chains found: ``after`` (n,) and ``before`` (n,) are the next and the last sighting of the vehicle, or -1.

    ``probability`` (n,) is the belief in the link to ``after``; where there is none, in there being none.
    ``none_before`` (n,) likewise in there being no earlier sighting.
    """

    after: Index
    before: Index
    probability: Array
    none_before: Array


@dataclass(frozen=True)
class Scene:
    """What stays the same through all rounds."""

    s: Sightings
    log_density: Array
    limit_s: float
    matching: MatchingParams
    params: TrackingParams
    paint: Paint | None = None
    log_colour: Array = field(default_factory=lambda: np.zeros(0))
    axes: Array = field(default_factory=lambda: np.zeros((0, 3)))


def link(
    s: Sightings,
    matching: MatchingParams,
    params: TrackingParams,
    flow_map: FlowMap | None = None,
    *,
    colour: ColourParams | None = None,
    judged: Judged | None = None,
) -> Chains:
    """Return the chains of one sequence; *colour*: spreads of colour, where they are known before; *judged* as well."""
    limit_s = max(params.link.coast_s, (params.link.coast_frames + 1) * s.interval_s) + 0.05 * s.interval_s
    density = np.log(local_density(s.first, s.frame, s.xy, DENSITY_RADIUS_M))
    scene = _repainted(Scene(s, density, limit_s, matching, params), colour or matching.colour.wide())
    if s.rgb is not None and colour is None:
        every = max(1, len(s.frame_s) // SAMPLE_FRAMES)
        sample = pair_links(s, scene.paint, scene.log_colour, matching, limit_s, every=every, flow_map=flow_map)
        scene = _relearned(scene, _chains(len(s), sample), SURE_PAIR)
    pairs = pair_links(s, scene.paint, scene.log_colour, matching, limit_s, flow_map=flow_map, judged=judged)
    pairs = _scored(scene, pairs.i, pairs.k, pairs.log_alone, pairs.log_known)
    chains = _chains(len(s), pairs)
    pairs = pairs.above(HOPELESS)
    for _ in range(params.link.rounds):
        scene = _relearned(scene, chains, SURE_LINK)
        chains = _chains(len(s), _links(scene, pairs, chains))
    return chains


def _repainted(scene: Scene, colour: ColourParams) -> Scene:
    """Return the scene with colours judged by other spreads."""
    rgb = scene.s.rgb
    if rgb is None:
        return scene
    paint = Paint(rgb, colour) if scene.paint is None else scene.paint.under(colour)
    return replace(scene, paint=paint, log_colour=paint.log_density(rgb), axes=opponent(rgb))


def _relearned(scene: Scene, chains: Chains, sure: float) -> Scene:
    """Return the scene with the spreads of colour that its own surest links show."""
    return _repainted(scene, colour_of(scene.s, chains, scene.matching.colour, sure=sure))


def colour_of(s: Sightings, chains: Chains, assumed: ColourParams, *, sure: float = SURE_LINK) -> ColourParams:
    """Return the spreads of colour that links of more than the belief *sure* show, where *assumed* may be changed."""
    if s.rgb is None or assumed.first_guess == 1:
        return assumed
    after = chains.after
    # what stands looks more alike from frame to frame than what drives
    moved = np.hypot(*(s.xy[after] - s.xy).T) > MOVING_MPS * np.abs(s.t[after] - s.t)
    i = np.flatnonzero((after >= 0) & (chains.probability > sure) & moved)
    return learned_noise(s.rgb[i], s.rgb[after[i]], assumed)


def _links(scene: Scene, pairs: Links, chains: Chains) -> Links:
    """List and score the possible links, given the chains of the round before."""
    s, params = scene.s, scene.params
    motion = params.motion
    forward = filter_chain(chains.before, s.t, s.xy, s.sigma_m, motion.jerkiness, motion.speed_sigma_mps)
    backward = filter_chain(chains.after, s.t, s.xy, s.sigma_m, motion.jerkiness, motion.speed_sigma_mps)
    frames_on = s.frame[chains.after] - s.frame
    open_after = (chains.after < 0) | (chains.probability < params.link.sure) | (frames_on > 1)
    open_before = np.ones(len(s), bool)
    linked = chains.after >= 0
    open_before[chains.after[linked]] = open_after[linked]
    i, k = gated_links(s, forward, backward, OpenEnds(open_after, open_before), scene.limit_s, params)
    from_i, to_k = np.concatenate([pairs.i, i]), np.concatenate([pairs.k, k])
    log_alone = np.concatenate([pairs.log_alone, np.full(len(i), -np.inf)])
    # successive sightings that the score of pairs has dropped are hopeless by it; of gaps it knows nothing
    unasked = np.where(s.frame[k] == s.frame[i] + 1, pairs.log_known.min(initial=0.0), 0.0)
    log_known = np.concatenate([pairs.log_known, unasked])
    at = distinct(from_i, to_k, len(s))
    i, k, log_alone, log_known = from_i[at], to_k[at], log_alone[at], log_known[at]
    # where the neighbours were not asked: anywhere in reach
    reach = scene.matching.max_speed_mps * (s.t[k] - s.t[i])
    log_alone = np.where(np.isfinite(log_alone), log_alone, -2 * np.log(2 * np.maximum(reach, 2.0)))
    return _scored(scene, i, k, log_alone, log_known)


def _scored(scene: Scene, i: Index, k: Index, log_alone: Array, log_known: Array) -> Links:
    """Score possible links by their past and their future."""
    s, motion, prior = scene.s, scene.params.motion, scene.params.link
    missed = s.frame[k] - s.frame[i] - 1
    log_odds = np.log1p(-prior.missed_share) + missed * np.log(prior.missed_share) - 2 * np.log(prior.break_share)
    log_odds -= 0.5 * (scene.log_density[i] + scene.log_density[k])
    painted = scene.paint is not None
    graph = Graph(
        i=i,
        k=k,
        log_alone=log_alone - log_known,  # a vehicle without past or future has no more than the score already says
        log_odds=log_odds + log_known,
        t=s.t,
        xy=s.xy,
        variance=s.sigma_m**2,
        paint=scene.axes if painted else np.zeros((len(s), 3)),
        log_paint=scene.log_colour if painted else np.zeros(len(s)),
        noise=scene.paint.noise if scene.paint is not None else np.zeros(0),
        motion=np.array(
            [motion.jerkiness, motion.rough_factor, motion.rough_share, motion.speed_sigma_mps, prior.trust,
             prior.memory_sightings - 1]
        ),
    )  # fmt: skip
    return Links(i, k, log_alone, link_gains(graph), log_known)


def _chains(n: int, links: Links) -> Chains:
    """Choose the best links and read off probabilities against all rivals."""
    picked = assign(links.i, links.k, links.gain)
    odds = np.exp(np.clip(links.gain, -30, 30))
    sum_i = np.bincount(links.i, weights=odds, minlength=n)
    sum_k = np.bincount(links.k, weights=odds, minlength=n)
    i, k = links.i[picked], links.k[picked]
    after, before = np.full(n, -1), np.full(n, -1)
    after[i], before[k] = k, i
    probability, none_before = 1 / (1 + sum_i), 1 / (1 + sum_k)
    probability[i] = odds[picked] / (1 + sum_i[i] + np.maximum(sum_k[k] - odds[picked], 0))
    return Chains(after, before, probability, none_before)
