"""Print the figures of docs/realism.md: rendered frames beside the real clips of ../shared/data, by sampling distance.

python -m benchmarks.realism_figures
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.page import SHARED
from benchmarks.realism import GRADIENT_EDGES_DN, LUMINANCE_EDGES_DN, distance
from benchmarks.seeing_realism import Statistics, real, rendered

CLIPS = SHARED / "kit-ais"
REAL_GSD_M = {"MunichStreet02": 0.12, "MunichAutobahn01": 0.15, "StuttgartAutobahn01": 0.17}
# sampling distance, blur of the rendered frames
RENDERED = ((0.12, 0.5), (0.12, 0.9), (0.17, 0.5), (0.33, 0.5))
SAMPLES = ("noise_dn", "contrast_dn", "colour_contrast_dn", "edge_dn")


def main() -> None:
    """Print one table for all pictures, and one of how far vehicles lie from the real ones."""
    found: dict[str, Statistics] = {}
    for clip, own_gsd_m in REAL_GSD_M.items():
        for gsd_m in (own_gsd_m, 0.33):
            found[f"{clip}, {gsd_m} m"] = real(CLIPS / clip, own_gsd_m / gsd_m)
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


if __name__ == "__main__":
    main()
