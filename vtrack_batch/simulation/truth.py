"""The truth of what is in view, in the tables of the data dictionary: no more than a perfect observer could know."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from vtrack_batch.model.flags import DetectionFlag
from vtrack_batch.model.homography import Array, apply
from vtrack_batch.model.ids import detection_id, frame_id
from vtrack_batch.simulation.counts import od_table, turn_table
from vtrack_batch.simulation.fleet import KINDS, Fleet
from vtrack_batch.simulation.flight import Flight
from vtrack_batch.simulation.network import Network
from vtrack_batch.simulation.paint import mean_colours
from vtrack_batch.simulation.stage import Stage, compass_deg, directions
from vtrack_batch.simulation.traffic import STANDING_MPS, States

LUMA = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True)
class World:
    """All that happened: what the truth is written from. ``paths`` and ``t_utc`` (frames,) name and date the frames."""

    network: Network
    fleet: Fleet
    states: States
    stage: Stage
    flight: Flight
    paths: list[str]
    t_utc: pd.DatetimeIndex
    sequence: str
    time_zone: str


@dataclass(frozen=True)
class Sightings:
    """Vehicles whose centre lies in a frame: ``row`` (n,) into the states, ``px`` (n, 2), colours (n, 3) as painted."""

    row: NDArray[np.int64]
    px: Array
    rgb: Array
    ground_rgb: Array
    at_border: NDArray[np.bool_]


def sightings(world: World, tables: list[Array], background: list[Array]) -> Sightings:
    """Choose what is in view; *tables* are the painter's tables per frame, *background* the ground's colour per row."""
    size = np.array([world.stage.width_px, world.stage.height_px])
    rows, px, rgb, ground, border = [], [], [], [], []
    begin = np.searchsorted(world.states.frame, np.arange(len(world.paths) + 1))
    for k, table in enumerate(tables):
        at = table[:, :2]
        keep = np.all((at > -0.5) & (at < size - 0.5), axis=1)
        half = 0.5 * (np.abs(table[:, [2, 4]]) * table[:, [6]] + np.abs(table[:, [3, 5]]) * table[:, [7]])
        touches = np.any((at - half < -0.5) | (at + half > size - 0.5), axis=1)
        rows.append(begin[k] + np.flatnonzero(keep))
        px.append(at[keep])
        rgb.append(mean_colours(table[keep]))
        ground.append(background[k][keep])
        border.append(touches[keep])
    joined = (np.concatenate(part) for part in (rows, px, rgb, ground, border))
    return Sightings(*joined)


def truth_tables(world: World, seen: Sightings, *, bin_s: int) -> dict[str, pd.DataFrame]:
    """Return detections, track_points, trajectories, crossings, od_pairs and turns of what is in view."""
    detections = _detections(world, seen)
    points = _track_points(world, seen, detections)
    trajectories = _trajectories(world, seen, points)
    clock = (world.t_utc, world.time_zone, bin_s)
    return {
        "detections": detections.drop(columns="state_row").reset_index(drop=True),
        "track_points": points.drop(columns="state_row").reset_index(drop=True),
        "trajectories": trajectories.drop(columns=["vehicle", "arm", "t_origin_s", "t_entry_s", "travel_s"]),
        "crossings": _crossings(world, trajectories),
        "od_pairs": od_table(trajectories, clock),
        "turns": turn_table(trajectories, clock),
    }


def _detections(world: World, seen: Sightings) -> pd.DataFrame:
    states, fleet = world.states, world.fleet
    row, scene = seen.row, world.states.xy_m[seen.row]
    vehicle, frame = states.vehicle[row], states.frame[row]
    ground = apply(world.stage.scene_to_ground, scene)
    velocity = directions(world.stage.scene_to_ground, scene, states.velocity_mps[row])
    forward = directions(world.stage.scene_to_ground, scene, states.forward[row])
    order = np.lexsort((seen.px[:, 0], seen.px[:, 1], frame))
    rank = np.empty(len(row), np.int64)
    rank[order] = np.arange(len(row)) - np.searchsorted(frame, frame)[order]
    ids = [frame_id(path) for path in world.paths]
    table = pd.DataFrame(
        {
            "detection_id": [detection_id(ids[f], int(r)) for f, r in zip(frame, rank, strict=True)],
            "frame_id": np.array(ids, object)[frame],
            "sequence": world.sequence,
            "t_utc": world.t_utc[frame],
            "col_px": seen.px[:, 0],
            "row_px": seen.px[:, 1],
            "x_m": ground[:, 0],
            "y_m": ground[:, 1],
            "vx_mps": velocity[:, 0],
            "vy_mps": velocity[:, 1],
            "length_m": fleet.looks.length_m[vehicle],
            "width_m": fleet.looks.width_m[vehicle],
            "heading_deg": np.mod(compass_deg(forward), 180.0),
            "area_m2": fleet.looks.length_m[vehicle] * fleet.looks.width_m[vehicle],
            "red": seen.rgb[:, 0],
            "green": seen.rgb[:, 1],
            "blue": seen.rgb[:, 2],
            "contrast": np.linalg.norm(seen.rgb - seen.ground_rgb, axis=1),
            "source": "truth",
            "flags": np.where(seen.at_border, int(DetectionFlag.TOUCHES_BORDER), 0).astype(np.int32),
            "vehicle_id": np.array(fleet.ids, object)[vehicle],
            "standing_s": states.standing_s[row],
            "luminance": seen.rgb @ LUMA,
            "state_row": row,
        }
    )
    return table.sort_values("detection_id", ignore_index=True)


def _track_points(world: World, seen: Sightings, detections: pd.DataFrame) -> pd.DataFrame:
    """Return every vehicle's state at all frames from its first to its last sighting."""
    states = world.states
    vehicle, frame = states.vehicle, states.frame
    first = pd.Series(frame[seen.row]).groupby(vehicle[seen.row]).agg(["min", "max"])
    span = first.reindex(vehicle).to_numpy(float)
    row = np.flatnonzero((frame >= span[:, 0]) & (frame <= span[:, 1]))
    scene = states.xy_m[row]
    ground = apply(world.stage.scene_to_ground, scene)
    velocity = directions(world.stage.scene_to_ground, scene, states.velocity_mps[row])
    forward = directions(world.stage.scene_to_ground, scene, states.forward[row])
    speed = np.hypot(*velocity.T)
    course = np.where((speed > 0.01)[:, None], velocity, forward)
    sighting = pd.Series(detections["detection_id"].to_numpy(object), detections["state_row"])
    table = pd.DataFrame(
        {
            "vehicle_id": np.array(world.fleet.ids, object)[vehicle[row]],
            "t_utc": world.t_utc[frame[row]],
            "x_m": ground[:, 0],
            "y_m": ground[:, 1],
            "vx_mps": velocity[:, 0],
            "vy_mps": velocity[:, 1],
            "speed_mps": speed,
            "speed_sigma_mps": 0.0,
            "accel_mps2": states.accel_mps2[row],
            "heading_deg": compass_deg(course),
            "detection_id": sighting.reindex(row).where(lambda s: s.notna(), None).to_numpy(object),
            "state": np.where(speed < STANDING_MPS, "stopped", "moving"),
            "state_row": row,
        }
    )
    return table.sort_values(["vehicle_id", "t_utc"], ignore_index=True)


def _trajectories(world: World, seen: Sightings, points: pd.DataFrame) -> pd.DataFrame:
    """Return one row per vehicle seen, with what is known of its trip within the archive."""
    states, fleet, frames = world.states, world.fleet, len(world.paths)
    row = points["state_row"].to_numpy()
    groups = points.groupby("vehicle_id", sort=True).indices
    where = {key: row[index] for key, index in groups.items()}
    vehicle = np.array([states.vehicle[rows[0]] for rows in where.values()], np.int64)
    first = np.array([rows[0] for rows in where.values()], np.int64)
    last = np.array([rows[-1] for rows in where.values()], np.int64)
    duration = (world.t_utc[states.frame[last]] - world.t_utc[states.frame[first]]).total_seconds().to_numpy(float)
    path = states.s_m[last] - states.s_m[first]
    end_s = float((world.t_utc[-1] - world.t_utc[0]).total_seconds())
    passed = np.where((states.passed_s >= 0) & (states.passed_s <= end_s), states.passed_s, np.nan)[vehicle]
    routes = [world.network.routes[k] for k in fleet.route[vehicle]]
    known = ~np.isnan(passed)
    xy = points[["x_m", "y_m"]].to_numpy()
    start_s = (world.t_utc[states.frame[first]] - world.t_utc[0]).total_seconds().to_numpy(float)
    movement = np.array([str(route.movement) for route in routes], object)
    entered = known[:, 1]
    unknown, nobody = np.full(len(vehicle), "unknown", object), np.full(len(vehicle), None, object)
    return pd.DataFrame(
        {
            "vehicle_id": list(where),
            "sequence": world.sequence,
            "t_start_utc": world.t_utc[states.frame[first]],
            "t_end_utc": world.t_utc[states.frame[last]],
            "points": np.array([len(rows) for rows in where.values()], np.int32),
            "path_m": path,
            "mean_speed_mps": np.divide(path, duration, out=np.full(len(path), np.nan), where=duration > 0),
            "length_m": fleet.looks.length_m[vehicle],
            "width_m": fleet.looks.width_m[vehicle],
            "vehicle_class": np.array(KINDS, object)[fleet.looks.kind[vehicle]],
            "origin": np.where(known[:, 0], np.array([r.origin for r in routes], object), "unknown"),
            "destination": np.where(known[:, 3], np.array([r.destination for r in routes], object), "unknown"),
            "movement": np.select([entered & known[:, 2], entered], [movement, unknown], nobody),
            "start_reason": np.where(states.frame[first] == 0, "start_of_data", "entered_view"),
            "end_reason": np.where(states.frame[last] == frames - 1, "end_of_data", "left_view"),
            "identity_probability": 1.0,
            "flags": np.int32(0),
            "geometry": [_line(xy[index]) for index in groups.values()],
            "vehicle": vehicle,
            "arm": [route.origin for route in routes],
            "t_origin_s": np.where(known[:, 0], passed[:, 0], start_s),
            "t_entry_s": passed[:, 1],
            "travel_s": passed[:, 3] - passed[:, 0],
        }
    )


def _line(xy: Array) -> shapely.LineString:
    return shapely.LineString(xy if len(xy) > 1 else np.vstack([xy, xy]))


def _crossings(world: World, trajectories: pd.DataFrame) -> pd.DataFrame:
    """Return when vehicles of the trajectories crossed gates during the archive."""
    vehicle = trajectories["vehicle"].to_numpy()
    parts = []
    for end, mark, direction in (("origin", 0, "forward"), ("destination", 3, "backward")):
        crossed = (trajectories[end] != "unknown").to_numpy()
        seconds = world.states.passed_s[vehicle[crossed], mark]
        parts.append(
            pd.DataFrame(
                {
                    "vehicle_id": trajectories.loc[crossed, "vehicle_id"],
                    "gate": trajectories.loc[crossed, end],
                    "t_utc": (world.t_utc[0] + pd.to_timedelta(seconds, unit="s")).round("us").as_unit("us"),
                    "direction": direction,
                    "speed_mps": world.states.passed_mps[vehicle[crossed], mark],
                    "speed_sigma_mps": 0.0,
                }
            )
        )
    return pd.concat(parts).sort_values(["vehicle_id", "gate", "t_utc"], ignore_index=True)
