"""The printed relaxation equals independently computed probabilities, and treats both images alike."""

import json

import numpy as np
import pytest

from vtrack_batch.matching.candidates import candidates, pairs_within
from vtrack_batch.matching.colour import colour_labels, equal_labels
from vtrack_batch.matching.params import RelaxationParams
from vtrack_batch.matching.relaxation import paper_grid, relax, support, sweep

METHODS = {"a": (False, False), "b": (True, False), "c": (False, True), "d": (True, True)}


def probabilities(first, second, method, iterations):
    coloured, two_way = METHODS[method]
    (xy1, rgb1), (xy2, rgb2) = first, second
    edges = candidates(xy1, xy2, 150)
    start = colour_labels(edges, rgb1, rgb2) if coloured else equal_labels(edges)
    params = RelaxationParams(neighbourhood_m=200, iterations=iterations, stop_change=0)
    return edges, relax(edges, start, xy1, xy2, tolerance=20, params=params, two_way=two_way)


@pytest.mark.real
@pytest.mark.parametrize("iterations", [0, 1, 5, 50])
@pytest.mark.parametrize("method", "abcd")
def test_golden_probabilities(shared_data, method, iterations):
    golden = json.loads((shared_data / "golden" / "relaxation.json").read_text())
    images = [(np.array(golden[k]["xy"]), np.array(golden[k]["rgb"])) for k in ("image1", "image2")]
    edges, labels = probabilities(*images, method, iterations)
    want = golden["result"][f"{method}_{iterations}"]
    rows = np.array(sorted(want["edges"]))
    np.testing.assert_array_equal(rows[:, :2], np.column_stack([edges.i, edges.k]))
    np.testing.assert_allclose(np.column_stack([labels.p, labels.q]), rows[:, 2:], rtol=0, atol=1e-6)
    np.testing.assert_allclose(labels.p_none, want["P_none"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(labels.q_none, want["Q_none"], rtol=0, atol=1e-6)


def random_image(seed, size):
    rng = np.random.default_rng(seed)
    return rng.uniform(0, 1, (size, 2)) * [400, 60], rng.uniform(0, 255, (size, 3))


@pytest.mark.parametrize("method", "cd")
@pytest.mark.parametrize("iterations", [1, 7, 50])
def test_swapping_the_images_exchanges_p_and_q(method, iterations):
    first, second = random_image(1, 23), random_image(2, 19)
    edges, forward = probabilities(first, second, method, iterations)
    swapped, backward = probabilities(second, first, method, iterations)
    order = np.lexsort((swapped.i, swapped.k))
    np.testing.assert_array_equal(edges.i, swapped.k[order])
    np.testing.assert_allclose(forward.p, backward.q[order], rtol=0, atol=1e-12)
    np.testing.assert_allclose(forward.q, backward.p[order], rtol=0, atol=1e-12)
    np.testing.assert_allclose(forward.p_none, backward.q_none, rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", "abcd")
def test_labels_of_every_vehicle_sum_to_one(method):
    first, second = random_image(3, 15), random_image(4, 17)
    edges, labels = probabilities(first, second, method, 10)
    np.testing.assert_allclose(np.bincount(edges.i, labels.p, edges.n) + labels.p_none, 1, atol=1e-9)
    if METHODS[method][1]:
        np.testing.assert_allclose(np.bincount(edges.k, labels.q, edges.m) + labels.q_none, 1, atol=1e-9)


def test_one_way_methods_leave_the_opposite_labels_alone():
    first, second = random_image(5, 12), random_image(6, 12)
    _, start = probabilities(first, second, "b", 0)
    _, end = probabilities(first, second, "b", 20)
    np.testing.assert_array_equal(start.q, end.q)


def test_the_box_reaches_along_both_axes_and_not_in_a_circle():
    corner = candidates(np.array([[0.0, 0.0]]), np.array([[9.9, 9.9], [10.1, 0.0], [0.0, -10.0]]), 10.0)
    assert corner.k.tolist() == [0, 2]


def test_no_candidates_means_certainly_no_match():
    lonely = (
        (np.array([[0.0, 0.0], [1000.0, 0.0]]), np.full((2, 3), 9.0)),
        (np.array([[5.0, 0.0]]), np.full((1, 3), 9.0)),
    )
    _, labels = probabilities(*lonely, "d", 5)
    assert labels.p_none[1] == 1.0
    assert labels.p[0] > 0.5


def test_a_sweep_gives_what_each_setting_alone_gives():
    first, second = random_image(7, 31), random_image(8, 27)
    (xy1, rgb1), (xy2, rgb2) = first, second
    edges = candidates(xy1, xy2, 90)
    start = colour_labels(edges, rgb1, rgb2)
    settings = paper_grid()[::409]
    assert 60 < len(settings) < 100  # no multiple of the lanes
    best_i, best_k = sweep(
        edges, start, xy1, xy2, settings=settings, tolerance=20, params=RelaxationParams(neighbourhood_m=200)
    )
    assert best_i.shape == (len(settings), 31)
    off = 0
    for n, (a, b, c) in enumerate(settings):
        params = RelaxationParams(neighbourhood_m=200, a_delay=a, b_neighbours=b, c_opposite=c)
        labels = relax(edges, start, xy1, xy2, tolerance=20, params=params)
        own, other = np.full(31, -1), np.full(27, -1)
        for picked, ends in ((own, (edges.i, edges.k)), (other, (edges.k, edges.i))):
            p, none = (labels.p, labels.p_none) if picked is own else (labels.q, labels.q_none)
            for e in np.argsort(p, kind="stable"):
                if p[e] > none[ends[0][e]]:
                    picked[ends[0][e]] = ends[1][e]
        off += (own != best_i[n]).sum() + (other != best_k[n]).sum()
    assert off <= 0.002 * len(settings) * 58
    assert (best_i >= 0).any()


def test_the_paper_tries_28611_settings():
    grid = paper_grid()
    assert grid.shape == (28611, 3)
    assert [0.5, 1.0, 1.0] in grid.tolist()
    np.testing.assert_array_equal(grid.max(axis=0), [1, 10, 10])


def test_pairs_within_are_those_of_brute_force():
    rng = np.random.default_rng(2)
    a, b = rng.uniform(-300, 40, (60, 2)) * [3, 1], rng.uniform(-300, 40, (80, 2)) * [3, 1]
    b[:5] = a[:5] + np.array([12.5, -12.5])
    off = b[None] - a[:, None]
    for p, near in ((np.inf, np.abs(off).max(axis=2) <= 12.5), (2, np.hypot(*off.T).T <= 12.5)):
        i, k = pairs_within(a, b, 12.5, p=p, limit=10**6)
        np.testing.assert_array_equal(np.column_stack([i, k]), np.argwhere(near))


def test_support_is_that_of_brute_force():
    rng = np.random.default_rng(3)
    xy1, xy2 = rng.uniform(0, 1, (20, 2)) * [150, 40], rng.uniform(0, 1, (22, 2)) * [150, 40]
    edges = candidates(xy1, xy2, 40)
    found = support(edges.k, edges.displacement, xy2, 9.0, RelaxationParams(neighbourhood_m=50))
    near = np.hypot(*(xy2[edges.k][:, None] - xy2[edges.k][None]).T) <= 50
    agree = np.hypot(*(edges.displacement[:, None] - edges.displacement[None]).T) <= 9
    want = near & agree & (edges.k[:, None] != edges.k[None])
    assert want.sum() > 100
    for e in range(len(edges)):
        np.testing.assert_array_equal(np.sort(found.by[found.start[e] : found.start[e + 1]]), np.flatnonzero(want[e]))
