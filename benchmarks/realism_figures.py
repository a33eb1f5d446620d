"""Print the figures of docs/realism.md: rendered frames beside the real clips of ../shared/data, by sampling distance.

python -m benchmarks.realism_figures
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import simplejpeg
from numpy.typing import NDArray

from benchmarks.realism import GRADIENT_EDGES_DN, LUMINANCE_EDGES_DN, distance, frame_statistics
from vtrack_batch.simulation.params import Scenario
from vtrack_batch.simulation.view_params import CameraParams
from vtrack_batch.simulation.write import simulate

CLIPS = Path(__file__).resolve().parents[2] / "shared" / "data" / "kit-ais"
REAL_GSD_M = {"MunichStreet02": 0.12, "MunichAutobahn01": 0.15, "StuttgartAutobahn01": 0.17}
# sampling distance, blur of the rendered frames
RENDERED = ((0.12, 0.5), (0.12, 0.9), (0.17, 0.5), (0.33, 0.5))
SIZE_PX = (1280, 800)
FRAMES, SEED = 4, 8201
SAMPLES = ("noise_dn", "contrast_dn", "colour_contrast_dn", "edge_dn")

Statistics = dict[str, NDArray[np.float64]]


def main() -> None:
    """Print one table for all pictures, and one of how far vehicles lie from the real ones."""
    found: dict[str, Statistics] = {}
    for clip, own_gsd_m in REAL_GSD_M.items():
        for gsd_m in (own_gsd_m, 0.33):
            found[f"{clip}, {gsd_m} m"] = real(clip, own_gsd_m / gsd_m)
    with tempfile.TemporaryDirectory() as folder:
        for k, (gsd_m, blur_px) in enumerate(RENDERED):
            found[f"rendered, {gsd_m} m, blur {blur_px} px"] = rendered(Path(folder) / str(k), gsd_m, blur_px)
    print("| | gradient median, 90 % | luminance 2, 50, 98 % | saturation | power at 0.17, 0.33, 0.48 cpp | noise |")
    print("|---|---|---|---|---|---|")
    for name, part in found.items():
        print(f"| {name} | {' | '.join(row(part))} |")
    print("\n| vehicles | contrast 10, 25, 50, 75, 90 % | colour contrast 10, 50, 90 % | edges 10, 50, 90 % |")
    print("|---|---|---|---|")
    for name, part in found.items():
        if len(part["contrast_dn"]):
            print(f"| {name} | {' | '.join(vehicles(part))} |")
    for gsd_m, blur_px in RENDERED:
        name, other = f"rendered, {gsd_m} m, blur {blur_px} px", f"MunichStreet02, {gsd_m} m"
        if other in found:
            apart = [f"{key} {distance(whole(found[name][key]), whole(found[other][key])):.2f}" for key in SAMPLES]
            print(f"\nGreatest difference of the distributions, {name} against {other}: {', '.join(apart)}")


def row(part: Statistics) -> list[str]:
    """Return the cells of one picture."""
    gradient, luminance = GRADIENT_EDGES_DN[1:], LUMINANCE_EDGES_DN[1:]
    power = [np.log10(np.interp(f, part["spectrum_cpp"], part["spectrum_power"])) for f in (0.17, 0.33, 0.48)]
    return [
        ", ".join(f"{quantile(part['gradient_share'], gradient, q):.1f}" for q in (0.5, 0.9)),
        ", ".join(f"{quantile(part['luminance_share'], luminance, q):.0f}" for q in (0.02, 0.5, 0.98)),
        f"{quantile(part['saturation_share'], np.arange(1, 21) / 20, 0.5):.2f}",
        ", ".join(f"10^{p:.1f}" for p in power),
        f"{np.median(part['noise_dn']):.2f}",
    ]


def vehicles(part: Statistics) -> list[str]:
    """Return the cells of one picture's vehicles."""
    shares = ((0.1, 0.25, 0.5, 0.75, 0.9), (0.1, 0.5, 0.9), (0.1, 0.5, 0.9))
    keys = ("contrast_dn", "colour_contrast_dn", "edge_dn")
    return [", ".join(f"{v:.0f}" for v in np.quantile(whole(part[k]), q)) for k, q in zip(keys, shares, strict=True)]


def quantile(share: NDArray[np.float64], upper: NDArray[np.float64], q: float) -> float:
    """Return the value below which the share *q* of a histogram lies, linear within its bin."""
    return float(np.interp(q, np.concatenate([[0.0], np.cumsum(share)]), np.concatenate([[0.0], upper])))


def whole(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values that are known."""
    return values[np.isfinite(values)]


def real(clip: str, scale: float) -> Statistics:
    """Return the statistics of some frames of a real clip, shrunk by *scale*; boxes where the clip has them."""
    paths = sorted((CLIPS / clip / "frames").iterdir())
    tracks = CLIPS / clip / "tracks.csv"
    truth = (
        pd.read_csv(tracks) if tracks.is_file() else pd.DataFrame(columns=["frame", "left", "top", "width", "height"])
    )
    parts = []
    for k in np.linspace(0, len(paths) - 1, FRAMES).round().astype(int):
        pixels = np.asarray(cv2.imread(str(paths[k])), np.uint8)[..., ::-1]
        if scale < 1:
            pixels = np.asarray(cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
        boxes = truth.loc[truth["frame"] == int(paths[k].stem), ["left", "top", "width", "height"]].to_numpy(float)
        parts.append(frame_statistics(np.ascontiguousarray(pixels), boxes * scale))
    return pooled(parts)


def rendered(folder: Path, gsd_m: float, blur_px: float) -> Statistics:
    """Return the statistics of some frames of the built-in crossing."""
    camera = CameraParams(gsd_m=gsd_m, blur_px=blur_px, width_px=SIZE_PX[0], height_px=SIZE_PX[1])
    simulate(Scenario(seed=SEED, duration_s=20.0 * FRAMES, interval_s=20.0, camera=camera), folder)
    seen = pd.read_parquet(folder / "truth" / "detections.parquet")
    parts = []
    for path, (_, rows) in zip(sorted((folder / "frames").iterdir()), seen.groupby("t_utc"), strict=True):
        angle = np.radians(rows["heading_deg"].to_numpy(float))
        length, width = (rows[name].to_numpy(float) / gsd_m for name in ("length_m", "width_m"))
        wide = length * np.abs(np.sin(angle)) + width * np.abs(np.cos(angle))
        high = length * np.abs(np.cos(angle)) + width * np.abs(np.sin(angle))
        boxes = np.stack([rows["col_px"] - wide / 2 + 0.5, rows["row_px"] - high / 2 + 0.5, wide, high], axis=1)
        parts.append(frame_statistics(simplejpeg.decode_jpeg(path.read_bytes()), boxes))
    return pooled(parts)


def pooled(parts: list[Statistics]) -> Statistics:
    """Average curves, and put samples together."""
    return {
        name: np.concatenate([p[name] for p in parts]) if name in SAMPLES else np.mean([p[name] for p in parts], axis=0)
        for name in parts[0]
    }


if __name__ == "__main__":
    main()
