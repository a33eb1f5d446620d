"""A chain does not begin or end with a step that no vehicle can make, and keeps those that it can."""

import numpy as np
import pandas as pd
import pytest
from tracking_worlds import START

from vtrack_batch.tracking.ends import cut_impossible_ends
from vtrack_batch.tracking.link import Chains
from vtrack_batch.tracking.sightings import read_detections, sightings_of


def one_chain(x_m, interval_s=1.5, sigma_m=0.3):
    """A vehicle along a line that climbs one in five, seen at these distances, all linked."""
    n = len(x_m)
    table = pd.DataFrame(
        {
            "detection_id": [f"d{i}" for i in range(n)],
            "t_utc": START + pd.to_timedelta(np.arange(n) * interval_s, unit="s"),
            "x_m": np.asarray(x_m, float),
            "y_m": np.asarray(x_m, float) / 5,
        }
    )
    s = sightings_of(read_detections(table), "main", None, sigma_m)
    after = np.append(np.arange(1, n), -1)
    before = np.append(-1, np.arange(n - 1))
    return s, Chains(after, before, np.full(n, 0.9), np.full(n, 0.2))


def cut(x_m, **options):
    s, chains = one_chain(x_m, **options)
    return cut_impossible_ends(s, chains, max_accel_mps2=6.0)


STEADY = np.arange(8) * 18.0


@pytest.mark.parametrize("x_m", [STEADY, STEADY[::-1], np.cumsum([0, 18, 17, 13, 7, 2, 0, 0]), [0.0, 40.0], [5.0], []])
def test_what_vehicles_do_is_kept(x_m):
    assert (cut(x_m).after >= 0).sum() == max(0, len(x_m) - 1)


def test_a_jump_at_the_beginning_is_cut_and_its_doubt_is_told():
    found = cut(np.append(-60.0, STEADY))
    assert found.after.tolist() == [-1, 2, 3, 4, 5, 6, 7, 8, -1]
    assert found.before.tolist() == [-1, -1, 1, 2, 3, 4, 5, 6, 7]
    assert found.probability[0] == pytest.approx(0.1)
    assert found.none_before[1] == pytest.approx(0.1)


def test_a_jump_at_the_end_is_cut():
    assert cut(np.append(STEADY, 180.0)).after.tolist() == [1, 2, 3, 4, 5, 6, 7, -1, -1]


def test_positions_as_vague_as_the_jump_do_not_tell():
    assert (cut(np.append(-60.0, STEADY), sigma_m=20.0).after >= 0).sum() == 8
