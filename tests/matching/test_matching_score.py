"""The learned score: what its file must be, how trees are read, and what its probabilities may never do."""

import json
from importlib.resources import files

import numpy as np
import pandas as pd
import pytest

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.candidates import candidates
from vtrack_batch.matching.decision import most_right
from vtrack_batch.matching.features import BASE, HEARD, OWN
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.match import match
from vtrack_batch.matching.score import FORMAT, Model, against_none, labels_of, model_of
from vtrack_batch.matching.trees import Trees

COLOURS = ["red", "green", "blue"]
STUMP = {"column": [5, -1, -1], "threshold": [0.5, -2.0, 3.0], "left": [1, 0, 0], "right": [2, 0, 0]}


def text(**changes):
    content = {"format": FORMAT, "columns": [*BASE, *HEARD, *OWN], "rounds": [[STUMP, STUMP]]}
    return json.dumps(content | changes)


def crossroads(count=30, seed=0):
    """Streams that cross on an oblong place, 2 s apart, 10 % missed in each image."""
    rng = np.random.default_rng(seed)
    east = rng.random(count) < 0.7
    place = np.where(
        east[:, None], rng.uniform([0, -6], [320, 6], (count, 2)), rng.uniform([120, -90], [128, 90], (count, 2))
    )
    speed = np.where(east, 13, 8) + rng.normal(0, 1.0, count)
    moved = place + 2 * speed[:, None] * np.where(east[:, None], [1, 0], [0, 1])
    paint = rng.choice([[230, 230, 230], [25, 25, 25], [150, 40, 40], [120, 120, 120]], count) + rng.normal(
        0, 9, (count, 3)
    )
    images = []
    for n, xy in enumerate((place, moved)):
        seen = xy + rng.normal(0, 0.3, xy.shape)
        rgb = np.clip(paint + rng.normal(0, 3, paint.shape), 0, 255)
        columns = {"detection_id": 1000 * n + np.arange(count), "x_m": seen[:, 0], "y_m": seen[:, 1]}
        table = pd.DataFrame(columns | dict(zip(COLOURS, rgb.T, strict=True)))
        images.append(table[rng.random(count) > 0.1].reset_index(drop=True))
    return images


def links(found):
    both = found.dropna(subset=["detection_id_from", "detection_id_to"])
    return both.set_index(["detection_id_from", "detection_id_to"])["probability"].sort_index()


def test_trees_are_walked_as_written():
    trees = Model.parse(text(), "a model").rounds[0]
    x = np.zeros((3, len(BASE) + len(HEARD)))
    x[:, 5] = [0.4, 0.5, 0.6]
    np.testing.assert_allclose(trees.probability(x), 1 / (1 + np.exp(-np.array([-4.0, -4.0, 6.0]))))


def grown(rng, leaves, columns=4):
    """A tree of nodes, grown by splitting leaves at random; thresholds are few, so that rows lie on them."""
    tree = {"column": [-1], "threshold": [rng.normal()], "left": [0], "right": [0]}
    for _ in range(leaves - 1):
        node = int(rng.choice(np.flatnonzero(np.array(tree["column"]) < 0)))
        tree["column"][node], tree["threshold"][node] = int(rng.integers(columns)), float(rng.integers(-3, 4))
        tree["left"][node], tree["right"][node] = len(tree["column"]), len(tree["column"]) + 1
        for key, value in (("column", -1), ("left", 0), ("right", 0)):
            tree[key] += [value, value]
        tree["threshold"] += [float(rng.normal()), float(rng.normal())]
    return tree


def walked(tree, row):
    node = 0
    while tree["column"][node] >= 0:
        node = tree["left" if row[tree["column"][node]] <= tree["threshold"][node] else "right"][node]
    return tree["threshold"][node]


@pytest.mark.parametrize("leaves", [1, 2, 7, 32])
def test_tabled_trees_reach_the_leaves_that_walking_reaches(leaves):
    rng = np.random.default_rng(leaves)
    trees = [grown(rng, leaves) for _ in range(9)]
    x = np.vstack([rng.integers(-4, 5, (150, 4)), rng.normal(0, 3, (150, 4))]).astype(float)
    by_walking = [sum(walked(tree, row) for tree in trees) for row in x]
    np.testing.assert_allclose(Trees.of(trees, 4).probability(x), 1 / (1 + np.exp(-np.array(by_walking))), rtol=1e-12)


def test_trees_beyond_the_table_are_refused():
    with pytest.raises(ValueError, match="33 leaves"):
        Trees.of([grown(np.random.default_rng(0), 33)], 4)
    with pytest.raises(ValueError, match="column that is not there"):
        Trees.of([grown(np.random.default_rng(0), 9)], 1)


@pytest.mark.parametrize(
    "wrong",
    ["", "[]", "{}", '{"format": 1}', text(format="vtrack-batch trees 99"), text(columns=["a"]), text(rounds=[[{}]])],
)
def test_a_text_that_is_no_model_is_told(wrong):
    with pytest.raises(UnusableData, match="some file"):
        Model.parse(wrong, "some file")


def test_the_shipped_model_is_small_text_and_read_alike_twice():
    path = files("vtrack_batch.matching") / "models" / "default.json"
    content = path.read_text(encoding="utf-8")
    assert 50_000 < len(content) < 1_000_000
    first, second = (Model.parse(content, "default") for _ in range(2))
    assert len(first.rounds) == 2
    x = np.random.default_rng(1).normal(0, 5, (40, len(BASE) + len(HEARD)))
    np.testing.assert_array_equal(first.rounds[0].probability(x), second.rounds[0].probability(x))
    assert model_of(None) is model_of(None)


@pytest.mark.parametrize("seed", range(4))
def test_most_links_are_right_and_they_beat_chance(seed):
    earlier, later = crossroads(seed=seed)
    found = links(match(earlier, later, elapsed_s=2.0))
    right = sum(k - i == 1000 for i, k in found.index)
    both = len(set(earlier["detection_id"]) & set(later["detection_id"] - 1000))
    assert right >= 0.85 * both
    assert len(found) - right <= 0.15 * both
    assert found.between(0, 1).all()


@pytest.mark.parametrize("coloured", [True, False])
def test_swapping_the_images_swaps_links_and_keeps_probabilities(coloured):
    earlier, later = (t if coloured else t.drop(columns=COLOURS) for t in crossroads(seed=5))
    forward, backward = links(match(earlier, later, elapsed_s=2.0)), links(match(later, earlier, elapsed_s=2.0))
    swapped = backward.swaplevel().sort_index()
    assert list(forward.index) == list(swapped.index)
    assert len(forward) > 10
    np.testing.assert_allclose(forward.to_numpy(), swapped.to_numpy(), atol=1e-6)


def test_a_vehicle_in_another_colour_is_believed_less():
    earlier, later = crossroads(seed=2)
    found = links(match(earlier, later, elapsed_s=2.0))
    i, k = found[found > 0.9].index[0]
    later.loc[later["detection_id"] == k, COLOURS] = [20, 200, 30]
    repainted = links(match(earlier, later, elapsed_s=2.0))
    assert repainted.get((i, k), 0.0) < found[i, k]


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 3), (3, 0), (1, 1)])
def test_few_vehicles_or_none(n, m):
    earlier, later = crossroads(seed=1)
    found = match(earlier.head(n), later.head(m), elapsed_s=2.0)
    assert found["detection_id_from"].notna().sum() == n
    assert found["detection_id_to"].notna().sum() == m
    assert found["probability"].between(0, 1).all()


def test_an_empty_map_is_as_good_as_none():
    earlier, later = crossroads(seed=3)
    nothing = FlowMap(np.zeros((0, 2)), np.zeros((0, 2)))
    pd.testing.assert_frame_equal(
        match(earlier, later, elapsed_s=2.0), match(earlier, later, elapsed_s=2.0, flow_map=nothing)
    )


def test_a_link_is_kept_where_more_labels_come_right_by_it():
    edges = candidates(np.zeros((2, 2)), np.ones((1, 2)), 2.0)
    assert most_right(edges, labels_of(edges, np.array([0.45, 0.3]))).tolist() == [True, False]
    assert most_right(edges, labels_of(edges, np.array([0.3, 0.05]))).tolist() == [False, False]


def test_odds_against_no_match_leave_rivals_aside():
    edges = candidates(np.zeros((2, 2)), np.ones((1, 2)), 2.0)
    shared = against_none(edges, np.array([0.45, 0.45]))
    np.testing.assert_allclose(shared, np.log(0.45) - 0.5 * np.log(0.55 * 0.1))
