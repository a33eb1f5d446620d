"""Linking of long sequences in windows of time: cost linear, memory bounded by a window and by tracks still open.

A sequence that fits into one window is linked as a whole. Of a longer one each window's core is decided with some
frames of context before and behind it, for links need neither the far past nor the far future; what is decided about
the context is thrown away. A chain is handed on as soon as it has ended and can change no more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.tracking.link import Chains
from vtrack_batch.tracking.params import WindowParams
from vtrack_batch.tracking.paths import chain_numbers
from vtrack_batch.tracking.sightings import Sightings, in_succession, of_frames, picked

Mask = NDArray[np.bool_]


@dataclass
class Held:
    """Sightings whose chains may still change, or that are context; ``chains`` is theirs, ``done`` (n,) handed on."""

    s: Sightings
    chains: Chains
    done: Mask

    @classmethod
    def of(cls, s: Sightings) -> Held:
        """Return the sightings with no links yet."""
        none = np.full(len(s), -1)
        return cls(s, Chains(none, none.copy(), np.ones(len(s)), np.ones(len(s))), np.zeros(len(s), bool))

    def joined(self, run: Sightings) -> Held:
        """Return these sightings with those of the next frames behind them."""
        new, old = Held.of(run), self.chains
        parts = ("after", "before", "probability", "none_before")
        chains = Chains(*(np.concatenate([getattr(old, part), getattr(new.chains, part)]) for part in parts))
        return Held(in_succession(self.s, run), chains, np.concatenate([self.done, new.done]))

    def picked(self, keep: Mask) -> Held:
        """Return some of the sightings; links to others end."""
        number = np.where(keep, np.cumsum(keep) - 1, -1)
        after, before = (
            np.where(linked[keep] >= 0, number[linked[keep]], -1) for linked in (self.chains.after, self.chains.before)
        )
        chains = Chains(after, before, self.chains.probability[keep], self.chains.none_before[keep])
        return Held(picked(self.s, keep), chains, self.done[keep])


def linked_in_windows(
    runs: Iterable[Sightings], link: Callable[[Sightings], Chains], params: WindowParams, coast_s: float
) -> Iterator[tuple[Sightings, Chains]]:
    """Yield whole chains and the sightings they hold, of one sequence that comes in *runs* of successive frames.

    *link* links the sightings of a window; a link may span *coast_s*. Every sighting is in one part, at least one part
    comes. Frames of all parts are counted from the first of the sequence.
    """
    waiting = iter(runs)
    held, core, ended = Held.of(next(waiting)), 0, False
    context = max(params.context_frames, int(np.ceil(2 * coast_s / max(held.s.interval_s, 1e-6) - 1e-6)))
    while True:
        end = core_end(held.s, core, context, params, ended=ended)
        while end is None or (not ended and end + context > len(held.s.frame_s)):
            run = next(waiting, None)
            ended = run is None
            held = held if run is None else held.joined(run)
            end = core_end(held.s, core, context, params, ended=ended)
        low, high = max(core - context, 0), min(end + context, len(held.s.frame_s))
        _decide(held, link(of_frames(held.s, low, high)), low, core, end)
        last = ended and end >= len(held.s.frame_s)
        decided = int(held.s.first[end])
        whole = ~held.done & (np.ones(len(held.s), bool) if last else _whole(held.chains, decided))
        part = held.picked(whole)
        yield part.s, part.chains
        if last:
            return
        held.done |= whole
        held, core = held.picked(~held.done | (held.s.frame >= end - context)), end


def core_end(s: Sightings, core: int, context: int, params: WindowParams, *, ended: bool) -> int | None:
    """Return the frame behind the core that begins at *core*: as many frames as hold the sightings of one window.

    None = not known before more frames come. A short rest of the sequence is not worth a window of its own.
    """
    frames = len(s.frame_s)
    wanted = int(s.first[core]) + params.window_sightings
    end = max(int(np.searchsorted(s.first, wanted)), core + 2 * context)
    if end + 2 * context < frames:
        return end
    return frames if ended else None


def _decide(held: Held, found: Chains, low: int, core: int, end: int) -> None:
    """Take over, in place, what a window beginning at frame *low* says of the frames *core* to *end*."""
    at = int(held.s.first[low])
    rows = slice(int(held.s.first[core]), int(held.s.first[end]))
    seen = slice(rows.start - at, rows.stop - at)
    chains = held.chains
    chains.after[rows] = np.where(found.after[seen] >= 0, found.after[seen] + at, -1)
    chains.probability[rows], chains.none_before[rows] = found.probability[seen], found.none_before[seen]
    # two windows may give a sighting two predecessors: the surer one stays, of equal ones the earlier
    i = np.flatnonzero(chains.after >= 0)
    i = i[np.lexsort((i, -chains.probability[i], chains.after[i]))]
    rival = np.zeros(len(i), bool)
    rival[1:] = np.diff(chains.after[i]) == 0
    chains.after[i[rival]] = -1
    chains.probability[i[rival]] = 1 - chains.probability[i[rival]]
    chains.before[:] = -1
    chains.before[chains.after[i[~rival]]] = i[~rival]


def _whole(chains: Chains, decided: int) -> Mask:
    """Tell which sightings belong to chains that have ended among the first *decided* ones."""
    chain = chain_numbers(chains.before)
    goes_on = np.zeros(len(chain), bool)
    goes_on[chain[chains.after >= decided]] = True
    goes_on[chain[decided:]] = True
    return np.asarray(~goes_on[chain])
