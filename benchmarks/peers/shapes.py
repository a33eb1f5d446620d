"""What the linking peers share: rows of one sequence, frame by frame, in and out of plain arrays; and the clock."""

import signal
import time
from contextlib import contextmanager

import numpy as np


class TooLong(Exception):
    """The time for one sequence is over."""


@contextmanager
def at_most(limit_s):
    """Raise ``TooLong`` inside the block when it takes more processor time; 0 = never."""

    def stop(*_):
        raise TooLong

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def linked(tables, settings, link, warm_up=True):
    """Call ``link(frames, interval_s, **setting)`` for every setting and sequence; return tracks and seconds.

    *frames* is a list with a dict of columns for each frame, ``xy`` (n, 2) and ``rgb`` (n, 3) or None; frames without
    rows are there, and empty. *link* returns a list of integer arrays (n,), the track of each row, -1 = none. Where the
    rows have a column ``setting``, a sequence is linked with that setting only. A setting that once needs longer than
    ``settings["limit_s"]`` (0 = no limit) is given up for that interval: no track, no seconds.
    """
    rows = tables["detections"]
    tracks, seconds, refused = [], [], set()
    for number, setting in enumerate(settings["grid"]):
        for name in np.unique(rows["sequence"]):
            here = np.flatnonzero(rows["sequence"] == name)
            if "setting" in rows and rows["setting"][here[0]] != number:
                continue
            interval_s = float(rows["interval_s"][here[0]])
            if (number, interval_s) in refused:
                continue
            frames, order = frames_of(rows, here, setting.get("colour", True))
            options = {key: value for key, value in setting.items() if key != "colour"}
            if warm_up:
                link(frames[:3], interval_s, **options)
                warm_up = False
            start = time.process_time()
            try:
                with at_most(settings.get("limit_s", 0)):
                    found = link(frames, interval_s, **options)
            except TooLong:
                refused.add((number, interval_s))
                continue
            seconds.append((number, name, time.process_time() - start))
            row = np.concatenate(order)
            tracks.append((np.full(len(row), number), row, np.concatenate(found).astype(np.int64)))
    return {
        "tracks": dict(zip(("setting", "row", "track"), map(np.concatenate, zip(*tracks, strict=True)), strict=True)),
        "seconds": dict(
            zip(("setting", "sequence", "seconds"), map(np.array, zip(*seconds, strict=True)), strict=True)
        ),
    }


def frames_of(rows, here, colour):
    """Return the frames of one sequence and, for each, the numbers of its rows."""
    frame = rows["frame"][here]
    frames, order = [], []
    for number in range(int(frame.max()) + 1):
        of_frame = here[frame == number]
        xy = np.column_stack([rows["x_m"][of_frame], rows["y_m"][of_frame]])
        seen = colour and "red" in rows
        rgb = np.column_stack([rows[c][of_frame] for c in ("red", "green", "blue")]).astype(float) if seen else None
        frames.append({"xy": xy, "rgb": rgb})
        order.append(of_frame)
    return frames, order
