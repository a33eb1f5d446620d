"""Carry out pieces of work: what is done when a worker dies of one.

A worker's death costs its piece. The piece is done again alone, and again, until the same frame has been in the hand of
two dead workers: that frame is the culprit. A death that does not come again was nobody's fault.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from vtrack_batch.errors import StorageError
from vtrack_batch.pipeline.culprits import Culprit
from vtrack_batch.pipeline.parts import Context
from vtrack_batch.pipeline.plan import Piece
from vtrack_batch.pipeline.workers import Death, Work, Workers

STRIKES = 2
MOST_DEATHS = 6

Tell = Callable[..., None]
"""Told an event by name, with its facts as keywords."""


@dataclass(frozen=True)
class Crew:
    """The workers of a run, its deadline, and who is told what happens."""

    workers: Workers
    tell: Tell
    until_s: float | None = None


def carry_out(pieces: Sequence[Piece], work: Work, context: Context, crew: Crew) -> list[Culprit]:
    """Do *work* on every piece, none of which needs another; returns the frames that must be left out to do the rest.

    The first error ends it. Events: ``done`` and ``died`` with step and piece.
    """
    dead: list[tuple[Piece, Death]] = []
    for piece, death in crew.workers.run(pieces, work, context, until_s=crew.until_s):
        if death is None:
            crew.tell("done", step=piece.step, piece=piece.name)
        else:
            _tell_death(piece, death, crew)
            dead.append((piece, death))
    found = [_culprit(piece, death, work, context, crew) for piece, death in dead]
    return [culprit for culprit in found if culprit is not None]


def _culprit(piece: Piece, death: Death, work: Work, context: Context, crew: Crew) -> Culprit | None:
    """Do a piece again, alone, until it is done or the frame that kills its workers is known."""
    strikes = Counter([death.frame])
    for _ in range(MOST_DEATHS):
        outcomes = list(crew.workers.run([piece], work, context, until_s=crew.until_s))
        again = outcomes[0][1]
        if again is None:
            crew.tell("done", step=piece.step, piece=piece.name)
            return None
        _tell_death(piece, again, crew)
        strikes[again.frame] += 1
        if strikes[again.frame] >= STRIKES:
            if again.frame is None:
                break
            crew.tell("quarantined", frame=again.frame, reason=again.reason, detail=again.detail)
            return Culprit(again.frame, again.reason, again.detail)
    raise StorageError(
        f"workers die in step {piece.step}, {piece.name}, and not of one frame: {death.detail}; "
        "out of memory? Try fewer workers; what was published before is intact"
    )


def _tell_death(piece: Piece, death: Death, crew: Crew) -> None:
    crew.tell("died", step=piece.step, piece=piece.name, frame=death.frame, reason=death.reason, detail=death.detail)
