"""A flow map survives its file, and a file that holds none is told apart."""

import numpy as np
import pytest

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.flow import FlowMap


def some_map():
    rng = np.random.default_rng(3)
    return FlowMap(rng.uniform(0, 400, (50, 2)), rng.normal(0, 9, (50, 2)))


def test_what_is_saved_is_loaded(tmp_path):
    flow = some_map()
    flow.save(tmp_path / "place.flow")
    back = FlowMap.load(tmp_path / "place.flow")
    np.testing.assert_array_equal(back.xy, flow.xy)
    np.testing.assert_array_equal(back.velocity, flow.velocity)
    flow.save(str(tmp_path / "again.flow"))
    assert (tmp_path / "again.flow").read_bytes() == (tmp_path / "place.flow").read_bytes()


@pytest.mark.parametrize("content", [b"", b"x_m,y_m\n1,2\n", b"PK\x03\x04 but cut off"])
def test_a_file_that_is_no_map_is_told(tmp_path, content):
    path = tmp_path / "wrong.flow"
    path.write_bytes(content)
    with pytest.raises(UnusableData, match=r"wrong\.flow"):
        FlowMap.load(path)


@pytest.mark.parametrize(
    "arrays",
    [
        {"other": np.zeros(3)},
        {"format": np.array("vtrack-batch flow map 99"), "xy_m": np.zeros((3, 2)), "velocity_mps": np.zeros((3, 2))},
    ],
)
def test_another_archive_of_arrays_is_told(tmp_path, arrays):
    path = tmp_path / "wrong.npz"
    np.savez(path, **arrays)
    with pytest.raises(UnusableData, match=r"wrong\.npz"):
        FlowMap.load(path)


def test_damaged_contents_are_told(tmp_path):
    path = tmp_path / "wrong.flow"
    flow = some_map()
    FlowMap(flow.xy, flow.velocity[:20]).save(path)
    with pytest.raises(UnusableData, match="alike"):
        FlowMap.load(path)
    FlowMap(flow.xy, np.full((50, 2), np.nan)).save(path)
    with pytest.raises(UnusableData, match="finite"):
        FlowMap.load(path)
