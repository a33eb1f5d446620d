"""What counts as found, moving, dark; and how the intervals are made."""

from __future__ import annotations

from pydantic import Field

from vtrack_batch.model.params import Params


class EvaluationParams(Params):
    """Gates, strata and intervals of an evaluation; the defaults are those of the independent scorers."""

    gate_px: float = Field(
        5.0, gt=0, description="largest distance of a sighting from the true centre, where the truth has no boxes"
    )
    gate_m: float = Field(
        2.0, gt=0, description="the same on the ground, where one side knows no pixels and no vehicle lengths"
    )
    gate_share_of_length: float = Field(
        0.5, gt=0, le=2, description="the same as a share of the true box's longer side, where it has"
    )
    parked_gate_factor: float = Field(
        2.0, ge=1, le=10, description="a sighting within this many gates of a parked car is on it"
    )
    border_px: float = Field(
        12.0, ge=0, description="sightings nearer to the frame's border are neither right nor wrong"
    )
    moving_mps: float = Field(1.0, ge=0, description="a true vehicle faster than this is moving")
    standing_s: float = Field(20.0, ge=0, description="a true vehicle that has stood for longer is standing")
    touching_gap_m: float = Field(2.2, gt=0, description="a vehicle whose body is nearer to another's is touching")
    dark_below: float = Field(60.0, ge=0, le=255, description="mean luminance below which a vehicle is dark")
    grey_from: float = Field(90.0, ge=0, le=255, description="least mean luminance of a vehicle as grey as the road")
    grey_to: float = Field(125.0, ge=0, le=255, description="largest mean luminance of a vehicle as grey as the road")
    moving_net_shift_m: float = Field(
        2.5, ge=0, description="a found track moves when its ends lie farther apart than this"
    )
    least_sightings: int = Field(4, ge=2, description="vehicles seen less often are left out of the end-to-end shares")
    least_probability: float = Field(
        0.02, ge=0, lt=1, description="calibration leaves out links that are stated to be less probable"
    )
    block_s: float = Field(20.0, gt=0, description="length of the time blocks that intervals are drawn over")
    least_blocks: int = Field(5, ge=2, description="short clips are cut into this many blocks, however short they get")
    resamples: int = Field(1000, ge=100, le=100_000, description="draws behind each interval")
    seed: int = Field(1, ge=0, description="seed of the draws")
