"""Stabilo with its defaults (ORB): lays frames on a reference frame; its deep-learning parts are not installed."""

import time

import cv2
import numpy as np
from stabilo import Stabilizer


def run(tables, settings):
    """Return ``poses``: row *i* = homography (9 columns) from frame *i* to the reference; ``seconds`` per frame."""
    cv2.setNumThreads(1)
    paths = tables["frames"]["path"]
    stabilizer = Stabilizer(mask_use=False)
    stabilizer.set_ref_frame(cv2.imread(str(paths[settings["reference"]])))
    matrices, seconds = [], []
    for path in paths:
        frame = cv2.imread(str(path))
        start = time.process_time()
        stabilizer.stabilize(frame)
        seconds.append(time.process_time() - start)
        found = stabilizer.get_cur_trans_matrix()
        matrices.append(np.full(9, np.nan) if found is None else np.vstack([found, [0, 0, 1]])[:3].ravel())
    poses = {f"h{i}": column for i, column in enumerate(np.array(matrices).T)}
    return {"poses": poses, "seconds": {"seconds": np.array(seconds)}}
