"""Facts about choosing A, B, C: sweeps count as the methods do, choices are broad, judged on labelled pairs."""

import numpy as np
import pandas as pd
import pytest

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.calibration import (
    LabelledPair,
    chosen_setting,
    logarithmic_grid,
    method_rates,
    mutual_rates,
    sweep_rates,
)
from vtrack_batch.matching.params import MatchingParams


def pair(seed: int, *, n: int = 30, coloured: bool = True) -> LabelledPair:
    """A stream of *n* that moves 18 m along x in 1.5 s on an oblong road; a few come, go and are missed."""
    rng = np.random.default_rng(seed)
    xy = np.column_stack([np.sort(rng.uniform(0, 500, n)), rng.integers(0, 3, n) * 3.5])
    rgb = rng.uniform(30, 220, (n, 3))
    images = []
    for shift in (0.0, 18.0):
        seen = pd.DataFrame(xy + rng.normal(0, 0.3, xy.shape) + [shift, 0], columns=["x_m", "y_m"])
        seen[["red", "green", "blue"]] = rgb + rng.normal(0, 3, rgb.shape)
        seen["vehicle"] = [f"v{k}" for k in range(n)]
        seen = seen[rng.random(n) > 0.1].sample(frac=1, random_state=int(rng.integers(1000)))
        seen["detection_id"] = rng.permutation(len(seen)) + 100
        seen.loc[seen.index[:1], "vehicle"] = None  # a false alarm
        images.append(seen if coloured else seen.drop(columns=["red", "green", "blue"]))
    return LabelledPair(*images, 1.5)


PRINTED = np.array([[0.5, 1.0, 1.0]])


@pytest.mark.parametrize(("coloured", "method"), [(True, "proposed"), (False, "opposite")])
def test_a_sweep_counts_as_the_method_does(coloured: bool, method: str) -> None:
    pairs = [pair(seed, coloured=coloured) for seed in range(4)]
    swept = sweep_rates(pairs, PRINTED, MatchingParams())
    assert swept[:, 0] == pytest.approx(method_rates(pairs, [method], MatchingParams())[method].to_numpy(), abs=1e-12)
    assert 0.3 < swept.mean() < 1


def test_rates_do_not_depend_on_the_order_of_rows_or_the_names_of_sightings() -> None:
    one = pair(5)
    rng = np.random.default_rng(0)
    turned = [image.sample(frac=1, random_state=3) for image in (one.earlier, one.later)]
    turned = [image.assign(detection_id=rng.permutation(len(image))) for image in turned]
    other = LabelledPair(*turned, one.elapsed_s)
    settings = np.vstack([PRINTED, [[0.1, 4.0, 2.0]]])
    rates = [sweep_rates([p], settings, MatchingParams()) for p in (one, other)]
    assert np.array_equal(*rates)
    methods = ["default", "assignment"]
    assert method_rates([one], methods, MatchingParams()).equals(method_rates([other], methods, MatchingParams()))


def test_all_right_is_one_and_a_lone_no_match_is_right() -> None:
    alone = pd.DataFrame({"detection_id": [1], "x_m": [0.0], "y_m": [0.0], "vehicle": ["a"]})
    far = alone.assign(x_m=900.0, vehicle="b")
    assert sweep_rates([LabelledPair(alone, far, 1.0)], PRINTED, MatchingParams()).tolist() == [[1.0]]
    assert method_rates([LabelledPair(alone, far, 1.0)], ["nearest"], MatchingParams()).iloc[0, 0] == 1.0
    same = LabelledPair(alone, alone.assign(x_m=900.0), 1.0)  # out of reach, so missed from both sides
    assert sweep_rates([same], PRINTED, MatchingParams()).tolist() == [[0.0]]


def test_mutual_choice_counts_only_where_both_choose_each_other() -> None:
    # vehicles 7, 8, 6 and 6, 9, 8, 5
    true_i, true_k = np.array([-1, 2, 0]), np.array([2, -1, 1, -1])
    # row by row: all right; 8 chosen by one side only; nobody chooses anybody; two of image 1 want the same
    best_i = np.array([[-1, 2, 0], [-1, 2, 0], [-1, -1, -1], [2, 2, -1]], np.int32)
    best_k = np.array([[2, -1, 1, -1], [2, -1, -1, -1], [-1, -1, -1, -1], [-1, -1, 0, -1]], np.int32)
    right = np.array([7, 5, 1 + 2, 0 + 2])
    assert mutual_rates(best_i, best_k, true_i, true_k) == pytest.approx(right / 7)
    assert mutual_rates(best_k, best_i, true_k, true_i) == pytest.approx(right / 7)  # images swapped


def test_one_vehicle_twice_in_an_image_is_refused() -> None:
    twice = pd.DataFrame({"detection_id": [1, 2], "x_m": [0.0, 9.0], "y_m": [0.0, 0.0], "vehicle": ["a", "a"]})
    with pytest.raises(UnusableData, match="twice"):
        sweep_rates([LabelledPair(twice, twice, 1.0)], PRINTED, MatchingParams())


def test_the_nearest_to_the_default_is_chosen_among_the_equally_good() -> None:
    settings = np.array([[0.5, 1.0, 1.0], [0.5, 2.0, 1.0], [0.5, 20.0, 10.0], [1.0, 0.0, 0.0]])
    noise = np.array([0.01, -0.01, 0.02, -0.02])[:, None]
    rates = np.array([[0.60, 0.90, 0.902, 0.1]]) + noise * [0, 1, -1, 0]
    assert chosen_setting(rates, settings, settings[0]) == 1  # 0 is clearly worse, 2 better by less than its error
    assert chosen_setting(rates[:, [0, 2, 1, 3]], settings[[0, 2, 1, 3]], settings[0]) == 2
    assert chosen_setting(np.array([[0.5, 0.7, 0.8, 0.9]]), settings, settings[0]) == 3  # one pair: the best


def test_the_logarithmic_grid_reaches_from_nothing_to_far_beyond_the_paper() -> None:
    grid = logarithmic_grid()
    assert grid.shape == (7 * 15 * 15 - 1, 3)  # all together none is left out
    assert grid[:, 1].max() == pytest.approx(25.0)
    assert grid.min() == 0.0
    assert len(np.unique(grid, axis=0)) == len(grid)
