"""The printed relaxation equals independently computed probabilities, and treats both images alike."""

import json

import numpy as np
import pytest

from vtrack_batch.matching.candidates import candidates
from vtrack_batch.matching.colour import colour_labels, equal_labels
from vtrack_batch.matching.params import RelaxationParams
from vtrack_batch.matching.relaxation import relax

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
