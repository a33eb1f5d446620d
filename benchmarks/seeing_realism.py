"""Rendered frames beside real ones of the same ground sampling distance; the plot holds curves, never imagery."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray

from benchmarks.realism import GRADIENT_EDGES_DN, distance, frame_statistics, share_distance
from benchmarks.seeing_registration import read
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.view_params import CameraParams
from vtrack_batch.simulation.write import simulate

FRAMES, SIZE_PX, SEED = 4, (1280, 800), 8201
BOX = ["left", "top", "width", "height"]

Statistics = dict[str, NDArray[np.float64]]
LABELS = {
    "gradient_share": "gradient",
    "spectrum_power": "detail",
    "noise_dn": "noise",
    "contrast_dn": "vehicle contrast, luminance",
    "colour_contrast_dn": "vehicle contrast, colour",
    "edge_dn": "vehicle edges",
}


def real(clip: Path, shrink: float) -> Statistics:
    """Return the statistics of some frames of a KIT clip, reduced by *shrink*; of vehicles where the clip has boxes."""
    paths, tracks = sorted((clip / "frames").iterdir()), clip / "tracks.csv"
    boxes = pd.read_csv(tracks) if tracks.is_file() else pd.DataFrame(columns=["frame", *BOX])
    parts = []
    for n in np.linspace(0, len(paths) - 1, FRAMES).round().astype(int):
        pixels = read(paths[n])
        if shrink != 1:
            pixels = np.asarray(cv2.resize(pixels, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA))
        of_frame = boxes.loc[boxes["frame"] == int(paths[n].stem), BOX].to_numpy(float)
        parts.append(frame_statistics(np.ascontiguousarray(pixels), of_frame * shrink))
    return pooled(parts)


def rendered(folder: Path, gsd_m: float, blur_px: float = CameraParams().blur_px) -> Statistics:
    """Return the statistics of some frames that the renderer makes of the built-in crossing."""
    camera = CameraParams(gsd_m=gsd_m, blur_px=blur_px, width_px=SIZE_PX[0], height_px=SIZE_PX[1])
    simulate(Scenario(seed=SEED, duration_s=20.0 * FRAMES, interval_s=20, camera=camera), folder)
    seen = pd.read_parquet(folder / "truth" / "detections.parquet")
    parts = []
    for path, (_, true) in zip(sorted((folder / "frames").rglob("*.jpg")), seen.groupby("t_utc"), strict=True):
        angle = np.radians(true["heading_deg"].to_numpy(float))
        length, width = (true[name].to_numpy(float) / gsd_m for name in ("length_m", "width_m"))
        wide = length * np.abs(np.sin(angle)) + width * np.abs(np.cos(angle))
        high = length * np.abs(np.cos(angle)) + width * np.abs(np.sin(angle))
        boxes = np.stack([true["col_px"] - wide / 2 + 0.5, true["row_px"] - high / 2 + 0.5, wide, high], axis=1)
        parts.append(frame_statistics(read(path), boxes))
    return pooled(parts)


def pooled(parts: list[Statistics]) -> Statistics:
    """Average curves, and put samples together."""
    return {
        name: (np.mean if name.endswith(("_share", "_power", "_cpp")) else np.concatenate)(
            [part[name] for part in parts], axis=0
        )
        for name in parts[0]
    }


def differences(here: Statistics, there: Statistics) -> dict[str, float]:
    """Return how far rendered and real lie apart in each measure: 0 = alike, 1 = nothing in common."""
    found = {}
    for name in LABELS:
        if name == "spectrum_power":
            shares = [part[name] / part[name].sum() for part in (here, there)]
            found[name] = share_distance(*shares)
        elif name.endswith("_share"):
            found[name] = share_distance(here[name], there[name])
        else:
            found[name] = distance(here[name][np.isfinite(here[name])], there[name][np.isfinite(there[name])])
    return found


def draw(pairs: dict[float, tuple[Statistics, Statistics]], path: Path) -> None:
    """Draw curves of rendered (dashed) and real frames (solid), a row for each ground sampling distance."""
    figure = Figure(figsize=(13, 3.1 * len(pairs)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(pairs), 4, squeeze=False)
    middle = (GRADIENT_EDGES_DN[1:] + GRADIENT_EDGES_DN[:-1]) / 2
    for row, (gsd_m, both) in zip(axes, pairs.items(), strict=True):
        for part, style, label in zip(both, ("--", "-"), ("rendered", "real"), strict=True):
            row[0].loglog(middle, part["gradient_share"] + 1e-6, style, label=label)
            row[1].loglog(part["spectrum_cpp"], part["spectrum_power"], style, label=label)
            for axis, name in ((row[2], "noise_dn"), (row[3], "contrast_dn")):
                values = np.sort(part[name][np.isfinite(part[name])])
                axis.plot(values, np.linspace(0, 1, len(values)), style, label=label)
        row[2].set_xlim(0, 8)
        titles = ("gradient, grey values per px", "power at cycles per px", "noise, grey values", "vehicle contrast")
        for axis, title in zip(row, titles, strict=True):
            axis.set_title(f"{title} ({gsd_m:g} m)", fontsize=9)
            axis.tick_params(labelsize=7)
            axis.xaxis.set_minor_formatter(NullFormatter())
    axes[0][0].legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None}, format="svg")
