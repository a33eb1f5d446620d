"""Detections as a detector would give them: as noisy as asked, and without a trace of the truth in their order."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from simulation_scenes import scenario, table

from vtrack_batch.matching.match import match
from vtrack_batch.model.tables import TABLES
from vtrack_batch.simulation.detector import detected, missed
from vtrack_batch.simulation.params import DetectorParams
from vtrack_batch.simulation.write import simulate

QUIET = {
    "position_sigma_m": 0, "size_sigma": 0, "heading_sigma_deg": 0, "gain_sigma": 0, "common_sigma_dn": 0,
    "channel_sigma_dn": 0, "shadow_share": 0, "missed": 0, "false_per_frame": 0, "merge_m": 0,
}  # fmt: skip
TO_GROUND = np.array([[0.5, 0, 0.25], [0, -0.5, -0.25], [0, 0, 1]])


def world(frames: int, vehicles: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Cars on a grid of 20 m that stand still for *frames* frames a second apart."""
    t_utc = pd.date_range("2026-05-17T06:00Z", periods=frames, freq="1s").as_unit("us")
    ids = [f"f{k:04d}" for k in range(frames)]
    held = pd.DataFrame({"frame_id": ids, "sequence": "s", "t_utc": t_utc, "width_px": 900, "height_px": 700})
    k, v = np.divmod(np.arange(frames * vehicles), vehicles)
    truth = pd.DataFrame(
        {
            "frame_id": np.array(ids, object)[k], "sequence": "s", "t_utc": t_utc[k], "x_m": 20.0 * (v % 20) + 11,
            "y_m": -20.0 * (v // 20) - 13, "length_m": 4.6, "width_m": 1.8, "area_m2": 8.28, "heading_deg": 30.0,
            "red": 120.0, "green": 80.0, "blue": 40.0, "contrast": 60.0, "flags": 0,
            "vehicle_id": [f"t{n:03d}" for n in v],
        }
    )  # fmt: skip
    return truth, held


def seen(truth: pd.DataFrame, held: pd.DataFrame, **changes: Any) -> pd.DataFrame:
    """Detections with their vehicle, null for false alarms."""
    params = DetectorParams.model_validate(QUIET | changes)
    view = TO_GROUND, np.tile(np.eye(3), (len(held), 1, 1))
    found, key = detected(truth, held, view, params=params, rng=np.random.default_rng(4))
    assert tuple(found.columns) == TABLES["detections"].column_names
    assert found["detection_id"].is_unique
    return found.merge(key, on="detection_id")


def test_a_perfect_detector_gives_the_truth_in_another_order() -> None:
    truth, held = world(6, 90)
    rows = seen(truth, held)
    names = ["frame_id", "vehicle_id", "x_m", "y_m", "length_m", "width_m", "heading_deg", "red", "green", "blue"]
    ordered = [frame[names].sort_values(names[:2], ignore_index=True) for frame in (rows, truth)]
    pd.testing.assert_frame_equal(*ordered)
    assert np.allclose(rows["col_px"], rows["x_m"] / 0.5 - 0.5)
    assert np.allclose(rows["row_px"], -rows["y_m"] / 0.5 - 0.5)
    assert rows["vx_mps"].isna().all()
    for column in ("frame_id", "vehicle_id", "x_m"):
        order = rows[column].rank().to_numpy()
        assert abs(np.corrcoef(order, np.arange(len(order)))[0, 1]) < 0.15
        assert abs(np.corrcoef(order, rows["detection_id"].rank())[0, 1]) < 0.15


def test_noise_is_as_large_as_asked() -> None:
    truth, held = world(30, 200)
    rows = seen(truth, held, position_sigma_m=0.4, size_sigma=0.1, heading_sigma_deg=5).merge(
        truth, on=["frame_id", "vehicle_id"], suffixes=("", "_true")
    )
    for name in ("x_m", "y_m"):
        assert 0.38 < (rows[name] - rows[f"{name}_true"]).std() < 0.42
    assert 0.094 < np.log(rows["length_m"] / 4.6).std() < 0.106
    assert 4.8 < rows["heading_deg"].std() < 5.2
    colours = seen(truth, held, gain_sigma=0.04, common_sigma_dn=3, channel_sigma_dn=3)[["red", "green", "blue"]]
    expected = [np.sqrt((0.04 * level) ** 2 + 18) for level in (120, 80, 40)]
    assert np.allclose(colours.std(), expected, rtol=0.05)
    shadow = seen(truth, held, shadow_share=0.1, shadow_factor=0.5)["red"]
    assert set(shadow.round(6)) == {120.0, 60.0}
    assert 0.08 < (shadow == 60).mean() < 0.12


def test_misses_are_as_many_as_asked_and_cluster() -> None:
    truth, _ = world(200, 200)
    beside = {}
    for share in (0.0, 0.6):
        params = DetectorParams(missed=0.2, missed_clustered=share, cluster_m=40.0, cluster_s=5.0)
        gone = missed(truth, params, np.random.default_rng(1)).reshape(200, 200)
        assert 0.17 < gone.mean() < 0.23
        # missed again in the next frame, and missed together with the neighbour 20 m away
        rows = gone.reshape(200, 10, 20)
        beside[share] = (gone[1:][gone[:-1]].mean(), rows[:, :, 1:][rows[:, :, :-1]].mean())
    assert np.allclose(beside[0.0], 0.2, atol=0.02)
    assert 0.4 < beside[0.6][0] < 0.75
    assert 0.3 < beside[0.6][1] < 0.75


def test_false_alarms_are_nobody_and_lie_in_the_frame() -> None:
    truth, held = world(400, 3)
    rows = seen(truth, held, false_per_frame=2.5)
    nobody = rows[rows["vehicle_id"].isna()]
    assert 2.3 < len(nobody) / 400 < 2.7
    assert nobody["col_px"].between(-0.5, 899.5).all()
    assert nobody["row_px"].between(-0.5, 699.5).all()
    assert nobody["col_px"].max() > 850
    assert rows["vehicle_id"].notna().sum() == 1200


def test_vehicles_close_together_become_one() -> None:
    truth, held = world(2, 3)
    truth["heading_deg"] = 90.0
    truth["x_m"] = [10.0, 14.0, 30.0, 10.0, 15.1, 30.0]
    truth["y_m"] = -20.0
    truth.loc[0, "red"] = 20.0
    rows = seen(truth, held, merge_m=5.0)
    assert rows.groupby("frame_id").size().tolist() == [3, 3]
    first = rows[rows["frame_id"] == "f0000"]
    merged = first[first["vehicle_id"].isin(["t000", "t001"])]
    assert merged["detection_id"].nunique() == 1
    one = merged.iloc[0]
    assert (one["x_m"], one["y_m"], one["red"]) == pytest.approx((12.0, -20.0, 70.0))
    assert (one["length_m"], one["width_m"]) == pytest.approx((8.6, 1.8))
    assert rows[rows["frame_id"] == "f0001"]["detection_id"].nunique() == 3, "5.1 m apart stay two"


def test_nothing_in_nothing_out() -> None:
    truth, held = world(3, 2)
    assert len(seen(truth.iloc[:0], held, missed=0.2, merge_m=3.0)) == 0
    assert 0 < len(seen(truth.iloc[:0], held, false_per_frame=3.0)) < 30


@pytest.fixture(scope="module")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("detector") / "out"
    simulate(scenario(duration_s=60.0, warm_up_s=120.0), out)
    return out


def successive(out: Path) -> list[tuple[pd.DataFrame, pd.DataFrame]]:
    rows = pd.read_parquet(out / "detections.parquet")
    rows = rows.merge(table(out, "detection_keys").drop_duplicates("detection_id"), on="detection_id", how="left")
    frames = [rows[rows["t_utc"] == t].reset_index(drop=True) for t in np.sort(rows["t_utc"].unique())]
    return list(pairwise(frames))


@pytest.mark.parametrize("order", [None, "detection_id"])
def test_a_matcher_that_takes_the_first_listed_scores_no_better_than_chance(crossing: Path, order: str | None) -> None:
    right, chance, spread = 0, 0.0, 0.0
    for earlier, later in successive(crossing):
        if order:
            earlier, later = (side.sort_values(order, ignore_index=True) for side in (earlier, later))
        n = min(len(earlier), len(later))
        right += int((earlier["vehicle_id"][:n] == later["vehicle_id"][:n]).sum())
        common = len(set(earlier["vehicle_id"].dropna()) & set(later["vehicle_id"].dropna()))
        expected = common / max(len(earlier), len(later))
        chance, spread = chance + expected, spread + expected
    assert chance > 20
    assert abs(right - chance) < 4 * np.sqrt(spread)


def test_order_of_rows_changes_no_score(crossing: Path) -> None:
    earlier, later = successive(crossing)[10]
    rng = np.random.default_rng(3)
    scores = []
    for shuffle in (False, True):
        a, b = ((s.iloc[rng.permutation(len(s))] if shuffle else s).reset_index(drop=True) for s in (earlier, later))
        vehicle = pd.concat([a, b]).set_index("detection_id")["vehicle_id"]
        links = match(a, b, elapsed_s=1.5).dropna(subset=["detection_id_from", "detection_id_to"])
        right = links["detection_id_from"].map(vehicle) == links["detection_id_to"].map(vehicle)
        scores.append((len(links), int(right.sum())))
    assert scores[0] == scores[1]
    assert 0.6 * len(earlier) < scores[0][1] < len(earlier)


def test_detections_lie_beside_the_truth_and_not_in_it(crossing: Path) -> None:
    found = pd.read_parquet(crossing / "detections.parquet")
    truth, key = table(crossing, "detections"), table(crossing, "detection_keys")
    assert set(found["detection_id"]).isdisjoint(truth["detection_id"])
    assert set(found["detection_id"]) == set(key["detection_id"])
    assert "vehicle_id" not in found
    assert 0.85 * len(truth) < len(found) < 0.97 * len(truth)
