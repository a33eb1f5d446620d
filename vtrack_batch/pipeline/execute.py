"""Carry out pieces of work with any number of processes: the one place for parallel policy.

Results are written by content key, so neither the number of workers nor the order of completion can be seen in them.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence

from vtrack_batch.errors import StorageError, VtrackError
from vtrack_batch.pipeline.parts import Context
from vtrack_batch.pipeline.plan import Piece

Work = Callable[[Piece, Context], None]
Progress = Callable[[Piece], None]

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"), "1"
)


def carry_out(pieces: Sequence[Piece], work: Work, context: Context, *, workers: int, progress: Progress) -> None:
    """Do *work* on every piece; pieces must not depend on each other. The first error ends it."""
    if workers == 1 or len(pieces) < 2:
        for piece in pieces:
            _do(piece, work, context)
            progress(piece)
        return
    from pebble import ProcessExpired, ProcessPool

    os.environ.update(ONE_THREAD)
    spawn = multiprocessing.get_context("spawn")
    with ProcessPool(max_workers=min(workers, len(pieces)), context=spawn) as pool:
        futures = [(piece, pool.schedule(_do, args=(piece, work, context))) for piece in pieces]
        try:
            for piece, future in futures:
                future.result()
                progress(piece)
        except ProcessExpired as death:
            pool.stop()
            raise StorageError(
                f"a worker process died in step {piece.step}, {piece.name} (exit code {death.exitcode}); "
                "out of memory? Try fewer workers; what was published before is intact"
            ) from None
        except BaseException:
            pool.stop()
            raise


def _do(piece: Piece, work: Work, context: Context) -> None:
    """Do one piece in this process; OpenCV's own threads stay off so that workers do not crowd each other."""
    import cv2

    cv2.setNumThreads(1)
    try:
        work(piece, context)
    except VtrackError as problem:
        problem.add_note(f"in step {piece.step}, {piece.name}")
        raise
