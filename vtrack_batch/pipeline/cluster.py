"""Workers of other machines: the same pieces, dealt out by a Dask scheduler; results by the storage all share."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

from vtrack_batch.errors import ConfigError, StorageError
from vtrack_batch.pipeline.parts import Context
from vtrack_batch.pipeline.plan import Piece
from vtrack_batch.pipeline.workers import DeadlineReached, Death, Work, death_of, do_isolated

CONNECT_S = 20


class Cluster:
    """A Dask cluster by the address of its scheduler; workers run one thread each under a nanny."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._distributed = _library()
        self._client = _client(self._distributed, address)
        self._sent = 0

    def run(
        self, pieces: Sequence[Piece], work: Work, context: Context, *, until_s: float | None = None
    ) -> Iterator[tuple[Piece, Death | None]]:
        """Deal the pieces out, two for each thread at a time."""
        waiting = list(reversed(pieces))
        hands: dict[Any, Piece] = {}
        try:
            while waiting or hands:
                window = max(2, 2 * sum(self._client.nthreads().values()))
                while waiting and len(hands) < window:
                    piece = waiting.pop()
                    hands[self._submit(piece, work, context)] = piece
                left_s = None if until_s is None else max(0.0, until_s - time.monotonic())
                yield from self._harvest(hands, context, left_s)
        except OSError as problem:
            raise self._gone(problem) from None
        finally:
            for future in hands:
                future.cancel()

    def close(self) -> None:
        """Leave the cluster as it was."""
        self._client.close()

    def _submit(self, piece: Piece, work: Work, context: Context) -> Any:
        self._sent += 1
        key = f"{piece.step}-{piece.key}-{self._sent}"  # never twice, or Dask would answer from memory
        memory_mb = context.survey.execution.memory_mb
        return self._client.submit(do_isolated, piece, work, context, memory_mb, key=key, pure=False)

    def _harvest(
        self, hands: dict[Any, Piece], context: Context, left_s: float | None
    ) -> Iterator[tuple[Piece, Death | None]]:
        """Wait for at least one piece; yield what is done."""
        try:
            with self._client.as_current():
                done, _ = self._distributed.wait(list(hands), timeout=left_s, return_when="FIRST_COMPLETED")
        except TimeoutError:
            raise DeadlineReached from None
        for future in sorted(done, key=lambda future: hands[future].name):
            piece = hands.pop(future)
            if future.status == "finished":
                yield piece, None
            elif future.status == "error":
                problem = future.exception()
                if not isinstance(problem, self._distributed.scheduler.KilledWorker):
                    raise problem
                yield piece, death_of(piece, context, None)
            else:
                raise self._gone(future.status)

    def _gone(self, problem: object) -> StorageError:
        return StorageError(
            f"the Dask scheduler at {self._address} is gone ({problem}); finished pieces are kept: run again"
        )


def _library() -> Any:
    try:
        import distributed
    except ImportError:
        raise ConfigError("a cluster needs Dask: pip install 'vtrack-batch[cluster]'") from None
    return distributed


def _client(distributed: Any, address: str) -> Any:
    try:
        return distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as problem:
        raise ConfigError(
            f"no Dask scheduler answers at {address} ({problem}); see --cluster, execution.cluster"
        ) from None
