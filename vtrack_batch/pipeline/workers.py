"""Who does the work: in this process, or in processes of this machine, behind one small interface.

Results are written by content key, so neither the number of workers nor the order of completion can be seen in them.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from vtrack_batch.errors import StorageError, VtrackError
from vtrack_batch.pipeline.hand import has_left, holding, left_behind
from vtrack_batch.pipeline.parts import Context
from vtrack_batch.pipeline.plan import Piece

Work = Callable[[Piece, Context], None]

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"), "1"
)
OUT_OF_MEMORY = 107
"""Exit code of a worker that was refused memory."""

OPENCV_NO_MEMORY = -4
LOOK_ROUND_S = 2.0
IDLE_S = 120.0
"""If nobody is at work for so long though there is work, the workers are let go and new ones taken."""

PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class Death:
    """A worker ended in the middle of a piece: how, and which frame it had in hand."""

    reason: str
    detail: str
    frame: str | None


class DeadlineReached(Exception):
    """The time set for the run is over; what is in hand is let go."""


class Workers(Protocol):
    """Does pieces of work that do not depend on each other."""

    def run(
        self, pieces: Sequence[Piece], work: Work, context: Context, *, until_s: float | None = None
    ) -> Iterator[tuple[Piece, Death | None]]:
        """Yield each piece when it is done, or when its worker died of it.

        The first error of the work itself is raised; ``DeadlineReached`` at *until_s* of the monotonic clock.
        """
        ...

    def close(self) -> None:
        """Let the workers go."""
        ...


class InProcess:
    """Does the work in this process, one piece after the other; what kills the process ends the run."""

    def run(
        self, pieces: Sequence[Piece], work: Work, context: Context, *, until_s: float | None = None
    ) -> Iterator[tuple[Piece, Death | None]]:
        """Do the pieces in order."""
        for piece in pieces:
            if until_s is not None and time.monotonic() > until_s:
                raise DeadlineReached
            do_piece(piece, work, context)
            yield piece, None

    def close(self) -> None:
        """Nobody to let go."""


class Local:
    """Worker processes of this machine: the death of one costs the piece it was at, and tells which frame that was."""

    def __init__(self, count: int, memory_mb: int | None = None) -> None:
        self._most, self._memory_mb = count, memory_mb
        self._pool: Any = None
        self._count = 0

    def run(
        self, pieces: Sequence[Piece], work: Work, context: Context, *, until_s: float | None = None
    ) -> Iterator[tuple[Piece, Death | None]]:
        """Deal the pieces out, few at a time."""
        from pebble import ProcessExpired

        waiting = list(reversed(pieces))
        hands: dict[Any, Piece] = {}
        seen_s = time.monotonic()
        try:
            while waiting or hands:
                pool = self._pool_for(len(pieces))
                while waiting and len(hands) < 2 * self._count:
                    piece = waiting.pop()
                    hands[pool.schedule(do_isolated, args=(piece, work, context, self._memory_mb))] = piece
                done, _ = wait(hands, timeout=_patience_s(until_s), return_when=FIRST_COMPLETED)
                for future in sorted(done, key=lambda future: hands[future].name):
                    piece, problem = hands.pop(future), future.exception()
                    if problem is None:
                        yield piece, None
                    elif isinstance(problem, ProcessExpired):
                        yield piece, death_of(piece, context, problem.exitcode)
                    else:
                        raise problem
                if not done:
                    # one that ends as if all were well is not missed by the pool
                    for future in [one for one, piece in hands.items() if has_left(note_of(piece, context))]:
                        if not future.done():
                            piece = hands.pop(future)
                            yield piece, death_of(piece, context, None)
                if done or any(note_of(piece, context).exists() for piece in hands.values()):
                    seen_s = time.monotonic()
                elif time.monotonic() - seen_s > IDLE_S:
                    # a worker that was killed while it fetched its work has taken the way to it along
                    self.close()
                    waiting += reversed(hands.values())
                    hands.clear()
                    seen_s = time.monotonic()
        finally:
            if hands:
                self.close()

    def close(self) -> None:
        """End the workers, whatever they are at."""
        if self._pool is not None:
            self._pool.stop()
            self._pool.join()
            self._pool = None

    def _pool_for(self, pieces: int) -> Any:
        """Return a pool for so many pieces; starting a worker costs seconds, so that one serves all steps."""
        from pebble import ProcessPool

        wanted = min(self._most, pieces)
        if self._pool is not None and self._count < wanted:
            self.close()
        if self._pool is None:
            os.environ.update(ONE_THREAD)
            self._count = wanted
            self._pool = ProcessPool(
                wanted,
                context=multiprocessing.get_context("spawn"),
                initializer=_begin_worker,
                initargs=(os.getpid(),),
            )
        return self._pool


def death_of(piece: Piece, context: Context, exit_code: int | None) -> Death:
    """Return what is known of the death of the worker that was at *piece*."""
    frame = left_behind(note_of(piece, context))
    if exit_code == -signal.SIGALRM:
        limit_s = context.survey.execution.frame_limit_s
        return Death("timeout", f"not done after execution.frame_limit_s = {limit_s:g} s", frame)
    if exit_code == OUT_OF_MEMORY:
        limit = context.survey.execution.memory_mb
        return Death("out_of_memory", f"more than execution.memory_mb = {limit} was asked for", frame)
    if exit_code is not None and exit_code < 0:
        killed = " (by the system for want of memory?)" if exit_code == -signal.SIGKILL else ""
        return Death("worker_died", f"its worker ended by {signal.Signals(-exit_code).name}{killed}", frame)
    return Death("worker_died", "its worker ended" + ("" if exit_code is None else f" with code {exit_code}"), frame)


def note_of(piece: Piece, context: Context) -> Path:
    """Return where the worker at *piece* notes what it has in hand."""
    return context.output.state / "hands" / f"{piece.step}-{piece.key}"


def do_isolated(piece: Piece, work: Work, context: Context, memory_mb: int | None = None) -> None:
    """Do one piece in a process that may die of it, with so much memory."""
    import cv2

    if not context.output.staging.is_dir():
        raise StorageError(f"{context.out}: not seen from this worker; all workers need the same paths")
    with holding(note_of(piece, context), limit_s=context.survey.execution.frame_limit_s) as hand:
        try:
            with _limited(memory_mb):
                do_piece(piece, work, replace(context, hand=hand))
        except MemoryError:
            os._exit(OUT_OF_MEMORY)  # at once, so that the note of what was in hand stays behind
        except cv2.error as problem:
            if problem.code == OPENCV_NO_MEMORY:
                os._exit(OUT_OF_MEMORY)
            raise


@contextmanager
def _limited(memory_mb: int | None) -> Iterator[None]:
    """Refuse memory beyond the limit for as long as the work lasts, so that what deals it out is not starved."""
    if memory_mb is None:
        yield
        return
    former = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (memory_mb << 20, former[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, former)


def _patience_s(until_s: float | None) -> float:
    """Return how long to wait before looking round; raises ``DeadlineReached`` when the time is over."""
    if until_s is None:
        return LOOK_ROUND_S
    left_s = until_s - time.monotonic()
    if left_s <= 0:
        raise DeadlineReached
    return min(left_s, LOOK_ROUND_S)


def do_piece(piece: Piece, work: Work, context: Context) -> None:
    """Do one piece in this process; OpenCV's own threads stay off so that workers do not crowd each other."""
    import cv2

    cv2.setNumThreads(1)
    try:
        work(piece, context)
    except VtrackError as problem:
        problem.add_note(f"in step {piece.step}, {piece.name}")
        raise


def _begin_worker(parent: int) -> None:
    """Set up a worker: it ends with its parent, leaves Ctrl-C to it, and dumps no core."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(0)
