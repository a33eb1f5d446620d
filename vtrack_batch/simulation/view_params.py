"""What the pictures of a simulated survey look like: camera and platform, the ground and what stands on it, light."""

from __future__ import annotations

from pydantic import Field

from vtrack_batch.model.params import Params

PointPx = tuple[float, float]


class CameraParams(Params):
    """Frames, and the platform that takes them."""

    width_px: int = Field(1920, ge=64, le=20000, description="Width of the frames; an orthophoto sets its own.")
    height_px: int = Field(1080, ge=64, le=20000, description="Height of the frames; an orthophoto sets its own.")
    gsd_m: float = Field(0.33, gt=0.02, lt=2, description="Ground sampling distance; an orthophoto sets its own.")
    azimuth_deg: float = Field(6.0, ge=-180, le=180, description="Turn of the whole scene, clockwise.")
    drift_px: float = Field(24.0, ge=0, le=500, description="Amplitude of the platform's slow drift over the frame.")
    jitter_px: float = Field(1.2, ge=0, le=50, description="Standard deviation of the frame-to-frame jitter per axis.")
    rotation_deg: float = Field(0.6, ge=0, le=20, description="Amplitude of the slow rotation; none on an orthophoto.")
    scale_drift: float = Field(
        0.004, ge=0, le=0.1, description="Amplitude of the change of scale; none on an orthophoto."
    )
    perspective_per_px: float = Field(
        3e-7, ge=0, le=1e-4, description="Amplitude of the perspective terms; none on an orthophoto."
    )
    altitude_m: float = Field(1500.0, ge=100, le=50000, description="Height of the platform; roofs lean by it.")
    travel_m: float = Field(
        40.0, ge=0, le=5000, description="Amplitude of the platform's own travel, which makes roofs and crowns sway."
    )
    blur_px: float = Field(0.5, ge=0, le=3, description="Standard deviation of the camera's point spread.")
    noise_dn: float = Field(2.5, ge=0, le=30, description="Standard deviation of the sensor's noise, of 255.")
    jpeg_quality: int = Field(90, ge=30, le=100, description="Quality of the JPEG frames.")


class GroundParams(Params):
    """The ground, and what stands, walks and rolls there that is no vehicle of the traffic."""

    orthophoto: str | None = Field(
        None, description="GeoTIFF in a projected CRS that serves as the ground; frames are then written as GeoTIFF."
    )
    background: str | None = Field(
        None,
        description="GeoTIFF that serves as the ground under frames of the camera's own size, with or without a CRS, "
        "for instance the ground mosaic of a published snapshot.",
    )
    street_px: tuple[PointPx, PointPx] | None = Field(
        None, description="Ends (col, row) of the street's axis in the reference frame; null = across the middle."
    )
    parked: int = Field(70, ge=0, le=20000, description="Parked cars beside the roads and on lots.")
    buildings_per_ha: float = Field(9.0, ge=0, le=60, description="Buildings tried per hectare of land.")
    trees_per_ha: float = Field(30.0, ge=0, le=300, description="Trees tried per hectare of land.")
    street_trees_per_km: float = Field(
        12.0, ge=0, le=300, description="Trees beside the carriageway per kilometre of kerb; their crowns hang over it."
    )
    sway_m: float = Field(0.12, ge=0, le=2, description="Standard deviation of a crown's sway between frames.")
    bridges: int = Field(0, ge=0, le=100, description="Footbridges over the roads; they hide what drives below.")
    pedestrians_per_km: float = Field(20.0, ge=0, le=2000, description="People walking, per kilometre of pavement.")
    tram: tuple[PointPx, ...] | None = Field(
        None, description="Line (col, row) in the reference frame that a tram keeps to; null = no tram."
    )
    tram_every_s: float = Field(180.0, gt=0, description="Time between trams on that line.")


class LightParams(Params):
    """Sun, clouds and exposure."""

    shadow: bool = Field(True, description="Whether things cast shadows.")
    sun_azimuth_deg: float = Field(140.0, ge=0, le=360, description="Where the sun stands, clockwise from grid north.")
    sun_elevation_deg: float = Field(45.0, ge=10, le=90, description="Height of the sun above the horizon.")
    exposure_drift: float = Field(0.06, ge=0, le=0.5, description="Amplitude of the exposure's drift, as a share.")
    cloud: float = Field(0.07, ge=0, le=0.5, description="Spread of the drifting soft cloud shade, as a share.")
    haze: float = Field(0.08, ge=0, le=0.6, description="Share of the light that comes from the air in between.")
    appearance_gain: float = Field(0.03, ge=0, le=0.3, description="Spread of brightness between sightings.")
