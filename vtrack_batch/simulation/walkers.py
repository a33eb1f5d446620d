"""Who is no traffic but moves: people on the pavements, and a tram on its line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation import polyline
from vtrack_batch.simulation.canvas import Canvas
from vtrack_batch.simulation.fleet import Looks
from vtrack_batch.simulation.paint import PERSON, TRAM

SECTIONS = 3
_SECTION_M, _SECTION_WIDTH_M, _TRAM_MPS = 9.4, 2.4, 8.0
_CLOTHES = np.array([(40, 42, 50), (70, 72, 80), (120, 60, 60), (190, 188, 182), (60, 80, 110), (150, 130, 90)], float)


@dataclass(frozen=True)
class People:
    """Walkers on their ``paths``: n of them with the number of the path, arc length at time 0 and signed speed."""

    paths: list[Array]
    path: NDArray[np.int64]
    begin_m: Array
    speed_mps: Array
    looks: Looks

    def at(self, t_s: float) -> tuple[Array, Array]:
        """Return where they are (n, 2) and which way they go (n, 2), in scene metres; they turn round at ends."""
        xy, forward = np.zeros((len(self.path), 2)), np.zeros((len(self.path), 2))
        for k in np.unique(self.path):
            mine, line = self.path == k, self.paths[int(k)]
            length = float(polyline.lengths(line)[-1])
            folded = np.mod(self.begin_m[mine] + self.speed_mps[mine] * t_s, 2 * length)
            there = folded < length
            at, ahead = polyline.along(line, np.where(there, folded, 2 * length - folded))
            sign = np.where(there, 1.0, -1.0) * np.sign(self.speed_mps[mine])
            xy[mine], forward[mine] = at, ahead * sign[:, None]
        return xy, forward


@dataclass(frozen=True)
class Tram:
    """A tram every ``every_s`` along ``line`` (n, 2) in scene metres; ``looks`` are those of its sections."""

    line: Array
    every_s: float
    offset_s: float
    looks: Looks

    def at(self, t_s: float) -> tuple[Array, Array]:
        """Return the centres (k, 2) of all sections on the line and their unit vectors (k, 2); k may be 0."""
        length = float(polyline.lengths(self.line)[-1]) - _SECTION_M
        running = int(length / (_TRAM_MPS * self.every_s)) + 2
        ages = np.mod(t_s + self.offset_s, self.every_s) + self.every_s * np.arange(running)
        head = (ages * _TRAM_MPS)[:, None] - np.arange(SECTIONS) * _SECTION_M
        centre = np.sort(head[(head > _SECTION_M) & (head < length)])
        front, _ = polyline.along(self.line, centre + _SECTION_M / 2)
        rear, _ = polyline.along(self.line, centre - _SECTION_M / 2)
        chord = front - rear
        return (front + rear) / 2, chord / np.maximum(np.hypot(*chord.T), 1e-9)[:, None]


def draw_people(walks: list[Array], canvas: Canvas, per_km: float, *, rng: np.random.Generator) -> People:
    """Put people on those of the *walks* that are in view, *per_km* of pavement."""
    paths = [line for line in walks if canvas.inside(line, margin_m=0.0).any()]
    count = np.array([rng.poisson(per_km * polyline.lengths(line)[-1] / 1000) for line in paths], int).reshape(-1)
    path = np.repeat(np.arange(len(paths), dtype=np.int64), count)
    n = len(path)
    length = np.array([polyline.lengths(line)[-1] for line in paths], float).reshape(-1)[path]
    speed = rng.normal(1.35, 0.2, n) * rng.choice([-1.0, 1.0], n)
    clothes = _CLOTHES[rng.integers(0, len(_CLOTHES), n)] + rng.normal(0, 12, (n, 3))
    sizes = rng.uniform(0.4, 0.55, n), rng.uniform(0.45, 0.65, n), rng.uniform(1.5, 1.9, n)
    looks = Looks(np.full(n, PERSON), *sizes, clothes, clothes, np.ones(n))
    return People(paths, path, rng.uniform(0, 2, n) * length, speed, looks)


def draw_tram(line: Array, every_s: float, *, rng: np.random.Generator) -> Tram:
    """Put a tram onto the *line* (n, 2) of scene metres."""
    paint = np.tile(np.array([178.0, 176.0, 168.0]) + rng.normal(0, 6, 3), (SECTIONS, 1))
    sizes = np.full(SECTIONS, _SECTION_M - 0.2), np.full(SECTIONS, _SECTION_WIDTH_M), np.full(SECTIONS, 3.4)
    looks = Looks(np.full(SECTIONS, TRAM), *sizes, paint, paint, np.ones(SECTIONS))
    return Tram(line, every_s, float(rng.uniform(0, every_s)), looks)
