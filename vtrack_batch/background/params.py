"""Parameters of the background."""

from __future__ import annotations

from pydantic import Field

from vtrack_batch.model.params import Params


class BackgroundParams(Params):
    """How the empty ground is learned from the frames of a block."""

    samples: int = Field(
        31, ge=1, le=255, description="frames, spread over the block, from which the ground is learned"
    )
    fewest_samples: int = Field(
        3, ge=1, description="ground covered by fewer samples counts as unseen (never more than half of the samples)"
    )
    range_share: float = Field(
        0.35, ge=0, description="share of the local 3 x 3 range of grey levels that counts as misregistration"
    )
    spread_factor: float = Field(
        2.5, ge=0, description="tolerance per standard deviation over time of the quiet part of the samples"
    )
    spread_limit_levels: float = Field(20.0, ge=0, description="most that the spread over time adds to the tolerance")
    busy_share: float = Field(
        0.07, gt=0, lt=1, description="share of samples that differ from the median, above which the mode decides"
    )
    calm_window_m: float = Field(
        4.0, gt=0, description="side of the window around a place that is calm where no vehicle is: as long as a car"
    )
    change_levels: float = Field(20.0, gt=0, description="difference in grey levels that counts as a change")
    gain_tile_px: int = Field(
        96, ge=16, description="distance of the nodes of the smooth gain between frames, in pixels"
    )
    shadow_ratio_min: float = Field(0.3, gt=0, lt=1, description="darkest cast shadow, as a ratio to the lit ground")
    shadow_ratio_max: float = Field(0.78, gt=0, lt=1, description="brightest cast shadow, as a ratio to the lit ground")
