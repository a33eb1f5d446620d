"""Match the vehicles of two images."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.matching import decision
from vtrack_batch.matching.candidates import Array, Edges, candidates
from vtrack_batch.matching.colour import Paint, colour_labels, equal_labels, learned_noise
from vtrack_batch.matching.features import Evidence
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.local_flow import LocalFlow
from vtrack_batch.matching.neighbours import Neighbours, labels_from, match_by_neighbours, neighbours_of
from vtrack_batch.matching.params import METHODS, ColourParams, MatchingParams, Method
from vtrack_batch.matching.regions import pair_labels
from vtrack_batch.matching.relaxation import Labels, relax
from vtrack_batch.matching.score import labels_of, link_probabilities, model_of
from vtrack_batch.matching.vehicles import Vehicles

SURE = 0.9  # links from which the spread of colours is learned
MOVING_MPS = 2.0
PAPER = ("original", "colour", "opposite", "proposed")
DECISION = {
    "original": "argmax",
    "colour": "argmax",
    "opposite": "mutual",
    "proposed": "mutual",
    "regions": "mutual",
    "nearest": "argmax",
    "default": "most_right",
}


def match(
    earlier: pd.DataFrame,
    later: pd.DataFrame,
    *,
    elapsed_s: float,
    method: Method | str = "default",
    flow_map: FlowMap | None = None,
    params: MatchingParams | None = None,
) -> pd.DataFrame:
    """Match the vehicles of two images taken *elapsed_s* apart, without history.

    Both tables hold ``detection_id``, ``x_m``, ``y_m`` and may hold ``red, green, blue`` (0-255); in any order of rows.
    Returns ``detection_id_from``, ``detection_id_to`` (null on one side = disappeared or appeared), ``probability``
    and ``method``, links first. Missing columns, missing values and repeated ids raise ``UnusableData``.
    """
    params = params or MatchingParams()
    chosen = params.method if method == "default" else method
    if chosen not in METHODS:
        raise ConfigError(f"matching method {method!r} is unknown; there are {', '.join(METHODS)}")
    if not (np.isfinite(elapsed_s) and elapsed_s > 0):
        raise UnusableData(
            f"elapsed_s must be positive, not {elapsed_s!r}: the seconds from the earlier to the later image"
        )
    a, b = Vehicles.of(earlier, "earlier image"), Vehicles.of(later, "later image")
    reach_m = params.reach_m(elapsed_s, printed=chosen in PAPER)
    edges = candidates(a.xy, b.xy, reach_m, limit=params.max_candidate_pairs)
    mapped = flow_map is not None and chosen not in (*PAPER, "nearest", "regions")
    flow = flow_map.at(a.xy, b.xy, elapsed_s) if mapped and flow_map is not None else None
    if flow is not None:
        edges = edges.select(flow.possible(edges))
    if chosen in PAPER:
        labels = paper_labels(edges, a, b, elapsed_s, chosen, params)
    elif chosen == "regions":
        labels = pair_labels(edges, a, b, elapsed_s, params.regions)
    elif chosen == "nearest":
        labels = nearest_labels(edges)
    else:
        labels, evidence = untrained_labels(edges, a, b, elapsed_s, params, flow, alone=chosen == "assignment")
    if chosen == "default":
        model = model_of(params.model)
        p = link_probabilities(edges, evidence, a.xy, b.xy, elapsed_s=elapsed_s, flow=flow, model=model)
        labels = labels_of(edges, p)
    rule = DECISION.get(chosen, "one_to_one") if params.decision == "method" else params.decision
    picked = getattr(decision, rule)(edges, labels)
    return _table(a, b, edges, labels, picked, chosen)


def paper_labels(
    edges: Edges, a: Vehicles, b: Vehicles, elapsed_s: float, method: str, params: MatchingParams
) -> Labels:
    """Return the label probabilities of the paper's methods (a) original, (b) colour, (c) opposite, (d) proposed."""
    coloured = method in ("colour", "proposed") and a.rgb is not None and b.rgb is not None
    labels = colour_labels(edges, a.rgb, b.rgb) if coloured else equal_labels(edges)  # type: ignore[arg-type]
    tolerance = params.paper.consistency_m(elapsed_s)
    two_way = method in ("opposite", "proposed")
    return relax(edges, labels, a.xy, b.xy, tolerance=tolerance, params=params.paper, two_way=two_way)


def untrained_labels(
    edges: Edges,
    a: Vehicles,
    b: Vehicles,
    elapsed_s: float,
    params: MatchingParams,
    flow: LocalFlow | None = None,
    *,
    alone: bool = False,
) -> tuple[Labels, Evidence]:
    """Return label probabilities by Bayes' rule, and what they are made of: displacement (or flow), colour, neighbours.

    An edge's odds against no match are p(displacement) p(colour | same) / (density of vehicles · p(colour)). With
    *alone* every vehicle is judged without its neighbours: plain assignment on displacement and colour.
    """
    neighbours = None if alone else neighbours_of(edges, a.xy, b.xy, elapsed_s=elapsed_s, params=params.neighbours)
    prior = place_density(edges, elapsed_s, params, flow)

    def judged(colour: ColourParams) -> tuple[Labels, Evidence]:
        log_colour = None
        if a.rgb is not None and b.rgb is not None and len(edges):
            paint = Paint(np.vstack([a.rgb, b.rgb]), colour)
            log_random = 0.5 * (paint.log_density(a.rgb)[edges.i] + paint.log_density(b.rgb)[edges.k])
            log_colour = paint.log_ratio(a.rgb[edges.i], b.rgb[edges.k], log_random)
        evidence = bayes_evidence(edges, neighbours, prior, log_colour, elapsed_s, params, colour)
        return labels_from(edges, evidence.log_odds), evidence

    if a.rgb is None or b.rgb is None or params.colour.first_guess == 1:
        return judged(params.colour)
    guess = judged(params.colour.wide())[0]
    # what stands looks more alike from frame to frame than what drives
    sure = (np.minimum(guess.p, guess.q) > SURE) & (np.hypot(*edges.displacement.T) > MOVING_MPS * elapsed_s)
    return judged(learned_noise(a.rgb[edges.i[sure]], b.rgb[edges.k[sure]], params.colour))


def bayes_evidence(
    edges: Edges,
    neighbours: Neighbours | None,
    prior: Array,
    log_colour: Array | None,
    elapsed_s: float,
    params: MatchingParams,
    colour: ColourParams,
) -> Evidence:
    """Return what Bayes' rule makes of every edge; *prior* (e,) 1/m2, *log_colour* (e,) under the spreads *colour*."""
    log_rest = log_evidence(edges, log_colour, elapsed_s, params)
    log_odds = log_rest + np.log(prior)
    if neighbours is not None:
        log_odds = match_by_neighbours(edges, neighbours, log_rest, prior, params.neighbours)[1]
    log_density = np.log(_candidate_density(edges, params.reach_m(elapsed_s)))
    light = colour.brightness_sigma / params.colour.brightness_sigma
    chroma = colour.chroma_sigma / params.colour.chroma_sigma
    return Evidence(log_odds, log_colour, log_odds - log_rest, log_density, light, chroma)


def log_evidence(edges: Edges, log_colour: Array | None, elapsed_s: float, params: MatchingParams) -> Array:
    """Return the log of all of an edge's odds but its displacement: misses, colour, and how many rivals there are."""
    log_odds = np.log((1 - params.missed_share) / params.missed_share)
    log_odds = log_odds - np.log(_candidate_density(edges, params.reach_m(elapsed_s)))
    return np.asarray(log_odds if log_colour is None else log_odds + log_colour)


def _candidate_density(edges: Edges, reach: float) -> Array:
    """Density of vehicles (1/m2) around each edge: candidates in reach of either end over the area of the box."""
    of_i, of_k = np.bincount(edges.i, minlength=edges.n), np.bincount(edges.k, minlength=edges.m)
    return np.asarray(0.5 * (of_i[edges.i] + of_k[edges.k]) / (2 * reach) ** 2)


def nearest_labels(edges: Edges) -> Labels:
    """Return labels that fall with distance, for nearest-neighbour matching within reach."""
    closeness = 1 / (1 + np.hypot(*edges.displacement.T))
    sum_i = np.bincount(edges.i, weights=closeness, minlength=edges.n)
    sum_k = np.bincount(edges.k, weights=closeness, minlength=edges.m)
    p, q = closeness / sum_i[edges.i], closeness / sum_k[edges.k]
    return Labels(p, q, (sum_i == 0).astype(float), (sum_k == 0).astype(float))


def place_density(edges: Edges, elapsed_s: float, params: MatchingParams, flow: LocalFlow | None) -> Array:
    """Density (1/m2) of displacements before neighbours are asked: the place's own where it is known."""
    prior = displacement_density(edges, elapsed_s, params)
    return prior if flow is None else flow.mixed(edges, prior, prior_weight=params.neighbours.prior_weight)


def displacement_density(edges: Edges, elapsed_s: float, params: MatchingParams) -> Array:
    """Prior density (1/m2) of displacements: some vehicles stand, the others may go anywhere in reach."""
    standing, sigma = params.standing_share, params.standing_m
    square = (edges.displacement**2).sum(axis=1)
    stands = standing / (2 * np.pi * sigma**2) * np.exp(-0.5 * square / sigma**2)
    return np.asarray(stands + (1 - standing) / (2 * params.reach_m(elapsed_s)) ** 2)


def _table(a: Vehicles, b: Vehicles, edges: Edges, labels: Labels, picked: decision.Mask, method: str) -> pd.DataFrame:
    """Write links, then vehicles that disappeared, then those that appeared."""
    i, k = edges.i[picked], edges.k[picked]
    gone = np.setdiff1d(np.arange(len(a)), i)
    new = np.setdiff1d(np.arange(len(b)), k)
    rows_from = np.concatenate([i, gone, np.full(len(new), -1)])
    rows_to = np.concatenate([k, np.full(len(gone), -1), new])
    probability = np.concatenate([labels.p[picked], labels.p_none[gone], labels.q_none[new]])
    return pd.DataFrame(
        {
            "detection_id_from": _taken(a.ids, rows_from),
            "detection_id_to": _taken(b.ids, rows_to),
            "probability": probability,
            "method": pd.Series([method] * len(rows_from), dtype="str"),
        }
    )


def _taken(ids: pd.Series, rows: np.ndarray) -> pd.api.extensions.ExtensionArray:
    """Return ids by row number, null where it is -1, in the ids' own type."""
    return pd.array(ids).take(rows, allow_fill=True)
