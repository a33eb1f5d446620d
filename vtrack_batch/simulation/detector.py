"""What a detector would have seen: the truth with noise, shadow, clustered misses, merges and false alarms, shuffled.

Colours: a gain of 4 %, 3 levels in common and 3 per channel, 2 % of the sightings in shadow (x 0.65) by default.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from vtrack_batch.model.homography import Array, apply
from vtrack_batch.model.tables import TABLES
from vtrack_batch.simulation.fleet import draw_looks, random_ids
from vtrack_batch.simulation.params import DetectorParams

_RGB = ["red", "green", "blue"]
_APART_M = 1e7
"""Distance that keeps frames apart where places of all frames lie in one plane."""


def detected(
    truth: pd.DataFrame,
    frames: pd.DataFrame,
    view: tuple[Array, Array],
    *,
    params: DetectorParams,
    rng: np.random.Generator,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return detections and their key, both in random order.

    *truth* holds the columns of ``detections`` and ``vehicle_id``, *frames* those of ``frames``. *view* is what takes
    pixels of the reference frame to the ground (3, 3), and to each frame (frames, 3, 3).
    The key has a row per detection and vehicle in it: none for a false alarm (``vehicle_id`` null), several for a
    merged one. Ids carry no order and no truth.
    """
    frame = frames.reset_index(drop=True).reset_index().set_index("frame_id")["index"]
    seen = truth.assign(frame=truth["frame_id"].map(frame).astype("int64"))
    seen = seen[~missed(seen, params, rng)].reset_index(drop=True)
    group = _merged(seen, params.merge_m)
    found = _measured(_joined(seen, group), params, rng)
    false = _false_alarms(frames, view[0], params, rng)
    rows = pd.concat([part for part in (found, false) if len(part)] or [found], ignore_index=True)
    rows = _placed(rows, frames, view)
    ids = random_ids(len(rows), rng, form="{:016x}", least=0, below=2**62)
    rows = rows.assign(detection_id=ids)
    names = ["detection_id", *TABLES["detections"].column_names[1:]]
    key = pd.DataFrame({"detection_id": ids[group], "vehicle_id": seen["vehicle_id"].to_numpy(object)})
    nobody = pd.DataFrame({"detection_id": ids[len(found) :], "vehicle_id": None}, dtype=object)
    key = pd.concat([key, nobody], ignore_index=True) if len(nobody) else key
    shuffled = rows.iloc[rng.permutation(len(rows))]
    return shuffled[names].reset_index(drop=True), key.iloc[rng.permutation(len(key))].reset_index(drop=True)


def missed(seen: pd.DataFrame, params: DetectorParams, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which sightings (frame, t_utc, x_m, y_m) are missed.

    A share of the misses falls on whole cells of the ground for a while, as below a tree or in a dark place; the rest
    is independent.
    """
    clustered = params.missed * params.missed_clustered
    alone = (params.missed - clustered) / (1 - clustered)
    t_s = (seen["t_utc"] - seen["t_utc"].min()).dt.total_seconds()
    shift = rng.uniform(0, 1, 3)
    cells = np.stack([seen["x_m"] / params.cluster_m, seen["y_m"] / params.cluster_m, t_s / params.cluster_s], axis=1)
    _, cell = np.unique(np.floor(cells.astype(float) + shift), axis=0, return_inverse=True)
    dark = rng.random(int(cell.max(initial=-1)) + 1) < clustered
    return np.asarray(dark[cell.reshape(-1)] | (rng.random(len(seen)) < alone))


def _merged(seen: pd.DataFrame, merge_m: float) -> NDArray[np.int64]:
    """Return the number of the detection that each sighting becomes part of, in order of the sightings."""
    n = len(seen)
    xy = seen[["x_m", "y_m"]].to_numpy(float)
    apart = np.column_stack([xy, seen["frame"].to_numpy(float) * _APART_M])
    pairs = cKDTree(apart).query_pairs(merge_m, output_type="ndarray") if n and merge_m else np.zeros((0, 2), int)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1] if n else np.zeros(0), np.int64)


def _joined(seen: pd.DataFrame, group: NDArray[np.int64]) -> pd.DataFrame:
    """Return one row per group: its largest member, grown to hold all of them, at their common centre."""
    many = np.bincount(group, minlength=group.max(initial=-1) + 1)
    area = seen["area_m2"].to_numpy(float)
    weight = area / np.bincount(group, area)[group] if len(seen) else area
    mean = {name: np.bincount(group, weight * seen[name].to_numpy(float)) for name in ("x_m", "y_m", "contrast", *_RGB)}
    largest = np.lexsort((-area, group))
    first = largest[np.searchsorted(group[largest], np.arange(len(many)))]
    rows = seen.iloc[first].reset_index(drop=True)
    heading = np.deg2rad(rows["heading_deg"].to_numpy(float))[group]
    shift = seen[["x_m", "y_m"]].to_numpy(float) - np.stack([mean["x_m"], mean["y_m"]], axis=1)[group]
    along = np.abs(shift[:, 0] * np.sin(heading) + shift[:, 1] * np.cos(heading)) + seen["length_m"].to_numpy() / 2
    across = np.abs(shift[:, 0] * np.cos(heading) - shift[:, 1] * np.sin(heading)) + seen["width_m"].to_numpy() / 2
    sizes = [np.zeros(len(many)), np.zeros(len(many))]
    for size, reach in zip(sizes, (along, across), strict=True):
        np.maximum.at(size, group, 2 * reach)
    return rows.assign(**mean, length_m=sizes[0], width_m=sizes[1])


def _measured(rows: pd.DataFrame, params: DetectorParams, rng: np.random.Generator) -> pd.DataFrame:
    """Return the rows with the noise of place, size, heading and colour."""
    n = len(rows)
    gain = 1 + params.gain_sigma * rng.standard_normal((n, 1))
    shadow = np.where(rng.random((n, 1)) < params.shadow_share, params.shadow_factor, 1.0)
    noise = params.common_sigma_dn * rng.standard_normal((n, 1))
    noise = noise + params.channel_sigma_dn * rng.standard_normal((n, 3))
    rgb = np.clip(rows[_RGB].to_numpy(float) * gain * shadow + noise, 0, 255)
    place = params.position_sigma_m * rng.standard_normal((n, 2))
    length_m, width_m = (
        rows[name] * np.exp(params.size_sigma * rng.standard_normal(n)) for name in ("length_m", "width_m")
    )
    turned = rows["heading_deg"] + params.heading_sigma_deg * rng.standard_normal(n)
    return rows.assign(
        **{name: rgb[:, k] for k, name in enumerate(_RGB)},
        x_m=rows["x_m"] + place[:, 0],
        y_m=rows["y_m"] + place[:, 1],
        length_m=length_m,
        width_m=width_m,
        area_m2=length_m * width_m,
        heading_deg=np.mod(turned, 180.0),
    )


def _false_alarms(
    frames: pd.DataFrame, to_ground: Array, params: DetectorParams, rng: np.random.Generator
) -> pd.DataFrame:
    """Return false alarms anywhere in the frames, as large and as coloured as vehicles."""
    frame = np.repeat(np.arange(len(frames)), rng.poisson(params.false_per_frame, len(frames)))
    n = len(frame)
    looks = draw_looks(n, None, rng=rng)
    size = frames[["width_px", "height_px"]].to_numpy(float)[frame]
    xy = apply(to_ground, rng.uniform(0, 1, (n, 2)) * size - 0.5)
    return pd.DataFrame(
        {
            "frame": frame,
            **{name: frames[name].to_numpy()[frame] for name in ("frame_id", "sequence")},
            "t_utc": pd.DatetimeIndex(frames["t_utc"])[frame],
            "x_m": xy[:, 0],
            "y_m": xy[:, 1],
            "length_m": looks.length_m,
            "width_m": looks.width_m,
            "area_m2": looks.length_m * looks.width_m,
            "heading_deg": rng.uniform(0, 180, n),
            **{name: looks.paint_rgb[:, k] for k, name in enumerate(_RGB)},
            "contrast": rng.uniform(15, 80, n),
            "flags": np.int32(0),
        }
    )


def _placed(rows: pd.DataFrame, frames: pd.DataFrame, view: tuple[Array, Array]) -> pd.DataFrame:
    """Return the rows with their pixels; motion is not measured."""
    to_reference = np.linalg.inv(view[0])
    xy = rows[["x_m", "y_m"]].to_numpy(float)
    px = np.zeros((len(rows), 2))
    for k in range(len(frames)):
        at = (rows["frame"] == k).to_numpy()
        px[at] = apply(view[1][k] @ to_reference, xy[at])
    return rows.assign(col_px=px[:, 0], row_px=px[:, 1], vx_mps=np.nan, vy_mps=np.nan, source="both")
