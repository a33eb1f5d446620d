"""Who drives: kinds of vehicles, their sizes, paint and drivers, when each one departs and where to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation.params import DemandParams
from vtrack_batch.simulation.scenes import Flow

Ints = NDArray[np.int64]

KINDS = ("car", "van", "lorry", "bus")
_SHARE = (0.82, 0.08, 0.08, 0.02)
# mean, spread, least, most
_LENGTH_M = ((4.5, 0.3, 3.6, 5.1), (5.6, 0.35, 4.9, 6.6), (9.0, 1.2, 7.0, 11.5), (12.0, 0.2, 11.5, 12.5))
_WIDTH_M = ((1.80, 0.06, 1.65, 1.95), (2.05, 0.06, 1.9, 2.2), (2.5, 0.03, 2.4, 2.55), (2.55, 0.0, 2.55, 2.55))
_HEIGHT_M = ((1.5, 0.08, 1.35, 1.8), (2.1, 0.2, 1.8, 2.7), (3.3, 0.3, 2.6, 3.9), (3.1, 0.1, 2.9, 3.4))
# mean as a share of the limit, spread as a share of the fleet's, least, most
_SPEED_FACTOR = ((1.0, 1.0, 0.6, 1.35), (0.98, 0.95, 0.6, 1.3), (0.85, 0.55, 0.6, 1.0), (0.82, 0.4, 0.6, 1.0))
_ACCEL_MPS2 = (2.4, 1.9, 1.2, 1.1)
_MOST_MPS = (50.0, 40.0, 25.0, 25.0)

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

# SUMO's vehicle classes: kind, and the length in metres of types that name none
_CLASSES = {
    "passenger": (0, 5.0), "private": (0, 5.0), "taxi": (0, 5.0), "evehicle": (0, 5.0), "hov": (0, 5.0),
    "delivery": (1, 6.5), "emergency": (1, 6.5), "authority": (0, 5.0), "army": (2, 7.1), "vip": (0, 5.0),
    "truck": (2, 7.1), "trailer": (2, 16.5), "bus": (3, 12.0), "coach": (3, 14.0), "tram": (3, 22.0),
    "motorcycle": (0, 2.2), "moped": (0, 2.1), "bicycle": (0, 1.6),
}  # fmt: skip
_SPOKEN = {"car": 0, "van": 1, "truck": 2, "lorry": 2, "hgv": 2, "bus": 3, "coach": 3}


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
    """All vehicles of a simulation: ``names`` as SUMO knows them (sorted), ``ids`` as the truth tells them."""

    names: tuple[str, ...]
    ids: NDArray[np.object_]
    looks: Looks

    def __len__(self) -> int:
        """Return the number of vehicles."""
        return len(self.names)


def draw_looks(count: int, kinds: Ints | None, *, rng: np.random.Generator, shares: Sequence[float] = _SHARE) -> Looks:
    """Draw sizes and paint of *count* vehicles; *kinds* (count,) or None for the *shares* of the fleet."""
    kind = rng.choice(len(KINDS), count, p=shares) if kinds is None else kinds
    paint = _PAINT_RGB[rng.choice(len(PAINTS), count, p=_PAINT_SHARE)]
    body = _PAINT_RGB[rng.choice(len(PAINTS), count, p=_BODY_SHARE)]
    length_m, width_m, height_m = (_clipped(table, kind, rng) for table in (_LENGTH_M, _WIDTH_M, _HEIGHT_M))
    paints = _varied(paint, rng), _varied(body, rng)
    return Looks(kind, length_m, width_m, height_m, *paints, rng.uniform(0.7, 1.5, count))


def draw_demand(
    flows: Sequence[Flow], demand: DemandParams, *, end_s: float, rng: np.random.Generator
) -> tuple[str, Fleet]:
    """Draw every vehicle that departs until *end_s*: SUMO's routes file, and the fleet that it describes.

    Arrivals are Poisson; each vehicle is a type of its own, with its own size and driver.
    """
    counts = rng.poisson([flow.vph / 3600 * end_s for flow in flows]) if flows else np.zeros(0, int)
    flow, depart_s = np.repeat(np.arange(len(flows)), counts), rng.uniform(0, end_s, int(counts.sum()))
    order = np.lexsort((flow, depart_s))
    flow, depart_s = flow[order], depart_s[order]
    names = [f"v{k:06d}" for k in range(len(flow))]
    others = (demand.van_share, demand.lorry_share, demand.bus_share)
    looks = draw_looks(len(flow), None, rng=rng, shares=(1 - sum(others), *others))
    looks = replace(looks, length_m=looks.length_m.round(2), width_m=looks.width_m.round(2))
    drivers = _drivers(looks.kind, demand, rng)
    root = Element("routes")
    for k, name in enumerate(names):
        size = {"length": looks.length_m[k], "width": looks.width_m[k], "height": looks.height_m[k]}
        traits = {key: f"{values[k]:.3f}" for key, values in drivers.items()} | {"speedDev": "0"}
        SubElement(root, "vType", {"id": name, **{key: f"{value:.2f}" for key, value in size.items()}, **traits})
    for k, name in enumerate(names):
        between = {"from": flows[flow[k]].origin, "to": flows[flow[k]].destination}
        start = {"depart": f"{depart_s[k]:.2f}", "departLane": "best", "departSpeed": "max", "departPos": "base"}
        SubElement(root, "trip", {"id": name, "type": name, **between, **start})
    text = tostring(root, encoding="unicode").replace("><", ">\n<")
    return text + "\n", Fleet(tuple(names), random_ids(len(names), rng), looks)


def fleet_of_types(
    names: Sequence[str], types: Sequence[str], known: Mapping[str, Mapping[str, str]], *, rng: np.random.Generator
) -> Fleet:
    """Return the fleet of vehicles *names* (sorted) of SUMO *types*; *known* are the attributes of the types.

    Sizes are those of the type, drawn by kind where it gives none; a length is SUMO's own, for it drives by it.
    """
    each = [known.get(name, {}) for name in types]
    kinds = np.array([_kind(name, row) for name, row in zip(types, each, strict=True)], np.int64)
    looks = draw_looks(len(names), kinds, rng=rng)
    default = [_CLASSES.get(row.get("vClass", "passenger"), (0, 5.0))[1] for row in each]
    length_m = np.array([float(row.get("length", m)) for row, m in zip(each, default, strict=True)])
    width_m, height_m = (
        np.array([float(row.get(key, drawn)) for row, drawn in zip(each, values, strict=True)])
        for key, values in (("width", looks.width_m), ("height", looks.height_m))
    )
    looks = replace(looks, length_m=length_m, width_m=width_m, height_m=height_m)
    return Fleet(tuple(names), random_ids(len(names), rng), looks)


def _kind(name: str, attributes: Mapping[str, str]) -> int:
    """Return the kind that a type's class says; else the one that its name or its length does."""
    if attributes.get("vClass", "passenger") != "passenger":
        return _CLASSES.get(attributes["vClass"], (0, 0.0))[0]
    spoken = [kind for word, kind in _SPOKEN.items() if word in name.lower()]
    length_m = float(attributes.get("length", "5.0"))
    return spoken[0] if spoken else int(np.searchsorted([5.4, 7.0, 11.0], length_m))


def _drivers(kind: Ints, demand: DemandParams, rng: np.random.Generator) -> dict[str, Array]:
    n = len(kind)
    mean, spread, least, most = np.array(_SPEED_FACTOR)[kind].reshape(-1, 4).T
    heavy = np.where(kind >= KINDS.index("lorry"), 0.2, 0.0)
    return {
        "speedFactor": np.clip(mean + demand.speed_spread * spread * rng.standard_normal(n), least, most),
        "accel": np.array(_ACCEL_MPS2)[kind] * rng.uniform(0.85, 1.15, n),
        "decel": rng.uniform(4.0, 5.0, n),
        "tau": rng.uniform(0.8, 1.2, n) + heavy,
        "minGap": rng.uniform(1.5, 2.6, n),
        "sigma": np.full(n, demand.sigma),
        "maxSpeed": np.array(_MOST_MPS)[kind],
    }


def _clipped(table: tuple[tuple[float, float, float, float], ...], kind: Ints, rng: np.random.Generator) -> Array:
    mean, spread, least, most = np.array(table)[kind].reshape(-1, 4).T
    return np.clip(mean + spread * rng.standard_normal(len(kind)), least, most)


def _varied(rgb: Array, rng: np.random.Generator) -> Array:
    """Vary paint between vehicles: 14 levels in common and 6 per channel, as in the pinned traffic scenes."""
    n = len(rgb)
    return np.clip(rgb + 14 * rng.standard_normal((n, 1)) + 6 * rng.standard_normal((n, 3)), 8, 250)


def random_ids(
    count: int, rng: np.random.Generator, *, form: str = "t-{:x}", least: int = 36**7, below: int = 36**8
) -> NDArray[np.object_]:
    """Return distinct ids (count,) that carry no order: numbers from *least* to *below*, written in *form*."""
    ids: dict[str, None] = {}
    while len(ids) < count:
        ids[form.format(int(rng.integers(least, below)))] = None
    return np.array(list(ids), object)
