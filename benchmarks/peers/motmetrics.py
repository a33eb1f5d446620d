"""IDF1, MOTA and ID switches by py-motmetrics, from boxes: its own distances, its own events."""

import time

import motmetrics as mm
import numpy as np

np.asfarray = lambda values: np.asarray(values, float)  # gone from NumPy 2, still asked for by motmetrics 1.4.0

BOX = ("left", "top", "width", "height")
NAMES = {"idf1": "idf1", "mota": "mota", "num_switches": "id_switches"}


def run(tables, settings):
    """Score ``tracks`` against ``truth`` (both: frame, id, left, top, width, height); a box overlaps by half or not."""
    start = time.perf_counter()
    truth, tracks = tables["truth"], tables["tracks"]
    boxes = [np.stack([side[name] for name in BOX], axis=1).astype(float) for side in (truth, tracks)]
    accumulator = mm.MOTAccumulator()
    for frame in np.unique(np.concatenate([truth["frame"], tracks["frame"]])):
        a, b = (np.flatnonzero(side["frame"] == frame) for side in (truth, tracks))
        a = a[np.argsort(truth["id"][a], kind="stable")]  # of two vehicles that claim one track the first has it
        distance = mm.distances.iou_matrix(boxes[0][a], boxes[1][b], max_iou=0.5)
        accumulator.update(truth["id"][a], tracks["id"][b], distance, frameid=int(frame))
    summary = mm.metrics.create().compute(accumulator, metrics=list(NAMES), name="sequence")
    return {
        "scores": {ours: np.array([float(summary[theirs].iloc[0])]) for theirs, ours in NAMES.items()},
        "seconds": {"seconds": np.array([time.perf_counter() - start])},
    }
