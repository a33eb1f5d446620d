"""Matching two images finds who moved where, whatever the order of rows, and says plainly what it cannot use."""

import numpy as np
import pandas as pd
import pytest

from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.matching.flow import FlowMap
from vtrack_batch.matching.match import match

METHODS = ["default", "untrained", "original", "colour", "opposite", "proposed", "regions", "assignment", "nearest"]


def street(count=24, seed=0):
    """Two opposite streams on an oblong street, 12 m/s eastward and 9 m/s westward, 1.5 s apart."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(9, 28, count))
    east = np.arange(count) % 2 == 0
    y = np.where(east, -4.0, 4.0)
    rgb = rng.uniform(20, 235, (count, 3))
    moved = np.where(east, 18.0, -13.5) + rng.normal(0, 0.6, count)

    def image(dx):
        noise = rng.normal(0, 0.3, (count, 2))
        colours = np.clip(rgb + rng.normal(0, 3, rgb.shape), 0, 255)
        columns = {"x_m": x + dx + noise[:, 0], "y_m": y + noise[:, 1]}
        return pd.DataFrame(columns | dict(zip(["red", "green", "blue"], colours.T, strict=True)))

    earlier, later = image(0), image(moved)
    return earlier.assign(detection_id=np.arange(count)), later.assign(detection_id=1000 + np.arange(count))


def links(found):
    both = found.dropna(subset=["detection_id_from", "detection_id_to"])
    return dict(zip(both["detection_id_from"], both["detection_id_to"], strict=True))


def test_two_streams_are_told_apart():
    earlier, later = street()
    assert links(match(earlier, later, elapsed_s=1.5)) == {i: 1000 + i for i in range(24)}


def test_two_streams_without_colour():
    earlier, later = (table.drop(columns=["red", "green", "blue"]) for table in street())
    right = sum(k == 1000 + i for i, k in links(match(earlier, later, elapsed_s=1.5)).items())
    assert right >= 20


def test_missed_vehicles_disappear_and_appear():
    earlier, later = street()
    found = match(earlier.drop(index=[3, 10]), later.drop(index=[6, 17]), elapsed_s=1.5)
    gone = found[found["detection_id_to"].isna()]
    new = found[found["detection_id_from"].isna()]
    assert set(gone["detection_id_from"]) == {6, 17}
    assert set(new["detection_id_to"]) == {1003, 1010}
    assert links(found) == {i: 1000 + i for i in range(24) if i not in (3, 10, 6, 17)}
    assert found["probability"].between(0, 1).all()


@pytest.mark.parametrize("method", METHODS)
def test_rows_in_any_order_give_the_same_table(method):
    earlier, later = street()
    found = match(earlier, later, elapsed_s=1.5, method=method)
    shuffled = match(
        earlier.sample(frac=1, random_state=1), later.sample(frac=1, random_state=2), elapsed_s=1.5, method=method
    )
    pd.testing.assert_frame_equal(found, shuffled)
    assert set(found["detection_id_from"].dropna()) == set(earlier["detection_id"])


def test_swapping_time_swaps_the_links():
    earlier, later = street(seed=4)
    forward = links(match(earlier, later, elapsed_s=1.5))
    backward = links(match(later, earlier, elapsed_s=1.5))
    assert {k: i for i, k in forward.items()} == backward


def test_a_mirrored_and_turned_world_gives_the_same_links():
    earlier, later = street(seed=2)
    turned = [t.assign(x_m=t["y_m"] * -1 + 7, y_m=t["x_m"] - 900) for t in (earlier, later)]
    assert links(match(*turned, elapsed_s=1.5)) == links(match(earlier, later, elapsed_s=1.5))


@pytest.mark.parametrize(("ids", "dtype"), [([7, 2**62 + 1], "Int64"), (["b", "a"], "str")])
def test_ids_keep_their_type_and_digits(ids, dtype):
    earlier = pd.DataFrame({"detection_id": ids, "x_m": [0.0, 50.0], "y_m": [0.0, 0.0]})
    later = pd.DataFrame({"detection_id": ids[:1], "x_m": [5.0], "y_m": [0.0]})
    found = match(earlier, later, elapsed_s=1.0)
    assert found["detection_id_from"].dtype == dtype
    assert links(found) == {ids[0]: ids[0]}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 3), (3, 0), (1, 1)])
def test_empty_and_single_images(method, n, m):
    earlier, later = street()
    found = match(earlier.head(n), later.head(m), elapsed_s=1.5, method=method)
    assert len(found.dropna(subset=["detection_id_from"])) == n
    assert found["detection_id_to"].dropna().nunique() == m


def test_nothing_moves_faster_than_the_limit():
    earlier = pd.DataFrame({"detection_id": [1], "x_m": [0.0], "y_m": [0.0]})
    assert links(match(earlier, earlier.assign(x_m=80.0), elapsed_s=1.5)) == {}
    assert links(match(earlier, earlier.assign(x_m=80.0), elapsed_s=3.0)) == {1: 1}


def test_a_flow_map_tells_lanes_apart_that_a_pair_alone_cannot():
    flow = FlowMap(np.tile([[0.0, 0.0]], (40, 1)), np.tile([[20.0, 0.0]], (40, 1)))
    earlier = pd.DataFrame({"detection_id": [1], "x_m": [0.0], "y_m": [0.0]})
    later = pd.DataFrame({"detection_id": [8, 9], "x_m": [20.0, -20.0], "y_m": [0.0, 0.0]})
    assert links(match(earlier, later, elapsed_s=1.0, flow_map=flow)) == {1: 8}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.drop(columns="x_m"), "x_m"),
        (lambda t: t.assign(y_m=np.nan), "y_m is missing or not finite in 24"),
        (lambda t: t.assign(red=np.inf), "red"),
        (lambda t: t.assign(detection_id=1), "repeated in 23"),
        (lambda t: t.assign(x_m="far"), "not numeric"),
    ],
)
def test_unusable_tables_are_refused_by_name(change, words):
    earlier, later = street()
    with pytest.raises(UnusableData, match=words):
        match(earlier, change(later), elapsed_s=1.5)


def test_unknown_methods_and_intervals_are_refused():
    earlier, later = street()
    with pytest.raises(ConfigError, match="magic"):
        match(earlier, later, elapsed_s=1.5, method="magic")
    with pytest.raises(UnusableData, match="elapsed_s"):
        match(earlier, later, elapsed_s=0.0)


def test_a_heap_of_points_is_refused_instead_of_filling_the_memory():
    heap = pd.DataFrame({"detection_id": range(6000), "x_m": 0.0, "y_m": 0.0})
    with pytest.raises(UnusableData, match="6000 detections of one frame lie within 10 m"):
        match(heap, heap, elapsed_s=1.5)


def test_a_crowd_beyond_the_limit_of_pairs_is_refused():
    rng = np.random.default_rng(0)
    crowd = pd.DataFrame({"detection_id": range(100_000)})
    crowd[["x_m", "y_m"]] = rng.uniform(0, 1, (len(crowd), 2)) * [1800, 700]
    with pytest.raises(UnusableData, match="pairs of 100000 and 100000 points"):
        match(crowd, crowd, elapsed_s=1.5)


@pytest.mark.parametrize("method", METHODS)
def test_many_at_one_point_are_answered(method):
    earlier, later = (t.assign(x_m=5.0, y_m=-3.0) for t in street(12))
    found = match(earlier, later, elapsed_s=1.5, method=method)
    assert set(found["detection_id_from"].dropna()) == set(earlier["detection_id"])
    assert found["probability"].between(0, 1).all()


@pytest.mark.real
@pytest.mark.parametrize(("scene", "low"), [("road", 97.0), ("congested", 97.0), ("crossing", 93.0), ("grid", 92.0)])
def test_label_rate_on_pinned_pairs(shared_data, scene, low):
    pairs = pd.read_parquet(shared_data / "sumo" / "pairs.parquet")
    pairs = pairs[(pairs["scene"] == scene) & np.isclose(pairs["elapsed_s"], 1.5) & np.isclose(pairs["missed"], 0.1)]
    seen = ["detection_id", "x_m", "y_m", "red", "green", "blue"]
    rates = []
    for _, rows in list(pairs.groupby("pair"))[:8]:
        a, b = rows[rows["image"] == 1], rows[rows["image"] == 2]
        truth = a.merge(b, on="truth_vehicle")
        want = dict(zip(truth["detection_id_x"], truth["detection_id_y"], strict=True))
        found = links(match(a[seen], b[seen], elapsed_s=1.5))
        back, want_back = {k: i for i, k in found.items()}, {k: i for i, k in want.items()}
        right = sum(found.get(i) == want.get(i) for i in a["detection_id"])
        right += sum(back.get(k) == want_back.get(k) for k in b["detection_id"])
        rates.append(100 * right / (len(a) + len(b)))
    assert np.mean(rates) >= low


@pytest.mark.real
def test_the_printed_method_reaches_its_stored_rate_and_no_more(shared_data):
    pairs = pd.read_parquet(shared_data / "sumo" / "pairs.parquet")
    pairs = pairs[
        (pairs["scene"] == "crossing") & np.isclose(pairs["elapsed_s"], 1.5) & np.isclose(pairs["missed"], 0.1)
    ]
    right = total = 0
    for _, rows in list(pairs.groupby("pair"))[:20]:
        a, b = rows[rows["image"] == 1], rows[rows["image"] == 2]
        found = links(match(a, b, elapsed_s=1.5, method="proposed"))
        place = dict(zip(b["truth_vehicle"], b["detection_id"], strict=True))
        right += sum(found.get(d) == place.get(v) for d, v in zip(a["detection_id"], a["truth_vehicle"], strict=True))
        total += len(a)
    assert 0.55 < right / total < 0.70
