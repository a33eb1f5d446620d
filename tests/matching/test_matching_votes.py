"""Who speaks for whom: found by cells of place and displacement, and the same as asking everybody."""

import numpy as np
import pytest

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.candidates import candidates
from vtrack_batch.matching.neighbours import CUT, STILL_M, find_votes
from vtrack_batch.matching.params import NeighbourParams

PARAMS = NeighbourParams()


def everybody_asked(owner, d, xy, spread):
    """Votes (e, e) and voters (e,), by the definition."""
    votes, voters = np.zeros((len(owner), len(owner))), np.zeros(len(owner))
    for e, i in enumerate(owner):
        length = np.hypot(*d[e])
        ahead = d[e] / length if length > STILL_M else np.array([1.0, 0.0])
        far = (PARAMS.along_m, PARAMS.across_m if length > STILL_M else PARAMS.along_m)
        r = xy - xy[i]
        u, v = r @ ahead / far[0], (r[:, 0] * ahead[1] - r[:, 1] * ahead[0]) / far[1]
        z = np.where(np.arange(len(xy)) == i, np.inf, u**2 + v**2)
        place = np.where(z <= CUT**2, np.exp(-0.5 * z), 0.0)
        q = ((d - d[e]) ** 2).sum(axis=1) / spread**2
        votes[e] = place[owner] * np.where(q <= CUT**2, np.exp(-0.5 * q), 0.0) / (2 * np.pi * spread**2)
        voters[e] = place.sum()
    return votes, voters


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("spread", [0.8, 2.25, 6.0])
def test_votes_are_those_of_asking_everybody(seed, spread):
    rng = np.random.default_rng(seed)
    xy = rng.uniform([-400, 0], [500, 90], (60, 2))
    xy[:3] += [[0, 5e5], [3e6, 0], [-2e5, -2e5]]  # strays far away cost nothing and are heard by nobody
    later = xy + rng.normal(0, [8, 2], xy.shape) * (rng.random((60, 1)) < 0.8)
    edges = candidates(xy, later, 40.0)
    votes = find_votes(edges.i, edges.displacement, xy, spread, PARAMS)
    dense = np.zeros((len(edges), len(edges)))
    for e in range(len(edges)):
        by = votes.by[votes.start[e] : votes.stop[e]]
        assert len(set(by)) == len(by)
        dense[e, by] = votes.weight[votes.start[e] : votes.stop[e]]
    expected, voters = everybody_asked(edges.i, edges.displacement, xy, spread)
    assert (expected > 0).sum() > 50
    np.testing.assert_allclose(dense, expected, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(votes.voters, voters, rtol=1e-9, atol=1e-9)


def test_nobody_and_one():
    one = candidates(np.zeros((1, 2)), np.ones((1, 2)), 5.0)
    assert find_votes(one.i, one.displacement, np.zeros((1, 2)), 1.0, PARAMS).voters.tolist() == [0.0]
    none = candidates(np.zeros((0, 2)), np.zeros((0, 2)), 5.0)
    assert len(find_votes(none.i, none.displacement, np.zeros((0, 2)), 1.0, PARAMS).by) == 0


def test_a_crowd_on_one_place_is_refused_at_once():
    xy = np.random.default_rng(0).uniform(0, 200, (12_000, 2))
    with pytest.raises(UnusableData, match="unit of the coordinates"):
        find_votes(np.arange(len(xy)), np.zeros_like(xy), xy, 1.0, PARAMS)
