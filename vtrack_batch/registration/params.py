"""Parameters of registration: how a frame is laid on its block's reference frame, and when that is believed."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from vtrack_batch.model.params import Params


class RegistrationParams(Params):
    """Knobs of `register` and `prepare_reference`.

    Lengths are pixels of the frame, because the limits are those of measuring in an image: how well a small patch can
    be located, how far its place can be mispredicted. None of them needs to change with the ground sampling distance.
    """

    patches: int = Field(500, ge=40, le=5000, description="full-resolution patches spread over the reference frame")
    steady_share: float = Field(
        0.33, gt=0.0, le=1.0, description="share of the patches that is kept: the steadiest over the block's samples"
    )
    held_out_share: float = Field(
        0.25, ge=0.1, le=0.5, description="share of the patches that are kept out of the fit and measure its residual"
    )
    patch_px: int = Field(25, ge=11, le=127, description="side of a patch; an even number is rounded up to an odd one")
    search_px: int = Field(12, ge=4, le=64, description="how far from its predicted place a patch is looked for")
    min_correlation: float = Field(
        0.6, gt=0.0, lt=1.0, description="normalised cross-correlation from which a patch counts as found"
    )
    coarse_pixels: int = Field(
        130_000, ge=10_000, le=4_000_000, description="size to which frames are reduced for the coarse pose"
    )
    inlier_tolerance_px: float = Field(
        2.0, gt=0.0, le=20.0, description="largest residual of a patch that counts as agreeing with the pose"
    )
    max_residual_px: float = Field(
        6.0, gt=0.0, le=50.0, description="largest robust residual at held-out patches of an accepted frame"
    )
    min_confirmed_share: float = Field(
        0.25, ge=0.0, le=1.0, description="smallest share of visible held-out patches found where the pose puts them"
    )
    min_coverage_share: float = Field(
        0.65, ge=0.0, le=1.0, description="smallest share of the overlap (in cells) that found patches vouch for"
    )
    min_overlap_share: float = Field(
        0.3, ge=0.0, le=1.0, description="smallest share of the reference frame that the frame must show"
    )
    block_overlap_share: float = Field(
        0.6,
        ge=0.0,
        le=1.0,
        description="share of the first frame of a block that its other frames show: where the platform flies on, a "
        "unit is cut into several blocks",
    )
    bend: Literal["auto", "never"] = Field(
        "auto", description="whether frames are straightened where no plane pose fits them (auto), or never"
    )
    bend_from_px: float = Field(
        0.25, gt=0.0, description="residual of plane poses, over a block, above which frames are straightened"
    )
    bend_window_px: int = Field(
        121, ge=24, le=1000, description="side of the window whose median motion counts: twice as large as vehicles"
    )
    max_bend_px: float = Field(4.0, gt=0.0, le=7.9, description="most that any place is moved by straightening")
    min_contrast: float = Field(
        2.0, ge=0.0, le=128.0, description="standard deviation of grey values below which a frame is blank"
    )
    seed: int = Field(20260517, ge=0, le=2**31 - 1, description="seed of the sampling consensus")
