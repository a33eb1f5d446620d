"""On the same work the figures are those of the independent scorers beside the project, to a tenth of a point."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from evaluation_worlds import frames_table, result_of, trips, truth_of, world, write_result

from vtrack_batch.evaluation.evaluate import evaluate
from vtrack_batch.evaluation.load import load_result, load_truth
from vtrack_batch.evaluation.sides import Result

pytestmark = pytest.mark.real
TENTH_OF_A_POINT = 0.001 + 0.0005  # the scorers print three digits


@pytest.fixture(scope="module")
def checks(shared_data: Path) -> Path:
    folder = shared_data.parent / "checks"
    if not folder.is_dir():
        pytest.skip("the folder ../shared/checks (relative to the project's root) is missing")
    return folder


def faulty(rows: pd.DataFrame, size: tuple[int, int], noise_px: float) -> pd.DataFrame:
    """Sightings as a mediocre run has them: noise, misses, doubles, false alarms, wrong and lost tracks."""
    rng = np.random.default_rng(4)
    seen = rows.loc[rng.random(len(rows)) > 0.12].copy()
    seen[["col_px", "row_px"]] += rng.normal(0, noise_px, (len(seen), 2))
    seen.loc[rng.random(len(seen)) < 0.05, "track"] = None
    stray = seen.sample(frac=0.1, random_state=1)
    stray = stray.assign(
        col_px=rng.uniform(0, size[0], len(stray)),
        row_px=rng.uniform(0, size[1], len(stray)),
        vehicle=[f"stray {i}" for i in range(len(stray))],
        track=[f"v-stray {i % 40}" for i in range(len(stray))],
    )
    double = seen.sample(frac=0.03, random_state=2)
    double = double.assign(col_px=double["col_px"] + 3, vehicle="double " + double["vehicle"], track="v-double")
    swapped = (seen["frame"] > 9) & seen["track"].isin(sorted(seen["track"].dropna().unique())[::7])
    seen.loc[swapped, "track"] = seen.loc[swapped, "track"].map(lambda name: f"{name} again")
    together = pd.concat([seen, stray, double], ignore_index=True)
    return together[~(together.duplicated(["frame", "track"]) & together["track"].notna())]


def printed(script: Path, *arguments: object) -> str:
    done = subprocess.run([sys.executable, script, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert "F1" in done.stdout, done.stderr
    return done.stdout


def sized(result: Result, width: int, height: int) -> Result:
    return replace(result, frames=result.frames.assign(width_px=width, height_px=height))


def test_rendered_city(shared_data: Path, checks: Path, tmp_path: Path) -> None:
    archive = shared_data / "rendered" / "city"
    rows = pd.read_csv(archive / "truth.csv").astype({"vehicle": str})
    truth = load_truth(archive)
    parked = truth.parked[truth.parked["col_px"].between(0, 1920) & truth.parked["row_px"].between(0, 1080)]
    on_parked = parked.sample(frac=0.3, random_state=1).assign(speed_mps=0.0, track=None)
    on_parked = on_parked.assign(col_px=on_parked["col_px"] + 6, vehicle=[f"p{i}" for i in range(len(on_parked))])
    seen = faulty(pd.concat([rows.assign(track="v-" + rows["vehicle"]), on_parked]), (1920, 1080), 2.0)
    frames = frames_table(80)
    result = sized(result_of(seen, frames, trips().iloc[:0]), 1920, 1080)
    out = write_result(result, tmp_path)

    text = printed(checks / "score_rendered.py", out, archive)
    scores = evaluate(load_result(out), truth).numbers["detection"]["detections"]

    for name in ("precision", "recall", "F1"):
        assert scores[name.lower()]["value"] == pytest.approx(figure(text, rf"\b{name} ([\d.]+)"), abs=TENTH_OF_A_POINT)
        assert 0.3 < scores[name.lower()]["value"] < 0.97
    for name, words in {"moving": "moving", "standing": "standing > 20 s", "dark": "dark", "grey": "grey"}.items():
        stratum = scores["strata"][name]
        assert stratum["true"] == figure(text, rf"recall {words}: [\d.]+ of (\d+)")
        assert stratum["recall"]["value"] == pytest.approx(
            figure(text, rf"recall {words}: ([\d.]+)"), abs=TENTH_OF_A_POINT
        )
    assert scores["parked"]["recall"]["value"] == pytest.approx(
        figure(text, r"parked cars found: ([\d.]+)"), abs=TENTH_OF_A_POINT
    )
    assert scores["parked"]["true"] == figure(text, r"parked cars found: [\d.]+ of (\d+)")
    for name, words in {"median": "median", "rms": "RMS"}.items():
        error = scores[f"centroid_error_{name}_px"]["value"]
        assert error == pytest.approx(figure(text, rf"{words} ([\d.]+)"), abs=0.0101)


def test_kit_street(shared_data: Path, checks: Path, tmp_path: Path) -> None:
    folder = shared_data / "kit-ais" / "MunichStreet02"
    truth = load_truth(folder / "tracks.csv")
    rows = truth.sightings.assign(track="v-" + truth.sightings["vehicle"], frame=truth.sightings["frame"] - 1)
    seen = faulty(rows, (1284, 377), 4.0)
    tram = seen[seen["frame"] < 9].drop_duplicates("frame").assign(col_px=230.0, row_px=300.0, vehicle="t", track=None)
    tram["track"], tram["col_px"] = "v-tram", tram["col_px"] + 2 * tram["frame"]
    frames = frames_table(20, pattern="{:03d}.png", step_s=0.5)
    frames["path"] = [f"{f + 1:03d}.png" for f in range(20)]
    result = sized(result_of(pd.concat([seen, tram]), frames, trips().iloc[:0]), 1284, 377)
    out = write_result(result, tmp_path)

    text = printed(checks / "score_kit.py", out, folder / "tracks.csv", folder / "vehicles.csv", 1284, 377)
    numbers = evaluate(load_result(out), truth).numbers

    for ours, theirs in {"movers": "movers", "all_tracked": "all"}.items():
        scores = numbers["detection"][ours]
        for name in ("precision", "recall", "F1"):
            expected = figure(text, rf"(?m)^{theirs}: .*\b{name} ([\d.]+)")
            assert scores[name.lower()]["value"] == pytest.approx(expected, abs=TENTH_OF_A_POINT)
            assert 0.3 < scores[name.lower()]["value"] < 0.97
    assert numbers["links"]["could_be_made_and_were"] == figure(text, r"found: (\d+) of")
    assert numbers["links"]["could_be_made"] == figure(text, r"found: \d+ of (\d+)")
    error = numbers["detection"]["movers"]["centroid_error_median_px"]["value"]
    assert error == pytest.approx(figure(text, r"median ([\d.]+) px"), abs=0.051)


def test_truth_of_the_real_street_against_itself_is_perfect(shared_data: Path) -> None:
    truth = load_truth(shared_data / "kit-ais" / "MunichStreet02")
    rows = truth.sightings.assign(track="v-" + truth.sightings["vehicle"], frame=truth.sightings["frame"] - 1)
    frames = frames_table(20, step_s=0.5).assign(path=[f"{f + 1:03d}.png" for f in range(20)])
    numbers = evaluate(sized(result_of(rows, frames, trips().iloc[:0]), 1284, 377), truth).numbers
    assert numbers["detection"]["all_tracked"]["f1"]["value"] == 1
    assert numbers["detection"]["movers"]["precision"]["value"] == 1
    assert numbers["links"]["precision"]["value"] == numbers["links"]["recall"]["value"] == 1
    assert numbers["speeds"] is None
    assert numbers["od"] is None


def test_identity_scores(checks: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(checks))
    identity = importlib.import_module("score_tracks").identity
    rng = np.random.default_rng(2)
    rows = world()
    rows.loc[rng.random(len(rows)) < 0.03, "track"] = None
    late = (rows["frame"] > 25) & rows["vehicle"].isin(["car 02", "car 05", "car 20"])
    rows.loc[late, "track"] = rows.loc[late, "vehicle"].map({"car 02": "v-car 05", "car 05": "v-new", "car 20": "v-x"})
    numbers = evaluate(result_of(rows), truth_of(world())).numbers["tracks"]
    ordered = rows.sort_values(["frame", "vehicle"])
    expected = identity(ordered["vehicle"].to_numpy(), pd.factorize(ordered["track"])[0])
    ours = [100 * numbers[name]["value"] for name in ("idf1", "end_to_end", "first_to_last")]
    assert ours == pytest.approx(expected, abs=1e-9)
    assert expected[1] < 90


def figure(text: str, pattern: str) -> float:
    found = re.search(pattern, text)
    assert found, (pattern, text)
    return float(found[1])
