"""The flow map of a place: how vehicles move where, as a sample of motions; learned without truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.candidates import Array
from vtrack_batch.matching.local_flow import LocalFlow, Motions

FORMAT = "vtrack-batch flow map 1: xy_m, velocity_mps"


@dataclass(frozen=True)
class FlowMap:
    """Motions seen at a place: ``xy`` (n, 2) metres, ``velocity`` (n, 2) m/s, the mean over one interval from there.

    ``spread_mps`` is how far the motions of vehicles at one place differ from those of others, times the interval, and
    ``spread_min_m`` the least spread of displacements.
    """

    xy: Array
    velocity: Array
    spread_mps: float = 1.5
    spread_min_m: float = 0.8

    def at(self, earlier_xy: Array, later_xy: Array, elapsed_s: float) -> LocalFlow | None:
        """Return what the map says between places (n, 2) of one moment and (m, 2), *elapsed_s* later; None if empty."""
        if not len(self.xy):
            return None
        if self._kept.get("elapsed_s") != elapsed_s:
            ends = self.xy + self.velocity * elapsed_s
            self._kept.update(elapsed_s=elapsed_s, starting=Motions.of(self.xy, ends), ending=Motions.of(ends, self.xy))
        spread_m = max(self.spread_mps * elapsed_s, self.spread_min_m)
        return LocalFlow(
            self._kept["starting"], self._kept["ending"], earlier_xy, later_xy, elapsed_s=elapsed_s, spread_m=spread_m
        )

    @cached_property
    def _kept(self) -> dict[str, Any]:
        """Motions sorted by where they start and end, of one interval."""
        return {}

    def save(self, path: str | Path) -> None:
        """Write the map to one file, numpy's npz; the same map gives the same bytes."""
        with Path(path).open("wb") as file:
            np.savez_compressed(file, format=np.array(FORMAT), xy_m=self.xy, velocity_mps=self.velocity)

    @classmethod
    def load(cls, path: str | Path) -> FlowMap:
        """Read a map that ``save`` wrote; another file raises ``UnusableData``."""
        try:
            with np.load(Path(path), allow_pickle=False) as file:
                found, xy, velocity = str(file["format"]), file["xy_m"], file["velocity_mps"]
        except (BadZipFile, EOFError, KeyError, ValueError, TypeError, AttributeError) as reason:
            raise UnusableData(f"{path} is not a flow map: {reason}") from reason
        if found != FORMAT:
            raise UnusableData(f"{path} holds {found!r}; this version reads {FORMAT!r}")
        if not (xy.ndim == 2 and xy.shape[1:] == (2,) and xy.shape == velocity.shape):
            raise UnusableData(f"{path}: places {xy.shape} and velocities {velocity.shape} should be (n, 2) alike")
        if not (np.isfinite(xy).all() and np.isfinite(velocity).all()):
            raise UnusableData(f"{path} holds values that are not finite")
        return cls(xy, velocity)
