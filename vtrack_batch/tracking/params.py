"""Parameters of tracking, in metres and seconds; they serve 0.25-10 Hz."""

from __future__ import annotations

from pydantic import Field

from vtrack_batch.model.params import Params


class MotionParams(Params):
    """How vehicles move between sightings, and how well a sighting places them."""

    position_sigma_m: float = Field(0.4, gt=0, description="spread of a detection's centre, per axis")
    jerkiness: float = Field(1.2, gt=0, description="[q] spectral density of acceleration, m2/s3, of ordinary driving")
    rough_factor: float = Field(10.0, gt=1, description="q of hard braking and sharp turns, as a multiple")
    rough_share: float = Field(0.15, gt=0, lt=1, description="share of intervals with such driving")
    speed_sigma_mps: float = Field(10.0, gt=0, description="spread of unknown velocities, per axis")
    max_speed_mps: float = Field(50.0, gt=0, description="nothing on a road is faster")


class LinkParams(Params):
    """How sightings become chains."""

    coast_s: float = Field(9.0, ge=0, description="a vehicle may stay unseen for this long")
    coast_frames: int = Field(2, ge=0, description="but always for this many frames")
    gate_sigmas: float = Field(4.0, gt=0, description="partners are sought within this many standard deviations")
    missed_share: float = Field(0.15, gt=0, lt=1, description="prior share of sightings that the detector misses")
    break_share: float = Field(0.05, gt=0, lt=1, description="prior share of sightings that begin, or end, a track")
    sure: float = Field(0.9999, gt=0, lt=1, description="a link of this probability is not asked to compete with gaps")
    self_taught: bool = Field(True, description="where no flow map is given, a sequence's own sure links make one")
    trust: float = Field(0.995, gt=0, lt=1, description="belief in a chain's own motion, at most")
    rounds: int = Field(3, ge=1, description="rounds of linking, each with the velocities of the one before")
    max_end_accel_mps2: float = Field(
        6.0, gt=0, description="the first and the last link of a chain never ask for more than this, beyond noise"
    )
    memory_sightings: int = Field(8, ge=1, description="mean colours count for at most this many sightings")


class RegionTrackParams(Params):
    """Constants of region tracking (Badenas et al.): constant-jerk filters and the master list."""

    snap_density: float = Field(10.0, gt=0, description="[Q] spectral density of the change of jerk, m2/s7")
    start_speed_mps: float = Field(10.0, gt=0, description="spread of a new region's velocity if none was measured")
    start_accel_mps2: float = Field(1.5, gt=0, description="spread of a new region's acceleration, per axis")
    start_jerk_mps3: float = Field(1.0, gt=0, description="spread of a new region's jerk, per axis")
    speed_sigma_mps: float = Field(1.0, gt=0, description="[R] spread of measured velocities, per axis")
    grey_gain: float = Field(0.3, gt=0, le=1, description="share of the newest grey in the running mean")
    clamp_sigmas: float = Field(2.0, gt=0, description="measurements count as off by at most this")
    gate_sigmas: float = Field(5.0, gt=0, description="[epsilon] partners are sought within this of the prediction")
    gate_max_m: float = Field(60.0, gt=0, description="[epsilon] and never farther than this")
    forget_s: float = Field(0.6, ge=0, description="a region unmatched for longer leaves the list")
    forget_frames: int = Field(3, ge=0, description="but never before this many frames")


class WindowParams(Params):
    """How long sequences are divided."""

    window_sightings: int = Field(150_000, ge=1000, description="a longer sequence is linked in windows of this size")
    context_frames: int = Field(24, ge=1, description="frames on both sides of a window that are looked at; or twice "
                                "the time a vehicle may stay unseen, if that is more")  # fmt: skip


class TrackingParams(Params):
    """Parameters of tracking one sequence."""

    motion: MotionParams = Field(MotionParams(), description="motion and measurement")
    link: LinkParams = Field(LinkParams(), description="linking")
    regions: RegionTrackParams = Field(RegionTrackParams(), description="region tracking")
    windows: WindowParams = Field(WindowParams(), description="windows of long sequences")
    min_sightings: int = Field(2, ge=1, description="tracks with fewer sightings are no trajectories")
    few_points: int = Field(4, ge=1, description="tracks with fewer sightings are flagged FEW_POINTS")
    stop_speed_mps: float = Field(0.8, gt=0, description="slower is standing")
    parked_move_m: float = Field(2.5, gt=0, description="a vehicle that never gets farther from where it is, stands")
    parked_s: float = Field(20.0, gt=0, description="a vehicle that stands all its life, at least this long, is parked")
    border_m: float = Field(6.0, ge=0, description="this close to the border, the way it drives, it enters or leaves")
    size_unsteady_share: float = Field(0.35, gt=0, description="lengths off their median by more are flagged")
    max_accel_mps2: float = Field(9.0, gt=0, description="harder acceleration is flagged IMPLAUSIBLE_SPEED")
    car_length_m: float = Field(5.6, gt=0, description="up to this length a vehicle is a car")
    van_length_m: float = Field(7.5, gt=0, description="up to this length it is a van")
    lorry_length_m: float = Field(10.5, gt=0, description="up to this length it is a lorry, beyond a bus or lorry")
    bus_width_m: float = Field(2.4, gt=0, description="the longest are buses if at least this wide, else lorries")
