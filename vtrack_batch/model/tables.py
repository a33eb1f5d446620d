"""The data dictionary: every table that users hold, its columns, types, units and meaning.

The Parquet schema, the field metadata, the checks before publishing and the reference page all come from here.
A column declared ``nullable`` may be missing (null); all others never are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

ColumnType = Literal["text", "category", "int32", "int64", "float64", "bool", "time", "geometry"]


@dataclass(frozen=True)
class Column:
    """One column: its name carries the unit; ``unit`` repeats it for machines, ``-`` means none."""

    name: str
    type: ColumnType
    unit: str
    meaning: str
    nullable: bool = False


@dataclass(frozen=True)
class Table:
    """A declared table: one fact a row, rows unique by and sorted by ``key``."""

    name: str
    meaning: str
    key: tuple[str, ...]
    columns: tuple[Column, ...]
    partitioned: bool = True
    """Whether the table's folder is divided by local date."""
    version: int = 1

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of the columns in their declared order."""
        return tuple(column.name for column in self.columns)


class DataDictionary(Mapping[str, Table]):
    """All tables by name, in the order in which they come about."""

    def __init__(self, tables: tuple[Table, ...]) -> None:
        self._tables = {table.name: table for table in tables}

    def __getitem__(self, name: str) -> Table:
        return self._tables[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)


def _matrix(letter: str, meaning: str, nullable: bool = False) -> tuple[Column, ...]:
    return tuple(
        Column(f"{letter}{i}{j}", "float64", "-", f"{meaning}, row {i}, column {j}", nullable)
        for i in (1, 2, 3)
        for j in (1, 2, 3)
    )


def _interval(name: str, meaning: str) -> tuple[Column, ...]:
    return (
        Column(f"{name}_lo", "float64", "-", f"lower end of the 95 % interval of {meaning}", True),
        Column(f"{name}_hi", "float64", "-", f"upper end of the 95 % interval of {meaning}", True),
    )


_SEQUENCE = Column("sequence", "category", "-", "unbroken run of one platform")
_T = Column("t_utc", "time", "UTC", "when the frame was taken")
_X = Column("x_m", "float64", "m", "ground coordinate: easting, or right in the local frame")
_Y = Column("y_m", "float64", "m", "ground coordinate: northing, or up in the local frame")
_VEHICLE = Column("vehicle_id", "text", "-", "the vehicle; stable across runs")
_CLASS = Column("vehicle_class", "category", "-", "car, van, lorry, bus, unknown; or all")
_BIN = (
    Column("bin_start_utc", "time", "UTC", "start of the time bin, aligned to the local clock"),
    Column("bin_s", "int32", "s", "length of the time bin"),
)
_OBSERVED = Column("observed_s", "float64", "s", "seconds of the bin during which the place was in view")
_STATUS = Column("status", "category", "-", "observed, partial, not_observed")
_PLACE = Column("place", "category", "-", "id of a gate, zone, approach or lane")
_SPEED_SIGMA = Column("speed_sigma_mps", "float64", "m/s", "standard error of the speed", True)

TABLES = DataDictionary(
    (
        Table(
            "frames",
            "Every frame that the archive holds and whose time is known.",
            ("frame_id",),
            (
                Column("frame_id", "text", "-", "the frame; made from its path"),
                _SEQUENCE,
                Column("path", "text", "-", "path below the archive's root, odd characters escaped"),
                _T,
                Column("width_px", "int32", "px", "width as stored", True),
                Column("height_px", "int32", "px", "height as stored", True),
                Column("sha256", "text", "-", "hash of the file's bytes", True),
                Column("status", "category", "-", "used or quarantined"),
                Column("reason", "category", "-", "why it was quarantined", True),
            ),
        ),
        Table(
            "registrations",
            "Where each decoded frame lies on its block's reference frame.",
            ("frame_id",),
            (
                Column("frame_id", "text", "-", "the frame"),
                Column("reference_frame_id", "text", "-", "the block's reference frame"),
                *_matrix("h", "homography, frame px to reference px", True),
                Column("inliers", "int32", "-", "patches that agree with the homography"),
                Column("residual_px", "float64", "px", "robust RMS residual at patches not used in the fit", True),
                Column("residual_m", "float64", "m", "the same on the ground", True),
                Column("accepted", "bool", "-", "whether the frame was used"),
            ),
        ),
        Table(
            "references",
            "Where each block's reference frame lies on the ground.",
            ("reference_frame_id",),
            (
                Column("reference_frame_id", "text", "-", "the reference frame of a block"),
                *_matrix("g", "homography, reference px to ground m"),
                Column("method", "category", "-", "scale, control_points, world_file, geotiff"),
                Column("residual_m", "float64", "m", "RMS residual of the control points, or of joining", True),
                Column("crs", "category", "-", "authority and code; null = local metres", True),
            ),
        ),
        Table(
            "detections",
            "Vehicles seen in single frames.",
            ("detection_id",),
            (
                Column("detection_id", "text", "-", "the detection"),
                Column("frame_id", "text", "-", "the frame"),
                _SEQUENCE,
                _T,
                Column("col_px", "float64", "px", "centre in the frame, to the right; 0 = centre of the first pixel"),
                Column("row_px", "float64", "px", "centre in the frame, downwards"),
                _X,
                _Y,
                Column(
                    "vx_mps", "float64", "m/s", "measured motion, eastward; null unless the method measures it", True
                ),
                Column(
                    "vy_mps", "float64", "m/s", "measured motion, northward; null unless the method measures it", True
                ),
                Column("length_m", "float64", "m", "length of the oriented box"),
                Column("width_m", "float64", "m", "width of the oriented box"),
                Column("heading_deg", "float64", "deg", "axis of the box, 0-180 clockwise from grid north"),
                Column("area_m2", "float64", "m2", "foreground area inside the box"),
                Column("red", "float64", "0-255", "mean paint colour"),
                Column("green", "float64", "0-255", "mean paint colour"),
                Column("blue", "float64", "0-255", "mean paint colour"),
                Column("contrast", "float64", "0-255", "mean colour distance to the background inside the box"),
                Column("source", "category", "-", "what found it: background, colour, both"),
                Column("flags", "int32", "-", "bits of DetectionFlag"),
            ),
        ),
        Table(
            "matches",
            "Links between detections of successive sightings; one side null = appeared or disappeared.",
            ("match_id",),
            (
                Column("match_id", "text", "-", "the link: ids of both detections"),
                _SEQUENCE,
                Column("t_from_utc", "time", "UTC", "time of the earlier frame"),
                Column("t_to_utc", "time", "UTC", "time of the later frame"),
                Column("detection_id_from", "text", "-", "earlier detection; null = appeared", True),
                Column("detection_id_to", "text", "-", "later detection; null = disappeared", True),
                Column("probability", "float64", "1", "belief in this link", True),
                Column("method", "category", "-", "matching method"),
            ),
        ),
        Table(
            "trajectories",
            "One row per vehicle: its path as a line, where it came from and went to.",
            ("vehicle_id",),
            (
                _VEHICLE,
                _SEQUENCE,
                Column("t_start_utc", "time", "UTC", "first point"),
                Column("t_end_utc", "time", "UTC", "last point"),
                Column("points", "int32", "-", "points of the path, predicted ones included"),
                Column("path_m", "float64", "m", "length of the smoothed path"),
                Column("mean_speed_mps", "float64", "m/s", "path length over time; null for a single point", True),
                Column("length_m", "float64", "m", "median length of the sightings", True),
                Column("width_m", "float64", "m", "median width of the sightings", True),
                Column("vehicle_class", "category", "-", "car, van, lorry, bus, unknown"),
                Column("origin", "category", "-", "zone or gate it came from, or unknown, parked"),
                Column("destination", "category", "-", "zone or gate it went to, or unknown, parked"),
                Column("movement", "category", "-", "movement at the junction it passed; null = none", True),
                Column("start_reason", "category", "-", "entered_view, appeared, parked, start_of_data"),
                Column("end_reason", "category", "-", "left_view, lost, parked, end_of_data"),
                Column("identity_probability", "float64", "1", "belief that all points are one vehicle", True),
                Column("flags", "int32", "-", "bits of TrajectoryFlag"),
                Column("geometry", "geometry", "m", "the path (LineString)"),
            ),
        ),
        Table(
            "track_points",
            "The smoothed state of every vehicle at every frame between its first and last sighting.",
            ("vehicle_id", "t_utc"),
            (
                _VEHICLE,
                _T,
                _X,
                _Y,
                Column("vx_mps", "float64", "m/s", "eastward speed", True),
                Column("vy_mps", "float64", "m/s", "northward speed", True),
                Column("speed_mps", "float64", "m/s", "speed", True),
                _SPEED_SIGMA,
                Column("accel_mps2", "float64", "m/s2", "acceleration along the path", True),
                Column("heading_deg", "float64", "deg", "direction of travel, 0-360 clockwise from grid north", True),
                Column("detection_id", "text", "-", "the sighting; null = predicted or interpolated", True),
                Column("state", "category", "-", "moving, stopped, parked"),
            ),
        ),
        Table(
            "crossings",
            "Moments at which vehicles crossed gates.",
            ("vehicle_id", "gate", "t_utc"),
            (
                _VEHICLE,
                Column("gate", "category", "-", "id of the gate"),
                Column("t_utc", "time", "UTC", "when the path crossed the gate, interpolated"),
                Column(
                    "direction", "category", "-", "forward = from the left to the right of the gate as drawn; backward"
                ),
                Column("speed_mps", "float64", "m/s", "speed at the gate", True),
                _SPEED_SIGMA,
            ),
        ),
        Table(
            "od_pairs",
            "Vehicles from each origin to each destination, by time of start.",
            ("origin", "destination", "vehicle_class", "bin_start_utc", "bin_s"),
            (
                Column("origin", "category", "-", "zone or gate; or unknown, parked"),
                Column("destination", "category", "-", "zone or gate; or unknown, parked"),
                _CLASS,
                *_BIN,
                Column("count", "float64", "veh", "expected number of vehicles; null = not observed", True),
                *_interval("count", "the count"),
                _OBSERVED,
                _STATUS,
                Column("median_travel_time_s", "float64", "s", "median time from origin to destination", True),
            ),
        ),
        Table(
            "turns",
            "Turning movements at junctions, by time of entering.",
            ("junction", "approach", "movement", "vehicle_class", "bin_start_utc", "bin_s"),
            (
                Column("junction", "category", "-", "id of the junction"),
                Column("approach", "category", "-", "id of the approach it entered by"),
                Column(
                    "movement",
                    "category",
                    "-",
                    "left, through, right, u_turn; exit:<id> where arms are ambiguous; or unknown",
                ),
                _CLASS,
                *_BIN,
                Column("count", "float64", "veh", "expected number of vehicles; null = not observed", True),
                *_interval("count", "the count"),
                Column(
                    "share",
                    "float64",
                    "1",
                    "share of the approach's vehicles whose movement is known; null where there were none",
                    True,
                ),
                *_interval("share", "the share"),
                Column("rate_vph", "float64", "veh/h", "count over observed time", True),
                _OBSERVED,
                _STATUS,
            ),
        ),
        Table(
            "speeds",
            "Speeds by place and time: at gates of crossing vehicles, in areas of all points.",
            ("place", "bin_start_utc", "bin_s"),
            (
                _PLACE,
                *_BIN,
                Column("vehicles", "int32", "veh", "vehicles measured; null = not observed", True),
                Column("time_mean_mps", "float64", "m/s", "arithmetic mean over vehicles", True),
                Column(
                    "space_mean_mps",
                    "float64",
                    "m/s",
                    "harmonic at a gate; total distance over total time in an area",
                    True,
                ),
                Column("p15_mps", "float64", "m/s", "15th percentile over vehicles", True),
                Column("p50_mps", "float64", "m/s", "median over vehicles", True),
                Column("p85_mps", "float64", "m/s", "85th percentile over vehicles", True),
                Column("standard_error_mps", "float64", "m/s", "standard error of the time mean", True),
                _OBSERVED,
                _STATUS,
            ),
        ),
        Table(
            "flows",
            "Flow, density and space-mean speed by place and time (Edie's definitions).",
            ("place", "vehicle_class", "bin_start_utc", "bin_s"),
            (
                _PLACE,
                _CLASS,
                *_BIN,
                Column("count", "float64", "veh", "vehicles that crossed or visited; null = not observed", True),
                Column(
                    "flow_vph", "float64", "veh/h", "count over observed time at a gate; Edie's flow in an area", True
                ),
                Column("density_vpkm", "float64", "veh/km", "Edie's density; null at a gate", True),
                Column("space_mean_mps", "float64", "m/s", "space-mean speed", True),
                *_interval("count", "the count"),
                _OBSERVED,
                _STATUS,
            ),
        ),
        Table(
            "stops",
            "Where and for how long vehicles stood.",
            ("vehicle_id", "t_start_utc"),
            (
                _VEHICLE,
                Column("t_start_utc", "time", "UTC", "began to stand"),
                Column("t_end_utc", "time", "UTC", "moved on, or was last seen"),
                Column("duration_s", "float64", "s", "how long it stood"),
                Column("place", "category", "-", "approach, lane or zone it stood in", True),
                _X,
                _Y,
                Column("kind", "category", "-", "signal, queue, parked, unknown"),
            ),
        ),
        Table(
            "coverage",
            "What was in view: without it a count of nothing means nothing.",
            ("place", "bin_start_utc", "bin_s"),
            (
                _PLACE,
                *_BIN,
                _OBSERVED,
                Column("frames", "int32", "-", "frames that showed the place"),
                Column("share_visible", "float64", "1", "mean share of the place in view during the bin"),
                Column("completeness", "float64", "1", "share of the vehicles there that the detector finds", True),
                *_interval("completeness", "completeness"),
            ),
        ),
        Table(
            "quarantine",
            "Files that could not be used, and why.",
            ("path",),
            (
                Column("path", "text", "-", "path below the archive's root, odd characters escaped"),
                Column("reason", "category", "-", "a short word"),
                Column("detail", "text", "-", "a sentence", True),
            ),
            partitioned=False,
        ),
    )
)
