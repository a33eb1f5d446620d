"""Plots of the results: small SVG files, the same bytes for the same numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.work import SCENES, mean_and_half_width

SHOWN = {
    "default, flow map": "C0",
    "default": "C9",
    "our assignment": "C2",
    "paper's (d) proposed": "C1",
    "regions (Badenas)": "C6",
    "laptrack, colour": "C3",
    "scipy assignment, colour": "C5",
    "trackpy": "C4",
    "norfair (SORT type)": "C7",
    "nearest": "0.6",
}


def rates_by_interval(results: pd.DataFrame, path: Path) -> None:
    """Draw label rate (%) by interval with 95 % intervals, a panel for each scene; rows as in ``matching``."""
    figure = Figure(figsize=(9, 6.4), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey=True).ravel()
    for panel, scene in zip(panels, SCENES, strict=True):
        for method, colour in SHOWN.items():
            of = results[(results["scene"] == scene) & (results["method"] == method)]
            if of.empty:
                continue
            points = [(s, *mean_and_half_width(100 * rates)) for s, rates in of.groupby("elapsed_s")["pooled"]]
            x, y, half = zip(*points, strict=True)
            panel.errorbar(x, y, half, color=colour, label=method, marker="o", markersize=3, linewidth=1.2)
        panel.set_title(scene, fontsize=10)
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("label rate, %, 10 % missed")
    panels[2].set_ylabel("label rate, %, 10 % missed")
    for panel in panels[2:]:
        panel.set_xlabel("interval, s")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    save(figure, path)


def bars(table: pd.DataFrame, half: pd.DataFrame, title: str, path: Path, *, order: Sequence[str]) -> None:
    """Draw values (rows = groups, columns = methods) as points with intervals, a column of the plot for each group."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    panel = figure.subplots()
    shown = [method for method in order if method in table]
    for number, method in enumerate(shown):
        x = [group + (number / len(shown) - 0.5) * 0.8 for group in range(len(table))]
        panel.errorbar(
            x, table[method], half[method], fmt="o", markersize=4, capsize=2, label=method, color=SHOWN.get(method)
        )
    panel.set_xticks(range(len(table)), list(table.index), fontsize=8)
    panel.set_ylabel(title)
    panel.grid(alpha=0.3, axis="y")
    figure.legend(*panel.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    save(figure, path)


def paper_intervals(results: pd.DataFrame, paper: dict[float, float], path: Path) -> None:
    """Draw the paper's (d) by interval: its one pair, and ours with 95 % intervals; rows as in ``paper``."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    panel = figure.subplots()
    panel.plot(list(paper), list(paper.values()), "ks--", label="paper, one pair")
    of_d = results[(results["method"] == "proposed") & (results["rule"] == "mutual")]
    for number, ((kind, missed), of) in enumerate(of_d.groupby(["kind", "missed"])):
        points = [(s, *mean_and_half_width(100 * rates)) for s, rates in of.groupby("elapsed_s")["pooled"]]
        x, y, half = zip(*points, strict=True)
        panel.errorbar(x, y, half, color=f"C{number}", label=f"{kind}, {missed:.0%} missed", capsize=2, marker="o")
    panel.set(xlabel="interval, s", ylabel="label rate of (d), %", ylim=(0, 102))
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8)
    save(figure, path)


def save(figure: Figure, path: Path) -> None:
    """Write an SVG without date and without random ids."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context({"svg.hashsalt": path.stem, "svg.fonttype": "none"}):
        figure.savefig(path, metadata={"Date": None})
