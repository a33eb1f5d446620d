"""Parameters of the detection."""

from __future__ import annotations

from pydantic import Field

from vtrack_batch.model.params import Params


class DetectionParams(Params):
    """How vehicles are found in the difference of a frame from the background."""

    grid_m: float = Field(
        0.29, gt=0, description="finest ground distance worked on; finer frames are reduced to about it"
    )
    threshold_levels: float = Field(12.0, gt=0, description="difference beyond the tolerance that gives half evidence")
    faint_levels: float = Field(
        9.0, gt=0, description="the same for the mean of nine pixels, beside what differs by itself"
    )
    gain_tile_m: float = Field(
        24.0, gt=0, description="distance of the nodes of the smooth gain between frame and ground"
    )
    sizes_m: tuple[tuple[float, float], ...] = Field(
        ((4.4, 1.8), (5.6, 2.1), (7.0, 2.4), (8.5, 2.5), (10.2, 2.5), (12.2, 2.5), (14.5, 2.5), (17.0, 2.6)),
        min_length=1,
        description="length and width of the boxes that are fitted, ascending",
    )
    directions: int = Field(
        12, ge=2, le=60, description="directions of boxes that are tried, evenly spread over 180 degrees"
    )
    lane_frames: int = Field(
        12, ge=0, description="frames of a block that tell which way vehicles lie where; 0 = all directions are tried"
    )
    lane_score: float = Field(0.8, gt=0, le=1.5, description="least score of a box that tells which way vehicles lie")
    lane_reach_m: float = Field(7.0, gt=0, description="how far around a box tells so: a standard deviation")
    lane_votes: float = Field(4.0, gt=0, description="boxes around without which all directions are tried")
    lane_share: float = Field(
        0.1, gt=0, lt=1, description="least share of the boxes around that have a direction which is tried"
    )
    seed_step_m: float = Field(0.6, gt=0, description="distance of the places at which boxes are tried")
    rim_m: float = Field(0.45, gt=0, description="distance from the box of the rim that should be free")
    rim_weight: float = Field(0.7, ge=0, description="what a wholly occupied rim takes from a box's score")
    shadow_evidence: float = Field(0.3, ge=0, le=1, description="weight of shadow-like pixels inside a box")
    shadow_weight: float = Field(0.25, ge=0, description="what a complete cast shadow adds to a box's score")
    shadow_reach_m: float = Field(1.2, gt=0, description="length of cast shadow that is looked for")
    weak_score: float = Field(0.5, gt=0, le=1, description="least score of a candidate on a known road")
    again_score: float = Field(
        0.4,
        gt=0,
        le=1,
        description="least score of a candidate on a known road where a vehicle is due by the frames before and after",
    )
    dark_score: float = Field(
        1.0,
        gt=0,
        le=1.5,
        description="least score of a candidate made of shadow that nothing seems to cast: dark paint",
    )
    strict_score: float = Field(0.60, gt=0, le=1.5, description="least score of a candidate anywhere")
    visible_share: float = Field(
        0.6, gt=0, le=1, description="least share of a box inside the frame and on seen ground"
    )
    cut_length_m: float = Field(
        7.5, gt=0, description="longest box in no chain that may reach over the frame's border: roofs are cut there too"
    )
    chain_score: float = Field(
        0.55, gt=0, le=1.5, description="least score of a candidate in a chain that teaches the road"
    )
    chain_links: int = Field(4, ge=3, description="sightings in a chain that teaches the road")
    chain_interval_s: float = Field(0.5, gt=0, description="least time between sightings of a chain")
    chain_speed_mps: float = Field(3.0, gt=0, description="least speed of a chain")
    slow_chain_links: int = Field(6, ge=3, description="sightings in a chain of slow vehicles that teaches the road")
    slow_chain_speed_mps: float = Field(
        1.5, gt=0, description="least speed of a slow chain: roofs seem to drift slower"
    )
    chain_span_s: float = Field(
        1.5, gt=0, description="least time between first and last of fewer sightings that make a chain"
    )
    slow_chain_span_s: float = Field(2.5, gt=0, description="the same for a chain of slow vehicles")
    short_chain_misfit: float = Field(
        1.0, gt=0, description="largest sum of squared misfits, in parts of their limits, in a chain of fewer sightings"
    )
    short_chain_speed_mps: float = Field(
        9.0, gt=0, description="least speed of a chain of three sightings that span less time"
    )
    fastest_mps: float = Field(60.0, gt=0, description="highest speed of a chain")
    chain_miss_m: float = Field(1.0, gt=0, description="most that a sighting may miss its chain by, sideways")
    chain_accel_mps2: float = Field(2.5, ge=0, description="acceleration that a chain may show")
    chain_colour: float = Field(90.0, gt=0, description="largest difference of colour within a chain, in levels")
    clutter_share: float = Field(
        0.4, ge=0, le=1, description="share of strict candidates off the road above which they are roofs, not traffic"
    )
    chain_support: float = Field(
        0.3, ge=0, le=1, description="least share of chained ones in all that moves or stands along a chain"
    )
    fewest_chains: int = Field(5, ge=1, description="chains without which a road is not believed")
    road_reach_m: float = Field(3.0, gt=0, description="how far the road reaches to both sides of a chain")
    road_ahead_m: float = Field(20.0, ge=0, description="how far the road goes on straight before and after a chain")
    standing: bool = Field(
        True, description="whether vehicles are looked for that stand in the background picture: parked, or queued long"
    )
    standing_score: float = Field(
        0.45,
        gt=-1,
        lt=2,
        description="least likeness of a standing vehicle to moving ones: 1 = usual, -1 = that of any place",
    )
    standing_reach_m: float = Field(8.0, ge=0, description="how far from the road standing vehicles are looked for")
    example_score: float = Field(
        0.75, gt=0, le=1.5, description="least score of a moving vehicle that teaches what vehicles look like"
    )
    fewest_examples: int = Field(
        40, ge=2, description="sightings of moving vehicles without which standing ones are not looked for"
    )

    def alone(self) -> DetectionParams:
        """Return the same for frames of which no neighbours are seen: nothing is due there."""
        return self.model_copy(update={"again_score": self.weak_score})
