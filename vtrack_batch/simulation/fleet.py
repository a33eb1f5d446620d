"""Who drives: kinds of vehicles, their sizes, paint and drivers, and when each one arrives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation.network import Network
from vtrack_batch.simulation.params import Scenario

Ints = NDArray[np.int64]

KINDS = ("car", "van", "lorry", "bus")
_SHARE = (0.82, 0.08, 0.08, 0.02)
# mean, spread, least, most
_LENGTH_M = ((4.5, 0.3, 3.6, 5.1), (5.6, 0.35, 4.9, 6.6), (9.0, 1.2, 7.0, 11.5), (12.0, 0.2, 11.5, 12.5))
_WIDTH_M = ((1.80, 0.06, 1.65, 1.95), (2.05, 0.06, 1.9, 2.2), (2.5, 0.03, 2.4, 2.55), (2.55, 0.0, 2.55, 2.55))
_HEIGHT_M = ((1.5, 0.08, 1.35, 1.8), (2.1, 0.2, 1.8, 2.7), (3.3, 0.3, 2.6, 3.9), (3.1, 0.1, 2.9, 3.4))
_SPEED_FACTOR = ((1.02, 0.15, 0.65, 1.35), (0.98, 0.14, 0.65, 1.3), (0.85, 0.08, 0.65, 1.0), (0.82, 0.06, 0.65, 1.0))
_ACCEL_MPS2 = (2.4, 1.9, 1.2, 1.1)

PAINTS = ("white", "black", "grey", "silver", "blue", "red", "brown", "green", "yellow")
_PAINT_SHARE = (0.34, 0.19, 0.16, 0.09, 0.08, 0.07, 0.03, 0.02, 0.02)
_PAINT_RGB = np.array(
    [
        (222, 222, 218), (36, 36, 39), (104, 106, 109), (166, 169, 172), (42, 66, 128),
        (148, 36, 34), (92, 68, 50), (46, 84, 58), (204, 168, 44),
    ],
    float,
)  # fmt: skip
_BODY_SHARE = (0.55, 0.04, 0.18, 0.10, 0.05, 0.04, 0.0, 0.02, 0.02)
"""Paint of a lorry's box."""


@dataclass(frozen=True)
class Looks:
    """Sizes and paint of n vehicles: ``kind`` (n,) index into KINDS, lengths in metres, colours (n, 3) 0-255."""

    kind: Ints
    length_m: Array
    width_m: Array
    height_m: Array
    paint_rgb: Array
    body_rgb: Array
    glass: Array

    def take(self, index: Ints) -> Looks:
        """Return the looks of the vehicles at *index*."""
        return Looks(
            self.kind[index], self.length_m[index], self.width_m[index], self.height_m[index],
            self.paint_rgb[index], self.body_rgb[index], self.glass[index],
        )  # fmt: skip


@dataclass(frozen=True)
class Fleet:
    """All vehicles of a simulation in order of arrival; drivers' traits are (n,) float64."""

    ids: list[str]
    looks: Looks
    route: Ints
    arrival_s: Array
    speed_mps: Array
    accel_mps2: Array
    headway_s: Array
    gap_m: Array
    sway_rad: Array
    """Phase of the slow sway of the wished speed, which stands for inattention."""

    def __len__(self) -> int:
        """Return the number of vehicles."""
        return len(self.ids)


def draw_looks(count: int, kinds: Ints | None, *, rng: np.random.Generator) -> Looks:
    """Draw sizes and paint of *count* vehicles; *kinds* (count,) or None for the shares of the fleet."""
    kind = rng.choice(len(KINDS), count, p=_SHARE) if kinds is None else kinds
    paint = _PAINT_RGB[rng.choice(len(PAINTS), count, p=_PAINT_SHARE)]
    body = _PAINT_RGB[rng.choice(len(PAINTS), count, p=_BODY_SHARE)]
    length_m, width_m, height_m = (_clipped(table, kind, rng) for table in (_LENGTH_M, _WIDTH_M, _HEIGHT_M))
    paints = _varied(paint, rng), _varied(body, rng)
    return Looks(kind, length_m, width_m, height_m, *paints, rng.uniform(0.7, 1.5, count))


def draw_fleet(network: Network, scenario: Scenario, *, rng: np.random.Generator) -> Fleet:
    """Draw every vehicle that arrives between the warm-up's begin (time 0) and the end of the archive."""
    end_s = scenario.warm_up_s + scenario.frame_count * scenario.interval_s
    arrivals, routes = [], []
    for origin in network.origins:
        count = rng.poisson(scenario.demand_vph / 3600 * end_s)
        index, weight = _choices(network, origin, scenario)
        arrivals.append(np.sort(rng.uniform(0, end_s, count)))
        routes.append(rng.choice(index, count, p=weight))
    arrival_s, route = np.concatenate(arrivals), np.concatenate(routes).astype(np.int64)
    order = np.lexsort((route, arrival_s))
    arrival_s, route = arrival_s[order], route[order]
    n = len(route)
    looks = draw_looks(n, _kinds_by_route(network, route, rng), rng=rng)
    return Fleet(
        ids=_random_ids(n, rng),
        looks=looks,
        route=route,
        arrival_s=arrival_s,
        speed_mps=scenario.speed_limit_mps * _clipped(_SPEED_FACTOR, looks.kind, rng),
        accel_mps2=np.array(_ACCEL_MPS2)[looks.kind] * rng.uniform(0.85, 1.15, n),
        headway_s=rng.uniform(0.8, 1.2, n) + np.where(looks.kind >= 2, 0.2, 0.0),
        gap_m=rng.uniform(1.5, 2.6, n),
        sway_rad=rng.uniform(0, 2 * np.pi, n),
    )


def _choices(network: Network, origin: str, scenario: Scenario) -> tuple[Ints, Array]:
    """Return the routes from *origin* and their probabilities; lane 0 shares through traffic with right turns."""
    index = [k for k, route in enumerate(network.routes) if route.origin == origin]
    through = 1 - scenario.left_share - scenario.right_share
    shares = []
    for k in index:
        route = network.routes[k]
        by_lane = through * (0.4 if route.in_lane % 3 == 0 else 0.6)
        shares.append({"left": scenario.left_share, "right": scenario.right_share, "through": by_lane}.get(
            str(route.movement), 1.0))  # fmt: skip
    weight = np.array(shares)
    return np.array(index, np.int64), weight / weight.sum()


def _kinds_by_route(network: Network, route: Ints, rng: np.random.Generator) -> Ints:
    """Draw kinds; a bus that would turn at the crossing becomes a car, because its rear would swing into a lane."""
    kind = rng.choice(len(KINDS), len(route), p=_SHARE)
    turns = np.array([r.movement in ("left", "right") for r in network.routes])[route]
    return np.where(turns & (kind == KINDS.index("bus")), 0, kind)


def _clipped(table: tuple[tuple[float, float, float, float], ...], kind: Ints, rng: np.random.Generator) -> Array:
    mean, spread, least, most = np.array(table)[kind].T
    return np.clip(mean + spread * rng.standard_normal(len(kind)), least, most)


def _varied(rgb: Array, rng: np.random.Generator) -> Array:
    """Vary paint between vehicles: 14 levels in common and 6 per channel, as in the pinned traffic scenes."""
    n = len(rgb)
    return np.clip(rgb + 14 * rng.standard_normal((n, 1)) + 6 * rng.standard_normal((n, 3)), 8, 250)


def _random_ids(count: int, rng: np.random.Generator) -> list[str]:
    """Return distinct ids that carry no order."""
    ids: dict[str, None] = {}
    while len(ids) < count:
        ids[f"t-{int(rng.integers(36**7, 36**8)):x}"] = None
    return list(ids)
