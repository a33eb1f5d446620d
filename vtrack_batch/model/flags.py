"""Quality flags: doubt travels with the row. One bit each, declared once; docs and decoders come from here."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag


class DetectionFlag(IntFlag):
    """Doubts about a detection."""

    TOUCHES_BORDER = 1
    NEAR_UNSEEN = 2
    SHADOWED = 8
    OUTSIDE_ROAD = 16
    HELD = 32
    IN_BACKGROUND = 64


class TrajectoryFlag(IntFlag):
    """Doubts about a trajectory."""

    IMPLAUSIBLE_SPEED = 1
    FEW_POINTS = 2
    BRIDGED_GAP = 4
    SIZE_UNSTEADY = 8


@dataclass(frozen=True)
class FlagText:
    """What a bit means, for people."""

    name: str
    bit: int
    meaning: str


_MEANING: dict[str, str] = {
    "TOUCHES_BORDER": "the box reaches over the frame's border: size and centre are doubtful",
    "NEAR_UNSEEN": "beside ground that no background sample saw",
    "SHADOWED": "in cloud or building shadow: colour is doubtful",
    "OUTSIDE_ROAD": "outside the road learned from moving vehicles",
    "HELD": "the vehicle stands: size, axis or place of this sighting was off, and is that of the others",
    "IN_BACKGROUND": "stands in the background picture: found by its looks, not by a difference from the ground",
    "IMPLAUSIBLE_SPEED": "faster, or accelerating harder, than the stated limits at some point",
    "FEW_POINTS": "fewer sightings than a speed can be trusted on",
    "BRIDGED_GAP": "holds points that were predicted over misses",
    "SIZE_UNSTEADY": "sizes of its sightings disagree: perhaps two vehicles",
}


def legend(kind: type[IntFlag]) -> list[FlagText]:
    """Return the bits of *kind* with their meaning, lowest bit first."""
    return [FlagText(str(bit.name).lower(), int(bit), _MEANING[str(bit.name)]) for bit in kind]
