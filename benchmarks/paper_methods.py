"""The paper's methods (a)-(d) on labelled pairs, counted as the paper counts."""

from __future__ import annotations

import numpy as np
import pandas as pd

import vtrack_batch as vt
from benchmarks.noise import COLOURS
from benchmarks.work import label_rates, mean_and_half_width
from vtrack_batch.matching.params import MatchingParams

METHODS = {"original": "(a) original", "colour": "(b) colour", "opposite": "(c) opposite", "proposed": "(d) proposed"}
ONE_WAY = ("original", "colour")
# one-way methods leave the labels of image 2 as they began, so that mutual choice would mean nothing
WAYS = [(method, "argmax") for method in METHODS] + [(method, "mutual") for method in METHODS if method not in ONE_WAY]
MISSED = (0.0, 0.1)
PIXEL_M, D_PX, T_PX, PAPER_S = 0.33, 150, 20, 1.5


def rates(rows: pd.DataFrame, method: str, rule: str, *, fixed: bool = False) -> pd.DataFrame:
    """Return label rates of one method, pair by pair; *fixed* = D and T in pixels whatever the interval."""
    found = []
    columns = ["detection_id", "x_m", "y_m", *(COLOURS if "red" in rows else [])]
    for name, pair in rows.groupby("sequence"):
        images = [of.assign(detection_id=np.arange(len(of))) for _, of in pair.groupby("frame")]
        elapsed_s = float(pair["interval_s"].iloc[0])
        params = MatchingParams.model_validate({"decision": rule, **(_fixed(elapsed_s) if fixed else {})})
        links = vt.match(*(i[columns] for i in images), elapsed_s=elapsed_s, method=method, params=params)
        links = links.dropna(subset=["detection_id_from", "detection_id_to"])
        i, k = (links[f"detection_id_{end}"].astype(int).to_numpy() for end in ("from", "to"))
        one, two, both = label_rates(*(image["truth"].to_numpy() for image in images), i, k)
        found.append({"pair": name, "n": len(pair), "image_1": one, "image_2": two, "pooled": both})
    return pd.DataFrame(found).assign(method=method, rule=rule)


def _fixed(elapsed_s: float) -> dict[str, object]:
    speed = PIXEL_M / elapsed_s
    return {"paper": {"max_speed_mps": D_PX * speed, "consistency_mps": T_PX * speed}}


def rule_of(method: str) -> str:
    """Return the decision rule that reads the paper best: mutual choice where there are labels from both images."""
    return "argmax" if method in ONE_WAY else "mutual" if method in METHODS else "method"


def as_paper(rows: pd.DataFrame, method: str) -> pd.Series:
    """Return rates in % as the paper counts them: one-way methods over image 1, others over both."""
    of = rows[(rows["method"] == method) & (rows["rule"] == rule_of(method))]
    return 100 * of["image_1" if method in ONE_WAY else "pooled"]


def text(rates_percent: pd.Series | np.ndarray) -> str:
    """Return mean and half width of its 95 % interval over pairs."""
    if not len(rates_percent):
        return "–"
    mean, half = mean_and_half_width(rates_percent)
    return f"{mean:.1f}±{half:.1f}"
