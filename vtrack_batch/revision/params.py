"""Parameters of the revision."""

from __future__ import annotations

from pydantic import Field

from vtrack_batch.model.params import Params


class RevisionParams(Params):
    """What a first tracking tells about the detections, before they are tracked again."""

    revise: bool = Field(True, description="whether detections are revised and tracked a second time")
    still_m: float = Field(2.0, gt=0, description="what never gets farther than this from its middle never moves")
    pierced_by: int = Field(
        2, ge=1, description="something still that so many vehicles drive through while it is there is a ghost"
    )
    pierced_share: float = Field(
        0.6, gt=0, le=1, description="part of its length and width that must be driven through"
    )
    part_gap_s: float = Field(
        0.25, gt=0, le=0.5, description="driving boxes that are less than this behind one another are one vehicle's"
    )
    part_across_m: float = Field(1.2, gt=0, description="and are no farther apart across their way")
    part_share: float = Field(0.6, gt=0.5, le=1, description="in this share of the moments that see both drive")
    stand_s: float = Field(3.0, gt=0, description="shortest stand in which shape and place are held")
    jump_m: float = Field(0.6, gt=0, description="a sighting this far from where the vehicle stands is put back there")
    size_share: float = Field(
        0.12, gt=0, description="sizes of standing sightings off the vehicle's own by more are held"
    )
    absent_s: float = Field(90.0, ge=0, description="longest time that a standing vehicle may stay unseen")
    absent_m: float = Field(
        2.5, gt=0, description="it must be seen again within this distance of where it came to stand"
    )
    colour_levels: float = Field(45.0, gt=0, description="and its colour may differ by this, in any channel")
