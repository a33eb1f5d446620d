"""On pinned traffic the figures are those of the independent scorers: label rates, IDF1, end to end."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

import vtrack_batch as vt
from vtrack_batch.evaluation.evaluate import evaluate
from vtrack_batch.evaluation.load import load_result, load_truth

pytestmark = pytest.mark.real


@pytest.fixture(scope="module")
def scorers(shared_data: Path) -> tuple[ModuleType, ModuleType]:
    folder = shared_data.parent / "checks"
    if not folder.is_dir():
        pytest.skip("the folder ../shared/checks (relative to the project's root) is missing")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        return importlib.import_module("score_pairs"), importlib.import_module("score_tracks")


@pytest.mark.parametrize("method", ["default", "proposed", "original", "nearest"])
@pytest.mark.parametrize("scene", ["road", "crossing"])
def test_label_rates_of_pairs(
    shared_data: Path, scorers: tuple[ModuleType, ModuleType], tmp_path: Path, scene: str, method: str
) -> None:
    pairs = pd.read_parquet(shared_data / "sumo" / "pairs.parquet")
    cell = pairs[(pairs["scene"] == scene) & np.isclose(pairs["elapsed_s"], 1.5) & (pairs["missed"] > 0)]
    rates, ours, earlier_rates = [], [], []
    for number in cell["pair"].unique()[:5]:
        rows = cell[cell["pair"] == number]
        earlier, later = (rows[rows["image"] == i].reset_index(drop=True) for i in (1, 2))
        seen = scorers[0].SEEN
        matches = vt.match(earlier[seen], later[seen], elapsed_s=1.5, method=method)
        # where one-way methods let several claim one, the scorer takes the last row for its partner: here the likeliest
        ordered = matches.assign(name=matches["detection_id_from"].astype(str)).sort_values("name", ascending=False)
        ordered = ordered.sort_values("probability", kind="stable").drop(columns="name")
        rates.append(scorers[0].label_rate(earlier, later, ordered))
        out = tmp_path / f"{number}"
        out.mkdir()
        matches.to_parquet(out / "matches.parquet", index=False)
        rows.to_parquet(out / "labelled.parquet", index=False)
        numbers = evaluate(load_result(out), load_truth(out / "labelled.parquet")).numbers
        ours.append(numbers["matches"]["label_rate"]["value"])
        earlier_rates.append(numbers["matches"]["label_rate_earlier"]["value"])
        assert numbers["tracks"] is numbers["links"] is numbers["detection"] is None
    assert ours == pytest.approx(rates, abs=1e-12)
    assert 0.01 < np.mean(ours) < 1
    assert ours == pytest.approx(earlier_rates, abs=0.2)


@pytest.mark.parametrize(("method", "depends"), [("original", True), ("proposed", False)])
def test_where_several_claim_one_the_scorer_depends_on_the_order_of_rows(
    shared_data: Path, scorers: tuple[ModuleType, ModuleType], method: str, depends: bool
) -> None:
    """Why one-way methods can differ from the scorer: told in docs/measures.md."""
    pairs = pd.read_parquet(shared_data / "sumo" / "pairs.parquet")
    cell = pairs[(pairs["scene"] == "road") & np.isclose(pairs["elapsed_s"], 1.5) & (pairs["missed"] > 0)]
    apart = []
    for number in cell["pair"].unique()[:10]:
        earlier, later = (cell[(cell["pair"] == number) & (cell["image"] == i)].reset_index(drop=True) for i in (1, 2))
        matches = vt.match(earlier[scorers[0].SEEN], later[scorers[0].SEEN], elapsed_s=1.5, method=method)
        several = matches["detection_id_to"].dropna().duplicated().any()
        there, back = (scorers[0].label_rate(earlier, later, rows) for rows in (matches, matches[::-1]))
        assert several or there == back
        apart.append(there != back)
    assert any(apart) == depends


@pytest.mark.parametrize(("scene", "interval_s", "missed"), [("road", 1.5, 0.1), ("crossing", 2.5, 0.2)])
def test_identity_of_tracked_sequences(
    shared_data: Path,
    scorers: tuple[ModuleType, ModuleType],
    tmp_path: Path,
    scene: str,
    interval_s: float,
    missed: float,
) -> None:
    rows = pd.read_parquet(shared_data / "sumo" / f"sequences_{scene}.parquet")
    cell = np.isclose(rows["interval_s"], interval_s) & np.isclose(rows["missed"], missed)
    rows = rows[cell & (rows["seed"] == rows["seed"].min()) & (rows["t_s"] < 120)]
    rows = rows.sort_values("t_s", kind="stable").reset_index(drop=True)
    rows["detection_id"] = np.random.default_rng(11).permutation(len(rows))
    rows["t_utc"] = scorers[0].START + pd.to_timedelta(rows["t_s"].astype(float), unit="s")
    shuffled = rows.sample(frac=1, random_state=7).reset_index(drop=True)
    tracks = vt.track(shuffled[[*scorers[0].SEEN, "t_utc"]])
    points = tracks.track_points.dropna(subset=["detection_id"])
    code = pd.Series(pd.factorize(points["vehicle_id"])[0], index=points["detection_id"].astype(int))
    track = code.reindex(rows["detection_id"]).fillna(-1).astype(int).to_numpy()
    expected = scorers[1].identity(rows["truth_vehicle"].to_numpy(), track)
    tracks.track_points.to_parquet(tmp_path / "track_points.parquet", index=False)
    tracks.matches.to_parquet(tmp_path / "matches.parquet", index=False)
    shuffled.drop(columns="t_s").to_parquet(tmp_path / "labelled.parquet", index=False)
    numbers = evaluate(load_result(tmp_path), load_truth(tmp_path / "labelled.parquet")).numbers
    ours = [100 * numbers["tracks"][name]["value"] for name in ("idf1", "end_to_end", "first_to_last")]
    assert ours == pytest.approx(expected, abs=1e-9)
    assert 50 < min(expected) < 100
    assert numbers["matches"]["label_rate"]["value"] > 0.9
    assert numbers["matches"]["calibration_of_links"]["ece"]["value"] < 0.1


def test_matching_by_place_in_the_list_is_no_better_than_chance(shared_data: Path, tmp_path: Path) -> None:
    pairs = pd.read_parquet(shared_data / "sumo" / "pairs.parquet")
    cell = pairs[(pairs["scene"] == "grid") & np.isclose(pairs["elapsed_s"], 0.5) & (pairs["missed"] == 0)]
    rates = []
    for number in cell["pair"].unique()[:4]:
        rows = cell[cell["pair"] == number]
        earlier, later = (rows.loc[rows["image"] == i, "detection_id"].to_numpy() for i in (1, 2))
        count = min(len(earlier), len(later))
        listed = pd.DataFrame({"detection_id_from": earlier[:count], "detection_id_to": later[:count]})
        out = tmp_path / f"{number}"
        out.mkdir()
        listed.assign(probability=1.0).to_parquet(out / "matches.parquet", index=False)
        rows.to_parquet(out / "labelled.parquet", index=False)
        numbers = evaluate(load_result(out), load_truth(out / "labelled.parquet")).numbers
        rates.append(numbers["matches"]["label_rate"]["value"])
    assert np.mean(rates) < 0.02  # of about 300 vehicles: chance is 1 in 300
