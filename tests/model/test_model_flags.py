"""Every flag has a meaning of its own."""

from vtrack_batch.model.flags import DetectionFlag, TrajectoryFlag, legend


def test_each_bit_has_its_own_name_and_meaning() -> None:
    flags = [*legend(DetectionFlag), *legend(TrajectoryFlag)]
    assert len({flag.name for flag in flags}) == len({flag.meaning for flag in flags}) == len(flags)
    assert "border" in legend(DetectionFlag)[0].meaning
