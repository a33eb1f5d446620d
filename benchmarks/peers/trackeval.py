"""IDF1, MOTA, ID switches and HOTA by TrackEval, from boxes: its own overlaps, its own metrics."""

import contextlib
import io
import time

import numpy as np

with contextlib.redirect_stdout(io.StringIO()):  # it names the extras that it could not load
    from trackeval.datasets._base_dataset import _BaseDataset
    from trackeval.metrics import CLEAR, HOTA, Identity

BOX = ("left", "top", "width", "height")


def run(tables, settings):
    """Score ``tracks`` against ``truth`` (both: frame, id, left, top, width, height)."""
    start = time.perf_counter()
    data = sequence(tables["truth"], tables["tracks"])
    hota = HOTA().eval_sequence(data)
    clear = CLEAR({"PRINT_CONFIG": False}).eval_sequence(data)
    identity = Identity({"PRINT_CONFIG": False}).eval_sequence(data)
    scores = {
        "hota": np.mean(hota["HOTA"]), "deta": np.mean(hota["DetA"]), "assa": np.mean(hota["AssA"]),
        "mota": clear["MOTA"], "id_switches": clear["IDSW"], "idf1": identity["IDF1"],
    }  # fmt: skip
    return {
        "scores": {name: np.array([float(value)]) for name, value in scores.items()},
        "seconds": {"seconds": np.array([time.perf_counter() - start])},
    }


def sequence(truth, tracks):
    """Return the data of one sequence in TrackEval's form."""
    frames = np.unique(np.concatenate([truth["frame"], tracks["frame"]]))
    ids = [np.unique(side["id"], return_inverse=True) for side in (truth, tracks)]
    per_frame = [[np.flatnonzero(side["frame"] == frame) for frame in frames] for side in (truth, tracks)]
    boxes = [np.stack([side[name] for name in BOX], axis=1).astype(float) for side in (truth, tracks)]
    return {
        "num_timesteps": len(frames),
        "num_gt_dets": len(truth["frame"]),
        "num_tracker_dets": len(tracks["frame"]),
        "num_gt_ids": len(ids[0][0]),
        "num_tracker_ids": len(ids[1][0]),
        "gt_ids": [ids[0][1][rows] for rows in per_frame[0]],
        "tracker_ids": [ids[1][1][rows] for rows in per_frame[1]],
        "similarity_scores": [
            _BaseDataset._calculate_box_ious(boxes[0][a], boxes[1][b], box_format="xywh")
            for a, b in zip(*per_frame, strict=True)
        ],
    }
