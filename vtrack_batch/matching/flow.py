"""The flow map of a place: which way, and how fast, vehicles move where; learned without truth."""

from __future__ import annotations

from dataclasses import dataclass

from vtrack_batch.matching.candidates import Array


@dataclass(frozen=True)
class FlowMap:
    trust: float = 0.9

    def log_density(self, xy: Array, displacement: Array, elapsed_s: float) -> Array:
        raise NotImplementedError
