"""Parameters of the completeness by injection."""

from __future__ import annotations

from pydantic import Field

from vtrack_batch.model.params import Params


class CompletenessParams(Params):
    """How many known vehicles are painted into the frames, to count how many are found again."""

    injections_per_unit: int = Field(
        0,
        ge=0,
        le=100_000,
        description="vehicles painted into copies of each block's background samples; 0 = none, completeness is null",
    )
    seed: int = Field(0, ge=0, description="chooses which vehicles are painted where")
    gate_m: float = Field(1.65, gt=0, description="a vehicle counts as found if a box lies this near to its centre")
    near_gate_m: float = Field(15.0, gt=0, description="vehicles this near to a gate speak for it")
    stand_s: float = Field(4.0, gt=0, description="what stays at one place for so long stands")
    stay_share: float = Field(
        0.5, ge=0, le=1, description="share of the standing vehicles that are painted over by others"
    )
    crowd_share: float = Field(
        0.3, gt=0, le=1, description="most moving vehicles painted into a frame, as a share of those seen in it"
    )
