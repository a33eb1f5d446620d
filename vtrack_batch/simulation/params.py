"""What a simulated survey is: where, when, how long, how often; its traffic, its detector and its pictures."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Literal

from pydantic import AwareDatetime, Field, model_validator

from vtrack_batch.model.params import Params
from vtrack_batch.simulation.view_params import CameraParams, GroundParams, LightParams

SceneName = Literal["road", "congested", "crossing", "roundabout", "motorway", "grid", "city", "street"]

DEMAND_VPH = {
    "street": 700.0, "road": 4000.0, "congested": 3900.0, "crossing": 930.0, "roundabout": 400.0, "motorway": 4400.0,
    "grid": 390.0, "city": 640.0, "network": 400.0,
}  # fmt: skip


_DAY_TO_DAY = 7919  # far from the seeds that people take, which follow one another


class DemandParams(Params):
    """Who drives on a built-in scene, or on the user's own network where no routes are given."""

    demand_vph: float | None = Field(
        None, ge=0, le=20000, description="Vehicles per hour that come in by each road; null = as the scene needs."
    )
    left_share: float = Field(0.147, ge=0, le=0.5, description="Share that turns left at the crossing.")
    right_share: float = Field(0.160, ge=0, le=0.5, description="Share that turns right at the crossing.")
    van_share: float = Field(0.08, ge=0, le=0.3, description="Share of vans in the fleet.")
    lorry_share: float = Field(0.08, ge=0, le=0.3, description="Share of lorries in the fleet.")
    bus_share: float = Field(0.02, ge=0, le=0.3, description="Share of buses in the fleet.")
    speed_limit_mps: float | None = Field(
        None, gt=1, le=60, description="Speed limit of the built-in scenes' roads; null = the scene's own."
    )
    speed_spread: float = Field(
        0.15, ge=0, le=0.5, description="Standard deviation of the drivers' wished speed, as a share of the limit."
    )
    sigma: float = Field(0.5, ge=0, le=1, description="SUMO's driver imperfection: how unsteadily a speed is kept.")
    green_through_s: float = Field(20.0, ge=5, description="Crossing: green of two opposite through streams.")
    green_left_s: float = Field(7.0, ge=3, description="Crossing: green of two opposite left-turning streams.")
    amber_s: float = Field(3.0, ge=1, description="Crossing: amber after each green.")
    all_red_s: float = Field(1.0, ge=0, description="Crossing: red for all after each amber.")
    lane_change_s: float = Field(3.0, ge=0, le=10, description="Time that a change of lane takes.")


class DetectorParams(Params):
    """How far the detections of the archive stay behind the truth, as those of a detector would."""

    position_sigma_m: float = Field(0.33, ge=0, le=5, description="Standard deviation of the place per axis.")
    size_sigma: float = Field(0.06, ge=0, le=0.5, description="Standard deviation of length and width, as a share.")
    heading_sigma_deg: float = Field(4.0, ge=0, le=45, description="Standard deviation of the heading.")
    gain_sigma: float = Field(0.04, ge=0, le=0.5, description="Spread of a sighting's brightness, as a share.")
    common_sigma_dn: float = Field(3.0, ge=0, le=60, description="Noise that red, green and blue share, of 255.")
    channel_sigma_dn: float = Field(3.0, ge=0, le=60, description="Noise of each channel, of 255.")
    shadow_share: float = Field(0.02, ge=0, le=1, description="Share of sightings in shadow.")
    shadow_factor: float = Field(0.65, gt=0, le=1, description="What shadow leaves of the brightness.")
    missed: float = Field(0.10, ge=0, le=0.9, description="Share of vehicles missed in a frame.")
    missed_clustered: float = Field(
        0.3, ge=0, le=1, description="Share of the misses that come in clusters: near in place and in time."
    )
    cluster_m: float = Field(20.0, gt=0, le=500, description="Size of the places where misses cluster.")
    cluster_s: float = Field(6.0, gt=0, le=600, description="How long misses cluster at one place.")
    false_per_frame: float = Field(0.5, ge=0, le=1000, description="False alarms in a frame, on average.")
    merge_m: float = Field(
        2.0, ge=0, le=20, description="Vehicles whose centres are closer than this become one detection; 0 = none."
    )


class Scenario(Params):
    """A whole simulated archive; the defaults are 140 frames of a busy signalised crossing."""

    scene: SceneName = Field(
        "crossing",
        description="road = one-way, two lanes; congested = the same behind a slow exit; crossing = four arms with "
        "signals and turns; roundabout; motorway = ramps and a jam; grid = 5 x 5 signals, about 300 vehicles; city = "
        "22 x 22, about 8,000; street = one two-way road, laid onto an orthophoto if there is one.",
    )
    network: str | None = Field(None, description="SUMO network (.net.xml) to use in place of a built-in scene.")
    routes: str | None = Field(
        None, description="SUMO routes (.rou.xml) to drive on that network; null = from every road end to every other."
    )
    centre_m: tuple[float, float] | None = Field(
        None, description="Point (x, y) of the network in the middle of the view; null = the middle of its junctions."
    )
    seed: int = Field(20260517, ge=0, lt=2**31, description="Everything random comes from this number.")
    start: AwareDatetime = Field(datetime(2026, 5, 17, 6, tzinfo=UTC), description="Time of the first frame.")
    time_zone: str = Field("Europe/Berlin", min_length=1, description="IANA zone written into the survey file.")
    duration_s: float = Field(210.0, gt=0, description="Length of the archive, or of each of its days.")
    days: int = Field(
        1,
        ge=1,
        le=366,
        description="Successive days that are filmed: the same place and hour, other traffic and flights.",
    )
    warm_up_s: float = Field(240.0, ge=0, description="Traffic simulated before the first frame.")
    interval_s: float = Field(1.5, ge=0.02, le=60, description="Time between frames.")
    frames: bool = Field(True, description="Whether to render the frames; false writes truth and detections alone.")
    traffic: DemandParams = Field(DemandParams(), description="Who drives, and how.")
    detector: DetectorParams = Field(DetectorParams(), description="Noise of detections.parquet.")
    camera: CameraParams = Field(CameraParams(), description="Frames and platform.")
    ground: GroundParams = Field(GroundParams(), description="What lies and stands below.")
    light: LightParams = Field(LightParams(), description="Sun, clouds and exposure.")

    @model_validator(mode="after")
    def _fits(self) -> Scenario:
        if self.network is None and (self.routes is not None or self.centre_m is not None):
            raise ValueError("routes and centre_m belong to a network of your own: name it as `network`")
        return self

    def on_day(self, day: int) -> Scenario:
        """Return the scenario of the one day that is so many after the first: other traffic, flight and noise."""
        seed = (self.seed + day * _DAY_TO_DAY) % 2**31
        return self.model_copy(update={"seed": seed, "start": self.start + timedelta(days=day), "days": 1})

    @property
    def frame_count(self) -> int:
        """Number of frames of a day, at least one."""
        return max(1, int(self.duration_s / self.interval_s + 1e-9))

    @property
    def demand_vph(self) -> float:
        """Vehicles per hour that come in by each road."""
        return DEMAND_VPH[self.name] if self.traffic.demand_vph is None else self.traffic.demand_vph

    @property
    def name(self) -> str:
        """Name of the scene, as it stands in file names."""
        return self.scene if self.network is None else "network"
