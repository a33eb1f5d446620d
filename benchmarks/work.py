"""The work that methods are measured on, and how their answers are scored.

A table of *sightings* holds ``x_m, y_m`` (and ``red, green, blue``), ``sequence`` (a number), ``frame`` (0, 1, ... in
it), ``interval_s`` and ``truth``; a pair of images is a sequence of two frames. Answers are numbers of rows or tracks.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from benchmarks.archives import MUNICH, MUNICH_GSD_M
from benchmarks.noise import COLOURS, Noise, recoloured
from benchmarks.page import SHARED

SUMO = SHARED / "sumo"
SCENES = ("road", "congested", "crossing", "grid")
INTERVALS_S = (0.5, 1.5, 2.5, 4.0)
SONGDO_HZ, KIT_HZ = 29.97, 2
MOVES_M = 5.0
START = pd.Timestamp("2026-05-17T08:00:00Z")

Index = NDArray[np.int64]


def pinned_pairs(scene: str, elapsed_s: float, missed: float, limit: int) -> pd.DataFrame:
    """Return the sightings of the first *limit* pinned pairs of a cell."""
    pairs = pd.read_parquet(SUMO / "pairs.parquet", filters=[("scene", "==", scene)])
    cell = pairs[np.isclose(pairs["elapsed_s"], elapsed_s) & np.isclose(pairs["missed"], missed)]
    return pairs_as_sightings(cell[cell["pair"].isin(cell["pair"].unique()[:limit])])


def pairs_as_sightings(pairs: pd.DataFrame) -> pd.DataFrame:
    """Return labelled pairs, in the pinned columns, as sightings; rows keep their order within an image."""
    rows = pairs.rename(columns={"pair": "sequence", "truth_vehicle": "truth", "elapsed_s": "interval_s"})
    rows = rows.assign(frame=rows["image"].astype(int) - 1, interval_s=rows["interval_s"].astype(float).round(3))
    columns = ["sequence", "frame", "interval_s", "x_m", "y_m", *COLOURS, "truth"]
    return rows[columns].sort_values(["sequence", "frame"], kind="stable", ignore_index=True)


def pinned_sequences(scene: str, interval_s: float, missed: float) -> pd.DataFrame:
    """Return the sightings of the pinned sequences of a cell, one sequence a seed."""
    rows = pd.read_parquet(SUMO / f"sequences_{scene}.parquet")
    return sequences_as_sightings(rows[np.isclose(rows["interval_s"], interval_s) & np.isclose(rows["missed"], missed)])


def sequences_as_sightings(rows: pd.DataFrame) -> pd.DataFrame:
    """Return labelled sequences, in the pinned columns, as sightings."""
    interval_s = rows["interval_s"].astype(float).round(3)
    rows = rows.assign(
        sequence=rows["seed"].astype(int),
        frame=(rows["t_s"].astype(float) / interval_s).round().astype(int),
        interval_s=interval_s,
        truth=rows["truth_vehicle"],
    )
    columns = ["sequence", "frame", "interval_s", "x_m", "y_m", *COLOURS, "truth"]
    return rows[columns].sort_values(["sequence", "frame"], kind="stable", ignore_index=True)


def archive(scene: str, interval_s: float, noise: Noise | None = None) -> pd.DataFrame:
    """Return the unlabelled archive of a scene, thinned to an interval, as ``learn_flow`` takes it."""
    rows = pd.read_parquet(SUMO / f"archive_{scene}.parquet")
    rows = rows[np.isclose(rows["t_s"] % interval_s, 0)].reset_index(drop=True)
    rows = rows.assign(detection_id=np.arange(len(rows)), t_utc=START + pd.to_timedelta(rows["t_s"].astype(float), "s"))
    rows = rows if noise is None else noisier(rows, noise)
    return rows[["detection_id", "t_utc", "x_m", "y_m", *COLOURS]]


def noisier(rows: pd.DataFrame, noise: Noise) -> pd.DataFrame:
    """Return sightings with further noise on top of that which they have."""
    rng = np.random.default_rng(5)
    rows = rows.copy()
    rows[["x_m", "y_m"]] += rng.normal(0, noise.position_m, (len(rows), 2))
    rows[COLOURS] = recoloured(rows[COLOURS].to_numpy(float), noise, rng)
    return rows


def songdo(interval_s: float, seed: int) -> pd.DataFrame:
    """Return a real junction (5 s) at a lower rate, 10 % dropped, jitter 0.3 m; *seed* also sets the first frame."""
    return _thinned(songdo_tracks(), round(interval_s * SONGDO_HZ), interval_s, seed)


def songdo_tracks() -> pd.DataFrame:
    """Return ``truth, frame, x_m, y_m`` of the real junction, all frames."""
    names = {"Vehicle_ID": "truth", "Frame_Number": "frame", "Local_X": "x_m", "Local_Y": "y_m"}
    return pd.read_csv(SHARED / "songdo" / "tracks.csv", usecols=list(names)).rename(columns=names)[[*names.values()]]


def skysat(interval_s: float, seed: int) -> pd.DataFrame:
    """Return look-alike vehicles of a satellite video (1 m a pixel, 23 s) thinned, 10 % dropped, jitter 0.3 m."""
    names = ["frame", "truth", "col", "row", "width", "height"]
    rows = pd.read_csv(SHARED / "skysat" / "tracks.csv", header=None, usecols=range(6), names=names)
    rows = rows.assign(x_m=rows["col"] + rows["width"] / 2, y_m=-(rows["row"] + rows["height"] / 2))
    return _thinned(rows[["truth", "frame", "x_m", "y_m"]], round(interval_s * 30), interval_s, seed)


def kit_boxes(interval_s: float, seed: int) -> pd.DataFrame:
    """Return the boxes of MunichStreet02 (0.12 m a pixel, 10 s), 10 % dropped, jitter 0.3 m; ``counted`` = it moves."""
    rows = pd.read_csv(MUNICH / "tracks.csv").rename(columns={"id": "truth"})
    rows = rows.assign(x_m=rows["left"] + rows["width"] / 2, y_m=-(rows["top"] + rows["height"] / 2))
    rows[["x_m", "y_m"]] *= MUNICH_GSD_M
    moved = rows.groupby("truth")[["x_m", "y_m"]].agg(np.ptp).max(axis=1)
    rows = rows.assign(frame=rows["frame"] - rows["frame"].min(), counted=rows["truth"].map(moved) >= MOVES_M)
    return _thinned(rows[["truth", "frame", "x_m", "y_m", "counted"]], round(interval_s * KIT_HZ), interval_s, seed)


def _thinned(rows: pd.DataFrame, every: int, interval_s: float, seed: int) -> pd.DataFrame:
    rng = np.random.default_rng([3, seed])
    first = int(rng.integers(every))
    rows = rows[(rows["frame"] % every == first) & (rng.random(len(rows)) >= 0.1)]
    rows = rows.sample(frac=1, random_state=seed).assign(frame=rows["frame"] // every, sequence=seed)
    rows[["x_m", "y_m"]] += rng.normal(0, 0.3, (len(rows), 2))
    return rows.assign(interval_s=interval_s).sort_values(["sequence", "frame"], kind="stable", ignore_index=True)


def label_rates(truth_1: Index, truth_2: Index, i: Index, k: Index) -> tuple[float, float, float]:
    """Return the shares of right labels in image 1, in image 2, and over both; *i*, *k* are the linked rows.

    Rows of *truth* are vehicles; a vehicle without a partner is right when it is left alone. Where several links meet
    in one row, the last counts.
    """
    forward, backward = np.full(len(truth_1), -1), np.full(len(truth_2), -1)
    forward[i], backward[k] = k, i
    right_1 = int((forward == _partners(truth_1, truth_2)).sum())
    right_2 = int((backward == _partners(truth_2, truth_1)).sum())
    return right_1 / len(truth_1), right_2 / len(truth_2), (right_1 + right_2) / (len(truth_1) + len(truth_2))


def _partners(truth: Index, other: Index) -> Index:
    """Return for each vehicle its row in the other image, -1 = it is not there."""
    row = pd.Series(np.arange(len(other)), index=other)
    return np.asarray(row.reindex(truth).fillna(-1), np.int64)


def links_of(track: Index, frame: Index) -> tuple[Index, Index]:
    """Return the links between rows of frames 0 and 1 that tracks mean; rows count within their frame."""
    first, second = np.flatnonzero(frame == 0), np.flatnonzero(frame == 1)
    row = pd.Series(np.arange(len(second)), index=track[second])
    k = np.asarray(row[row.index >= 0].reindex(track[first]).fillna(-1), np.int64)
    return np.flatnonzero(k >= 0), k[k >= 0]


def step_rates(rows: pd.DataFrame, track: Index) -> pd.DataFrame:
    """Return the pooled label rate between every two successive frames of every sequence, by ``sequence, frame``.

    Where *rows* have a column ``counted``, only the labels of these rows count; the others can still be wrong partners.
    """
    counts = rows.get("counted", True)
    table = rows[["sequence", "frame"]].assign(row=np.arange(len(rows)), truth=rows["truth"], track=track)
    right = np.zeros(len(rows)), np.zeros(len(rows))
    for step, into in zip((1, -1), right, strict=True):
        beside = table.assign(frame=table["frame"] - step)
        true = table.merge(beside, on=["sequence", "frame", "truth"], how="left")["row_y"].fillna(-1)
        links = beside[beside["track"] >= 0]
        found = table.merge(links, on=["sequence", "frame", "track"], how="left")["row_y"].fillna(-1)
        into[:] = true.to_numpy() == found.to_numpy()
    # the labels of a frame towards the next one, and of the next one back
    table = table.assign(ahead=right[0], behind=right[1])[np.broadcast_to(counts, len(rows))]
    ahead = table.groupby(["sequence", "frame"])["ahead"].agg(["sum", "size"])
    behind = table.assign(frame=table["frame"] - 1).groupby(["sequence", "frame"])["behind"]
    both = ahead.join(behind.agg(["sum", "size"]), how="inner", suffixes=("_1", "_2"))
    rate = (both["sum_1"] + both["sum_2"]) / (both["size_1"] + both["size_2"])
    return rate.rename("rate").reset_index()


def identity(truth: Index, track: Index) -> dict[str, float]:
    """Return IDF1 and the share of vehicles (of >= 4 sightings) whose every sighting is one track's, and its only ones.

    Rows are in order of time; track -1 = none.
    """
    vehicles, v = np.unique(truth, return_inverse=True)
    kept = track >= 0
    numbers, t = np.unique(track[kept], return_inverse=True)
    overlap = np.zeros((len(vehicles), max(len(numbers), 1)))
    np.add.at(overlap, (v[kept], t), 1)
    i, j = linear_sum_assignment(-overlap)
    size = np.bincount(v)
    best = overlap.argmax(axis=1)
    whole = (overlap.max(axis=1) == size) & (overlap.sum(axis=0)[best] == size)
    return {
        "idf1": 2 * overlap[i, j].sum() / (len(truth) + kept.sum()),
        "whole": float(whole[size >= 4].mean()),
    }


def movement_scores(rows: pd.DataFrame, track: Index, border_m: float) -> dict[str, float]:
    """Return how well tracks count the movements between the four sides of the view of one sequence.

    A movement counts when a track, or a vehicle, has its first and its last sighting within *border_m* of two sides.
    ``od_error`` = Σ|found - true| / Σ true; ``turn_error`` = mean |share found - true| of the turns of a side, weighted
    by vehicles; ``geh`` = share of movements with GEH below 2, of hourly flows.
    """
    side = _side(rows, border_m)
    true, found = (_movements(code, side) for code in (pd.factorize(rows["truth"])[0], track))
    shares = [np.divide(t, t.sum(axis=1, keepdims=True), out=np.zeros((4, 4)), where=t.any(axis=1)[:, None])
              for t in (true, found)]  # fmt: skip
    turns = np.abs(shares[1] - shares[0]).sum(axis=1) / 3
    hourly = 3600 / ((rows["frame"].max() + 1) * rows["interval_s"].iloc[0])
    moved = true + found > 0
    geh = np.sqrt(2 * hourly * (found - true)[moved] ** 2 / (found + true)[moved])
    return {
        "od_error": float(np.abs(found - true).sum() / true.sum()),
        "turn_error": float(np.average(turns, weights=true.sum(axis=1))),
        "geh": float((geh < 2).mean()),
    }


def _side(rows: pd.DataFrame, border_m: float) -> Index:
    """Return for each row 0 east, 1 west, 2 north, 3 south, or -1 = not within *border_m* of the border."""
    xy = rows[["x_m", "y_m"]].to_numpy()
    middle = xy - (xy.max(axis=0) + xy.min(axis=0)) / 2
    depth = np.abs(middle).max(axis=0) - np.abs(middle)
    across = depth.argmin(axis=1)
    side = 2 * across + (np.take_along_axis(middle, across[:, None], 1)[:, 0] < 0)
    return np.where(depth.min(axis=1) <= border_m, side, -1)


def _movements(code: Index, side: Index) -> NDArray[np.float64]:
    """Return the number of codes by the sides of their first and last sighting."""
    ends = pd.DataFrame({"code": code, "side": side})[code >= 0].groupby("code")["side"].agg(["first", "last"])
    ends = ends[(ends["first"] >= 0) & (ends["last"] >= 0)]
    counts = np.zeros((4, 4))
    np.add.at(counts, (ends["first"], ends["last"]), 1)
    # in and out on one side is a vehicle that only just looked in
    np.fill_diagonal(counts, 0)
    return counts


def mean_and_half_width(values: NDArray[np.float64] | pd.Series) -> tuple[float, float]:
    """Return the mean and the half width of its 95 % interval (NaN for less than two values)."""
    values = np.asarray(values, float)
    half = 1.96 * values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else float("nan")
    return float(values.mean()), float(half)


def available() -> bool:
    """Tell whether the data beside the project are there."""
    return Path(SUMO).is_dir()
