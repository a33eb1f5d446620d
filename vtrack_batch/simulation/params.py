"""What a simulated survey is: scene, traffic, platform, light and camera."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Literal

from pydantic import AwareDatetime, Field

from vtrack_batch.model.params import Params


class Scenario(Params):
    """A whole simulated archive; the defaults are the demonstration: 140 frames of a busy signalised crossing."""

    scene: Literal["crossing", "street"] = Field(
        "crossing", description="crossing = four arms with signals and turns; street = one straight two-way road."
    )
    seed: int = Field(20260517, ge=0, description="Everything random comes from this number.")
    start: AwareDatetime = Field(datetime(2026, 5, 17, 6, tzinfo=UTC), description="Time of the first frame.")
    time_zone: str = Field("Europe/Berlin", min_length=1, description="IANA zone written into the survey file.")
    duration_s: float = Field(210.0, gt=0, description="Length of the archive.")
    interval_s: float = Field(1.5, ge=0.02, le=60, description="Time between frames.")
    frames: bool = Field(True, description="Whether to render the frames; false writes the truth alone.")

    width_px: int = Field(1920, ge=64, le=20000, description="Width of the frames; an orthophoto sets its own.")
    height_px: int = Field(1080, ge=64, le=20000, description="Height of the frames; an orthophoto sets its own.")
    gsd_m: float = Field(0.33, gt=0.02, lt=2, description="Ground sampling distance; an orthophoto sets its own.")
    azimuth_deg: float = Field(6.0, ge=-45, le=45, description="Turn of the whole scene, clockwise against the frame.")
    orthophoto: str | None = Field(
        None, description="GeoTIFF in a projected CRS that serves as the ground; frames are then written as GeoTIFF."
    )
    street_px: tuple[tuple[float, float], tuple[float, float]] | None = Field(
        None, description="Ends (col, row) of the street's axis in the reference frame; null = across the middle."
    )

    demand_vph: float = Field(850.0, ge=0, le=4000, description="Vehicles per hour that come in by each arm.")
    left_share: float = Field(0.147, ge=0, le=0.5, description="Share of the vehicles that turn left.")
    right_share: float = Field(0.160, ge=0, le=0.5, description="Share of the vehicles that turn right.")
    speed_limit_mps: float = Field(15.3, gt=1, le=50, description="Speed that drivers keep to, give or take.")
    green_through_s: float = Field(20.0, gt=0, description="Green of the two opposite through and right streams.")
    green_left_s: float = Field(7.0, gt=0, description="Green of the two opposite left-turning streams.")
    amber_s: float = Field(3.0, gt=0, description="Amber after each green.")
    all_red_s: float = Field(1.0, ge=0, description="Red for all after each amber; green waits until the box is clear.")
    warm_up_s: float = Field(240.0, ge=0, description="Traffic simulated before the first frame.")
    parked: int = Field(70, ge=0, le=2000, description="Parked cars beside the roads and on lots.")

    drift_px: float = Field(24.0, ge=0, le=500, description="Amplitude of the platform's slow drift.")
    jitter_px: float = Field(1.2, ge=0, le=50, description="Standard deviation of the frame-to-frame jitter per axis.")
    rotation_deg: float = Field(0.6, ge=0, le=20, description="Amplitude of the slow rotation; none on an orthophoto.")
    perspective_per_px: float = Field(
        3e-7, ge=0, le=1e-4, description="Amplitude of the perspective terms; none on an orthophoto."
    )

    shadow: bool = Field(True, description="Whether things cast shadows.")
    sun_azimuth_deg: float = Field(140.0, ge=0, le=360, description="Where the sun stands, clockwise from grid north.")
    sun_elevation_deg: float = Field(45.0, ge=10, le=90, description="Height of the sun above the horizon.")
    exposure_drift: float = Field(0.06, ge=0, le=0.5, description="Amplitude of the exposure's drift, as a share.")
    cloud: float = Field(0.07, ge=0, le=0.5, description="Spread of the drifting soft cloud shade, as a share.")
    blur_px: float = Field(0.5, ge=0, le=3, description="Standard deviation of the camera's point spread.")
    noise_dn: float = Field(2.5, ge=0, le=30, description="Standard deviation of the sensor's noise, of 255.")
    appearance_gain: float = Field(0.03, ge=0, le=0.3, description="Spread of brightness between sightings.")
    jpeg_quality: int = Field(90, ge=30, le=100, description="Quality of the JPEG frames.")

    @property
    def frame_count(self) -> int:
        """Number of frames in the archive, at least one."""
        return max(1, int(self.duration_s / self.interval_s + 1e-9))
