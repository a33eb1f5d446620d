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
from vtrack_batch.simulation.counts import Clock, gate_cells, od_table, turn_table
from vtrack_batch.simulation.fleet import KINDS, Fleet
from vtrack_batch.simulation.flight import Flight
from vtrack_batch.simulation.paint import mean_colours
from vtrack_batch.simulation.places import Places
from vtrack_batch.simulation.queues import queue_table
from vtrack_batch.simulation.render import Camera, ground_colour, shadow_share, visible_share
from vtrack_batch.simulation.stage import Stage, compass_deg, directions
from vtrack_batch.simulation.stays import area_cells, stays_in
from vtrack_batch.simulation.traffic import STANDING_MPS, Motion, States, passages

LUMA = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True)
class World:
    """All that happened: what the truth is written from. ``paths`` and ``t_utc`` (frames,) name and date the frames."""

    places: Places
    fleet: Fleet
    motion: Motion
    states: States
    stage: Stage
    flight: Flight
    paths: list[str]
    t_utc: pd.DatetimeIndex
    sequence: str
    time_zone: str


@dataclass(frozen=True)
class Sightings:
    """Vehicles whose centre lies in a frame: ``row`` (n,) into the states, ``px`` (n, 2), colours (n, 3) as painted.

    ``visible`` and ``shaded`` (n,) are the shares of each body that nothing hides, and that lie in static shadow.
    """

    row: NDArray[np.int64]
    px: Array
    rgb: Array
    ground_rgb: Array
    at_border: NDArray[np.bool_]
    visible: Array
    shaded: Array


def sightings(world: World, camera: Camera, tables: list[Array]) -> Sightings:
    """Choose what is in view; *tables* are the painter's tables per frame."""
    size = np.array([world.stage.width_px, world.stage.height_px])
    begin = np.searchsorted(world.states.frame, np.arange(len(world.paths) + 1))
    parts = []
    for k, every in enumerate(tables):
        keep = np.flatnonzero(np.all((every[:, :2] > -0.5) & (every[:, :2] < size - 0.5), axis=1))
        table, row = every[keep], begin[k] + keep
        at = table[:, :2]
        half = 0.5 * (np.abs(table[:, [2, 4]]) * table[:, [6]] + np.abs(table[:, [3, 5]]) * table[:, [7]])
        touches = np.any((at - half < -0.5) | (at + half > size - 0.5), axis=1)
        ground = ground_colour(camera, world.states.xy_m[row])
        shares = visible_share(camera, k, table), shadow_share(camera, k, table)
        parts.append((row, at, mean_colours(table), ground, touches, *shares))
    return Sightings(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def truth_tables(world: World, seen: Sightings, *, bin_s: int) -> dict[str, pd.DataFrame]:
    """Return the truth of what is in view: one table per name of the data dictionary, and ``queues``."""
    detections = _detections(world, seen)
    points = _track_points(world, seen, detections)
    events = _events(world, seen)
    turns = _turns(world, events)
    trips = _trips(world, events).join(turns[turns["movement"] != "unknown"].groupby("vehicle")["movement"].first())
    trajectories = _trajectories(world, points, trips)
    clock = Clock(world.t_utc, world.time_zone, bin_s)
    classes = np.array(KINDS, object)[world.fleet.looks.kind]
    turns = turns.assign(vehicle_class=classes[turns["vehicle"].to_numpy(np.int64)])
    crossings = _crossings(world, events)
    of_vehicle = trajectories.set_index("vehicle_id")["vehicle_class"]
    gates = gate_cells(crossings.assign(vehicle_class=crossings["vehicle_id"].map(of_vehicle)), clock)
    stays = stays_in(world.motion, world.places, clock, np.unique(world.states.vehicle[seen.row]))
    areas = area_cells(stays.assign(vehicle_class=classes[stays["vehicle"].to_numpy(np.int64)]), world.places, clock)
    return {
        "frames": _frames(world),
        "detections": detections.drop(columns="state_row").reset_index(drop=True),
        "track_points": points.drop(columns="state_row").reset_index(drop=True),
        "trajectories": trajectories.drop(columns=["t_origin_s", "travel_s"]),
        "crossings": crossings,
        "od_pairs": od_table(trajectories, clock),
        "turns": turn_table(turns, clock),
        "speeds": pd.concat([gates[0], areas[0]]).sort_values(["place", "bin_start_utc"], ignore_index=True),
        "flows": pd.concat([gates[1], areas[1]]).sort_values(
            ["place", "vehicle_class", "bin_start_utc"], ignore_index=True
        ),
        "queues": queue_table(world.motion, world.fleet, world.places, clock, world.stage.scene_to_ground),
    }


def _frames(world: World) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "frame_id": [frame_id(path) for path in world.paths],
            "sequence": world.sequence,
            "path": world.paths,
            "t_utc": world.t_utc,
            "width_px": np.int32(world.stage.width_px),
            "height_px": np.int32(world.stage.height_px),
            "sha256": None,
            "status": "used",
            "reason": None,
        }
    )


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
            "flags": _flags(seen),
            "vehicle_id": fleet.ids[vehicle],
            "standing_s": states.standing_s[row],
            "luminance": seen.rgb @ LUMA,
            "visible_share": seen.visible,
            "shadow_share": seen.shaded,
            "state_row": row,
        }
    )
    return table.sort_values("detection_id", ignore_index=True)


def _flags(seen: Sightings) -> NDArray[np.int32]:
    border = np.where(seen.at_border, int(DetectionFlag.TOUCHES_BORDER), 0)
    return (border | np.where(seen.shaded > 0.5, int(DetectionFlag.SHADOWED), 0)).astype(np.int32)


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
            "vehicle_id": world.fleet.ids[vehicle[row]],
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


def _events(world: World, seen: Sightings) -> pd.DataFrame:
    """Return when the vehicles that were seen passed gates and borders of arms, from the first to the last frame.

    ``line`` numbers the gates, then the arms.
    """
    lines = [gate.line for gate in world.places.gates] + [arm.ring[:2] for arm in world.places.arms]
    found = passages(world.motion, np.array(lines).reshape(-1, 2, 2))
    end_s = float((world.t_utc[-1] - world.t_utc[0]).total_seconds())
    known = found["t_s"].between(0, end_s) & found["vehicle"].isin(np.unique(world.states.vehicle[seen.row]))
    return found[known].reset_index(drop=True)


def _trips(world: World, events: pd.DataFrame) -> pd.DataFrame:
    """Return what is known of each vehicle's ends: origin, destination, t_origin_s, travel_s, indexed by vehicle."""
    gates = events[events["line"] < len(world.places.gates)]
    names = np.array([gate.id for gate in world.places.gates], object)
    first = gates.drop_duplicates("vehicle").query("forward").set_index("vehicle")
    last = gates.drop_duplicates("vehicle", keep="last").query("not forward").set_index("vehicle")
    ends = pd.DataFrame(index=np.unique(np.concatenate([first.index, last.index]).astype(np.int64)))
    origin, destination = (side["line"].map(lambda k: names[k]).reindex(ends.index) for side in (first, last))
    t_origin, t_reached = (side["t_s"].reindex(ends.index) for side in (first, last))
    return ends.assign(
        origin=origin, destination=destination, t_origin_s=t_origin, travel_s=(t_reached - t_origin).astype(float)
    )


def _turns(world: World, events: pd.DataFrame) -> pd.DataFrame:
    """Return one row per vehicle and entry of a junction: vehicle, junction, approach, movement, t_s."""
    places = world.places
    at = events[events["line"] >= len(places.gates)]
    arm = at["line"].to_numpy(np.int64) - len(places.gates)
    junction = np.array([a.junction for a in places.arms], object)[arm] if len(arm) else np.zeros(0, object)
    at = at.assign(arm=arm, junction=junction).sort_values(["vehicle", "junction", "t_s"], ignore_index=True)
    after = at.shift(-1)
    left = (after["vehicle"] == at["vehicle"]) & (after["junction"] == at["junction"]) & ~after["forward"].eq(True)
    made = at["forward"].to_numpy(bool)
    pairs = zip(at["arm"][made], after["arm"][made].where(left[made], -1).astype(int), strict=True)
    movement = ["unknown" if b < 0 else places.movement(places.arms[a], places.arms[b]) for a, b in pairs]
    approach = [places.arms[a].id for a in at["arm"][made]]
    turns = at.loc[made, ["vehicle", "junction", "t_s"]].assign(approach=approach, movement=movement)
    return turns.sort_values(["vehicle", "t_s"], ignore_index=True)


def _trajectories(world: World, points: pd.DataFrame, trips: pd.DataFrame) -> pd.DataFrame:
    """Return one row per vehicle seen, with what is known of its trip within the archive."""
    states, looks, frames = world.states, world.fleet.looks, len(world.paths)
    row = points["state_row"].to_numpy()
    groups = points.groupby("vehicle_id", sort=True).indices
    first = np.array([row[index[0]] for index in groups.values()], np.int64)
    last = np.array([row[index[-1]] for index in groups.values()], np.int64)
    vehicle = states.vehicle[first]
    begin, end = world.t_utc[states.frame[first]], world.t_utc[states.frame[last]]
    duration = (end - begin).total_seconds().to_numpy(float)
    path = states.s_m[last] - states.s_m[first]
    xy = points[["x_m", "y_m"]].to_numpy()
    known = trips.reindex(vehicle)
    start_s = (begin - world.t_utc[0]).total_seconds().to_numpy(float)
    return pd.DataFrame(
        {
            "vehicle_id": list(groups),
            "sequence": world.sequence,
            "t_start_utc": begin,
            "t_end_utc": end,
            "points": np.array([len(index) for index in groups.values()], np.int32),
            "path_m": path,
            "mean_speed_mps": np.divide(path, duration, out=np.full(len(path), np.nan), where=duration > 0),
            "length_m": looks.length_m[vehicle],
            "width_m": looks.width_m[vehicle],
            "vehicle_class": np.array(KINDS, object)[looks.kind[vehicle]],
            "origin": known["origin"].astype(object).fillna("unknown").to_numpy(object),
            "destination": known["destination"].astype(object).fillna("unknown").to_numpy(object),
            "movement": known["movement"].astype(object).where(known["movement"].notna(), None).to_numpy(object),
            "start_reason": np.where(states.frame[first] == 0, "start_of_data", "entered_view"),
            "end_reason": np.where(states.frame[last] == frames - 1, "end_of_data", "left_view"),
            "identity_probability": 1.0,
            "flags": np.int32(0),
            "geometry": [_line(xy[index]) for index in groups.values()],
            "t_origin_s": known["t_origin_s"].fillna(pd.Series(start_s, known.index)).to_numpy(float),
            "travel_s": known["travel_s"].to_numpy(float),
        }
    )


def _line(xy: Array) -> shapely.LineString:
    return shapely.LineString(xy if len(xy) > 1 else np.vstack([xy, xy]))


def _crossings(world: World, events: pd.DataFrame) -> pd.DataFrame:
    """Return when vehicles crossed gates during the archive."""
    over = events[events["line"] < len(world.places.gates)]
    names = np.array([gate.id for gate in world.places.gates], object)
    seconds = pd.to_timedelta(over["t_s"].to_numpy(float), unit="s")
    table = pd.DataFrame(
        {
            "vehicle_id": world.fleet.ids[over["vehicle"].to_numpy(np.int64)],
            "gate": names[over["line"].to_numpy(np.int64)] if len(over) else np.zeros(0, object),
            "t_utc": (world.t_utc[0] + seconds).round("us").as_unit("us"),
            "direction": np.where(over["forward"], "forward", "backward"),
            "speed_mps": over["speed_mps"].to_numpy(float),
            "speed_sigma_mps": 0.0,
        }
    )
    return table.sort_values(["vehicle_id", "gate", "t_utc"], ignore_index=True)
