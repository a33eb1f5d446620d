"""Everybody's methods, with one way to call them: ours in this process, peers in environments of their own."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import vtrack_batch as vt
from benchmarks.environment import run_peer
from benchmarks.noise import Noise
from benchmarks.paper_methods import METHODS
from benchmarks.work import COLOURS, START, archive

Setting = Mapping[str, Any]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Ours:
    """One of our methods: the name of ``vt.match`` and ``vt.track``, and what it is given."""

    name: str
    method: str = "default"
    mapped: bool = False
    colour: bool = True


@dataclass(frozen=True)
class Peer:
    """Somebody else's method: its environment, what it is given, and the settings from which the best is taken."""

    name: str
    environment: str
    colour: bool
    pairs: tuple[Setting, ...]
    tracks: tuple[Setting, ...] = field(default=())


OURS = (
    Ours("default, flow map", mapped=True),
    Ours("default"),
    Ours("untrained", "untrained"),
    Ours("regions (Badenas)", "regions"),
    *(Ours(f"paper's {letter}", method) for method, letter in METHODS.items()),
    Ours("our assignment", "assignment"),
    Ours("our assignment, no colour", "assignment", colour=False),
    Ours("nearest", "nearest"),
)
REACH = (12.0, 20.0, 33.0)
LEVELS = (0.1, 0.3, 1.0, 3.0)  # metres per level of colour difference


def _grid(**values: tuple[Any, ...]) -> tuple[Setting, ...]:
    """Return all combinations."""
    combined: list[dict[str, Any]] = [{}]
    for name, options in values.items():
        combined = [{**setting, name: option} for setting in combined for option in options]
    return tuple(combined)


PEERS = (
    Peer(
        "scipy assignment",
        "scipy",
        False,
        _grid(reach_mps=REACH, metres_per_level=(0.0,), colour=(False,)),
        _grid(reach_mps=REACH, metres_per_level=(0.0,), predict=(False, True), colour=(False,)),
    ),
    Peer(
        "scipy assignment, colour",
        "scipy",
        True,
        _grid(reach_mps=REACH, metres_per_level=LEVELS),
        _grid(reach_mps=REACH, metres_per_level=LEVELS, predict=(False, True)),
    ),
    Peer(
        "laptrack",
        "laptrack",
        False,
        _grid(reach_mps=REACH, colour=(False,)),
        _grid(reach_mps=REACH, gaps=(0, 2), colour=(False,)),
    ),
    Peer(
        "laptrack, colour",
        "laptrack",
        True,
        _grid(reach_mps=REACH, metres_per_level=LEVELS),
        _grid(reach_mps=REACH, metres_per_level=LEVELS, gaps=(0, 2)),
    ),
    Peer(
        "trackpy",
        "trackpy",
        False,
        _grid(reach_mps=(3.0, 6.0, 12.0, 20.0), colour=(False,)),
        _grid(reach_mps=(3.0, 6.0, 12.0, 20.0), memory=(0, 2), predict=(False, True), colour=(False,)),
    ),
    Peer(
        "norfair (SORT type)",
        "norfair",
        True,
        _grid(reach_mps=REACH, metres_per_level=(0.0, *LEVELS)),
        _grid(reach_mps=REACH, metres_per_level=(0.0, 0.15), memory=(0, 2), speed_mps=(3.0, 10.0)),
    ),
)


@cache
def flow_map(scene: str, interval_s: float, seconds: float, noise: Noise | None = None) -> Any:
    """Return the flow map that the first *seconds* of a scene's unlabelled archive teach, at one interval."""
    rows = archive(scene, interval_s, noise)
    return vt.learn_flow(rows[rows["t_utc"] < START + pd.Timedelta(seconds, "s")])


def match_ours(ours: Ours, rows: pd.DataFrame, learned: Any) -> tuple[pd.DataFrame, dict[int, float]]:
    """Match every pair; return ``sequence, i, k, probability`` (rows in their image) and processor seconds by pair."""
    columns = ["detection_id", "x_m", "y_m", *(COLOURS if ours.colour and "red" in rows else [])]
    answers = []
    for name, pair in rows.groupby("sequence", sort=True):
        images = [pair[pair["frame"] == f].assign(detection_id=lambda t: np.arange(len(t)))[columns] for f in (0, 1)]
        given = {"elapsed_s": float(pair["interval_s"].iloc[0]), "method": ours.method}
        if not answers:
            vt.match(*images, **given, flow_map=learned if ours.mapped else None)  # compiles
        start = time.process_time()
        found = vt.match(*images, **given, flow_map=learned if ours.mapped else None)
        seconds = time.process_time() - start
        found = found.dropna(subset=["detection_id_from", "detection_id_to"])
        found = found.rename(columns={"detection_id_from": "i", "detection_id_to": "k"})[["i", "k", "probability"]]
        answers.append((name, found.astype({"i": int, "k": int}), seconds))
    links = pd.concat([found.assign(sequence=name) for name, found, _ in answers], ignore_index=True)
    return links, {name: seconds for name, _, seconds in answers}


def track_ours(ours: Ours, rows: pd.DataFrame, learned: Any) -> tuple[Index, dict[int, float]]:
    """Track every sequence; return the track of each row (-1 = none) and the seconds of each sequence."""
    columns = ["detection_id", "t_utc", "x_m", "y_m", *(COLOURS if ours.colour and "red" in rows else [])]
    track, seconds = np.full(len(rows), -1), {}
    for name, of_sequence in rows.groupby("sequence", sort=True):
        since = pd.to_timedelta(of_sequence["frame"] * of_sequence["interval_s"], unit="s")
        ids = np.random.default_rng(11).permutation(len(of_sequence))
        given = of_sequence.assign(detection_id=ids, t_utc=START + since)[columns].sample(frac=1, random_state=7)
        call = {"method": ours.method, "flow_map": learned if ours.mapped else None}
        if not seconds:
            vt.track(given[given["t_utc"] < START + pd.Timedelta(20, "s")], **call)  # compiles
        start = time.process_time()
        points = vt.track(given, **call).track_points
        seconds[int(name)] = time.process_time() - start
        points = points.dropna(subset=["detection_id"])
        code = pd.Series(pd.factorize(points["vehicle_id"])[0], index=points["detection_id"].astype(int))
        track[of_sequence.index] = code.reindex(ids).fillna(-1).astype(int).to_numpy()
    return track, seconds


def run_on(peer: Peer, rows: pd.DataFrame, grid: Sequence[Setting], limit_s: float = 0) -> tuple[Index, pd.DataFrame]:
    """Run a peer with every setting; return tracks (settings, rows), -1 = none, and ``setting, sequence, seconds``.

    Where *rows* have a column ``setting``, each sequence is run with that setting only, and the tracks are (1, rows). A
    setting that needs longer than *limit_s* for a sequence is given up (0 = never).
    """
    given = rows.drop(columns=["truth", *(c for c in COLOURS if not peer.colour and c in rows)])
    answer = run_peer(
        peer.environment, peer.environment, {"detections": given}, grid=[dict(s) for s in grid], limit_s=limit_s
    )
    found = answer["tracks"]
    tracks = np.full((1 if "setting" in rows else len(grid), len(rows)), -1)
    tracks[0 if "setting" in rows else found["setting"], found["row"]] = found["track"]
    return tracks, answer["seconds"]
