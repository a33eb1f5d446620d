"""Parameters of the traffic chapter: time bins, thresholds and the sizes that proposed zones take."""

from __future__ import annotations

from pydantic import Field

from vtrack_batch.model.params import Params


class ProposalParams(Params):
    """How zones are proposed where none are drawn."""

    min_trip_m: float = Field(15.0, gt=0, description="net way a vehicle must go before its ends count")
    steady_share: float = Field(
        0.5, gt=0, description="a platform is over one place if its view moves by at most this share of its size"
    )
    link_m: float = Field(20.0, gt=0, description="ends closer than this along the border of the view belong together")
    min_vehicles: int = Field(2, ge=1, description="fewest ends that make a zone")
    min_share: float = Field(0.01, ge=0, lt=1, description="smallest share of all ends that makes a zone")
    depth_m: float = Field(40.0, gt=0, description="how far a proposed zone reaches into the view at most")
    margin_m: float = Field(5.0, gt=0, description="how far a proposed zone reaches beyond its ends")
    border_m: float = Field(80.0, gt=0, description="ends farther from the border ahead count where they are, or")
    border_steps: float = Field(3.0, gt=0, description="frame intervals that the border may be ahead even if farther")
    junction_m: float = Field(40.0, gt=0, description="radius within which most paths must meet to make one junction")
    meet_m: float = Field(3.0, gt=0, description="paths of different zones closer than this make a junction")


class TrafficParams(Params):
    """How trajectories become counts, speeds, flows and stops."""

    bin_s: int = Field(900, gt=0, le=86400, description="length of the time bins, aligned to the local clock")
    observed_share: float = Field(
        0.9, gt=0, le=1, description="share of a bin that must be observed for the status observed; less is partial"
    )
    min_share_visible: float = Field(
        0.5,
        gt=0,
        le=1,
        description="share of a gate, or of the part of an area that is ever seen, that counts as in view",
    )
    max_gap_s: float = Field(10.0, gt=0, description="longest time that a frame speaks for after it was taken")
    stop_speed_mps: float = Field(0.8, gt=0, description="slower than this is standing")
    stop_min_s: float = Field(4.0, ge=0, description="shortest stand that is a stop")
    queue_gap_m: float = Field(12.0, gt=0, description="longest distance, centre to centre, to the leader in a queue")
    max_speed_mps: float = Field(70.0, gt=0, description="faster is implausible and stays out of the speed statistics")
    hysteresis_m: float = Field(
        1.5, ge=0, description="a path must go this far beyond a gate or border before coming back counts"
    )
    extend_steps: float = Field(
        1.0,
        ge=0,
        le=3,
        description="frame intervals by which a path that entered or left the view is prolonged to its zone or gate",
    )
    lane_width_m: float = Field(3.5, gt=0, description="width of a lane drawn as a line without width_m")
    approach_width_m: float = Field(15.0, gt=0, description="width of an approach drawn along its road without width_m")
    proposal: ProposalParams = Field(ProposalParams(), description="zones where none are drawn")
