"""Truths as others write them, brought into one form. Tables in, ``Truth`` out; ``load`` reads the files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from vtrack_batch.errors import UnusableData
from vtrack_batch.evaluation.bodies import nearest_gap
from vtrack_batch.evaluation.frames import file_number
from vtrack_batch.evaluation.scene import ground_scale
from vtrack_batch.evaluation.sides import SIGHTING_NUMBERS, Layout, Truth
from vtrack_batch.model import homography
from vtrack_batch.model.flags import DetectionFlag
from vtrack_batch.model.tables import TABLES

BOX = ["left", "top", "width", "height"]
POSE = [f"h{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]
_GAP_REACH_M = 5.0
_GAP_REACH_PX = 60.0
_LEAST_VISIBLE = 0.5
Tables = Mapping[str, pd.DataFrame]
"""The tables of a truth by name, as read: an absent file is an empty table."""


def tables_truth(tables: Tables) -> Truth:
    """Declared tables: detections whose vehicle is named by ``vehicle_id``, or else by the track points.

    Frames are numbered in order of time: those of ``frames`` where it is there, else those in which a vehicle is. A
    vehicle need not be found where less than half of it is visible. Of ``others``, trams are neither right nor wrong.
    ``keys`` and ``detected``, where they are there, give sightings the ids of the detections that a simulated detector
    made of them.
    """
    detections, points = tables["detections"], tables["track_points"]
    if detections["vehicle_id"].isna().all():
        on_track = points.dropna(subset=["detection_id"]).drop_duplicates("detection_id")
        of = detections["detection_id"].map(on_track.set_index("detection_id")["vehicle_id"])
        detections = detections.assign(vehicle_id=of)
    frames = _numbered(tables, detections["t_utc"], points["t_utc"])
    speeds = points[["vehicle_id", "t_utc", "speed_mps"]]
    seen = detections.merge(speeds, on=["vehicle_id", "t_utc"], how="left").merge(frames, on="t_utc")
    flags = seen["flags"].fillna(0).astype(int)
    visible = seen["visible_share"].astype(float).fillna(1.0) >= _LEAST_VISIBLE
    seen["whole"] = ((flags & int(DetectionFlag.TOUCHES_BORDER)) == 0) & visible
    seen["shadowed"] = (flags & int(DetectionFlag.SHADOWED)) != 0
    # headings turn clockwise from north: from y towards x
    seen["gap_m"] = _gap(seen, ["y_m", "x_m"], ["length_m", "width_m"], "heading_deg", _GAP_REACH_M)
    # the lengths of detections are for bodies; the gate stays the common one, as for rendered archives
    seen = seen.rename(columns={"vehicle_id": "vehicle"}).drop(columns="length_m")
    alarms = _alarms(seen)
    if "keys" in tables:
        seen, alarms = _with_keys(seen, tables["keys"], tables["detected"].merge(frames, on="t_utc"))
    truth = _csv_truth("tables", frames["frame"], seen[seen["vehicle"].notna()], tables)
    trams = _trams(tables.get("others", pd.DataFrame()), frames, seen)
    return replace(truth, frames=frames, alarms=alarms, ignore=pd.concat([truth.ignore, trams], ignore_index=True))


def labelled_truth(tables: Tables) -> Truth:
    """One table of detections that names the true vehicle of each (``truth_vehicle``; null = a false alarm).

    Times are ``t_utc``, or ``t_s``, or the ``image`` 1 or 2 of a pair; ids are then told apart by their image.
    """
    rows = tables["labelled"]
    paired = not ({"t_utc", "t_s"} & set(rows.columns))
    if "t_utc" in rows:
        t_utc = pd.to_datetime(rows["t_utc"], utc=True)
    else:
        since = pd.to_timedelta(rows["image" if paired else "t_s"].astype(float), unit="s")
        t_utc = pd.Timestamp(0, tz="UTC") + since
    t_utc = t_utc.dt.as_unit("us")
    number, times = pd.factorize(t_utc, sort=True)
    frames = pd.DataFrame({"frame": np.arange(len(times)), "t_utc": pd.Series(times)})
    ids = rows["detection_id"].map(as_text)
    if paired:
        ids = rows["image"].map(as_text) + "/" + ids
    vehicle = rows["vehicle_id" if "truth_vehicle" not in rows else "truth_vehicle"].map(as_text)
    seen = rows.assign(frame=number.astype(np.int64), detection_id=ids, vehicle=vehicle)
    truth = _csv_truth("pair" if paired else "labelled", frames["frame"], seen[vehicle.notna()], {})
    return replace(truth, frames=frames, alarms=_alarms(seen))


def rendered_truth(tables: Tables) -> Truth:
    """``truth.csv`` with centres in the frame, ``parked.csv`` in the reference frame, ``poses.csv`` between them."""
    rows = tables["truth"].rename(columns={"length_px": "body_px"})
    seen = rows.assign(vehicle=rows["vehicle"].map(as_text))
    if {"body_px", "width_px", "heading_image_deg"} <= set(rows.columns):
        size = ["body_px", "width_px"]
        seen["gap_px"] = _gap(seen, ["col_px", "row_px"], size, "heading_image_deg", _GAP_REACH_PX)
    return _csv_truth("rendered", tables["poses"]["frame"], seen, tables)


def kit_truth(tables: Tables) -> Truth:
    """``tracks.csv``: boxes whose ``left``, ``top`` are outer edges; ``vehicles.csv``: who moves; ``ignore.csv``."""
    rows = tables["tracks"]
    motion = tables["vehicles"].set_index("id")["motion"]
    if strangers := sorted(set(rows["id"]) - set(motion.index)):
        raise UnusableData(
            f"vehicles.csv: no motion is given for id {strangers[0]}, one of {len(strangers)} ids of tracks.csv "
            "that have no row there; add them as mover, creeper or parked"
        )
    seen = _boxed(rows).assign(motion=rows["id"].map(motion))
    return _csv_truth("kit", rows["frame"], seen, tables)


def mot_truth(tables: Tables) -> Truth:
    """MOTChallenge's ``gt.txt``: frame, id, left, top, width, height, and a flag, counted from 1; flag 0 = ignore.

    Pixels count from 1 there, so that a box that begins at 1 begins at our -0.5.
    """
    rows = tables["boxes"].assign(left=tables["boxes"]["left"] - 1, top=tables["boxes"]["top"] - 1)
    ignored = rows["flag"].fillna(1) == 0
    ignore = rows[ignored].assign(frame_from=rows["frame"], frame_to=rows["frame"])
    return _csv_truth("mot", rows["frame"], _boxed(rows[~ignored]), {"ignore": ignore})


def boxes_truth(tables: Tables) -> Truth:
    """Boxes without a head line, as of SkySat: frame, id, left, top, width, height; frames and pixels count from 0."""
    rows = tables["boxes"]
    return _csv_truth("boxes", rows["frame"], _boxed(rows), {})


def geotrax_truth(tables: Tables, *, time_zone: str | None = None) -> Truth:
    """geo-trax's CSV: metres on the ground, lengths, km/h; local times without a zone, which *time_zone* gives."""
    rows = tables["geotrax"]
    frames = rows[["Frame_Number"]].drop_duplicates().sort_values("Frame_Number", ignore_index=True)
    frames = pd.DataFrame({"frame": frames["Frame_Number"].astype(np.int64)})
    frames["t_utc"] = pd.Series(pd.NaT, frames.index, "datetime64[us, UTC]")
    if time_zone and "Timestamp" in rows:
        local = rows.drop_duplicates("Frame_Number").set_index("Frame_Number")["Timestamp"]
        stamps = pd.to_datetime(frames["frame"].map(local), format="ISO8601")
        frames["t_utc"] = stamps.dt.tz_localize(time_zone).dt.tz_convert("UTC").dt.as_unit("us")
    seen = pd.DataFrame(
        {
            "frame": rows["Frame_Number"],
            "vehicle": rows["Vehicle_ID"].map(as_text),
            "x_m": rows["Local_X"],
            "y_m": rows["Local_Y"],
            "length_m": rows.groupby("Vehicle_ID")["Vehicle_Length"].transform("median"),
            "speed_mps": rows["Vehicle_Speed"] / 3.6,
            # 0: cut by the border of the frame
            "whole": rows["Visibility"].fillna(1) > 0 if "Visibility" in rows else True,
        }
    )
    return replace(_csv_truth("geotrax", frames["frame"], seen, {}), frames=frames)


def as_text(value: object) -> str | None:
    """Return an id as text: whole numbers without a decimal point, missing ones as None."""
    if value is None or value is pd.NA or value != value:
        return None
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


def _csv_truth(layout: Layout, frames: pd.Series, seen: pd.DataFrame, tables: Tables) -> Truth:
    """Return the truth; ``tables`` may hold ``times``, ``parked``, ``poses``, ``ignore`` and declared tables."""
    number = np.unique(frames.to_numpy(np.int64))
    of_frame = pd.DataFrame({"frame": number, "t_utc": pd.Series(pd.NaT, range(len(number)), "datetime64[us, UTC]")})
    times = tables.get("times", pd.DataFrame())
    if len(times):
        at = pd.Series(pd.to_datetime(times["time"], utc=True).to_numpy(), file_number(times["file"]).to_numpy())
        of_frame["t_utc"] = pd.to_datetime(of_frame["frame"].map(at), utc=True).dt.as_unit("us")
    parked = _parked(tables.get("parked", pd.DataFrame()), tables.get("poses", pd.DataFrame()))
    others = {name: tables[name] for name in ("flows", "crossings") if name in tables}
    trips = (
        tables.get(name, pd.DataFrame(columns=list(TABLES[name].column_names)))
        for name in ("trajectories", "od_pairs", "turns")
    )
    return Truth(
        layout, of_frame, _sightings(seen), parked, _ignored(tables.get("ignore", pd.DataFrame())), *trips, **others
    )


def _numbered(tables: Tables, *times: pd.Series) -> pd.DataFrame:
    """Return the frames by time, numbered as in ``poses``; raises ``UnusableData`` where the two do not agree."""
    if len(tables["frames"]):
        times = (tables["frames"]["t_utc"],)
    t_utc = pd.concat(times).drop_duplicates().sort_values(ignore_index=True)
    poses = tables["poses"]
    if len(poses) and len(poses) != len(t_utc):
        raise UnusableData(
            f"poses.csv: expected a row for each of {len(t_utc)} frames, found {len(poses)}; put frames.parquet beside "
            "it, which names the frames without vehicles too"
        )
    return pd.DataFrame({"frame": np.arange(len(t_utc)), "t_utc": t_utc})


def _with_keys(seen: pd.DataFrame, keys: pd.DataFrame, detected: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return sightings under the ids of the detections made of them (None where missed), and the false alarms."""
    known = detected.merge(keys.rename(columns={"vehicle_id": "vehicle"}), on="detection_id", how="left")
    ids = known.dropna(subset=["vehicle"])[["vehicle", "frame", "detection_id"]].drop_duplicates(["vehicle", "frame"])
    seen = seen.drop(columns="detection_id").merge(ids, on=["vehicle", "frame"], how="left")
    return seen.assign(
        detection_id=seen["detection_id"].astype(object).where(seen["detection_id"].notna(), None)
    ), _alarms(known)


def _trams(others: pd.DataFrame, frames: pd.DataFrame, seen: pd.DataFrame) -> pd.DataFrame:
    """Return boxes to be ignored, as long and wide as each section of a tram is long."""
    if others.empty:
        return pd.DataFrame(columns=["frame", *BOX])
    rows = others[others["kind"] == "tram"].merge(frames, on="t_utc")
    side = rows["length_m"].astype(float) / ground_scale(seen, "frame")
    boxes = {"left": rows["col_px"] - side / 2, "top": rows["row_px"] - side / 2, "width": side, "height": side}
    return pd.DataFrame({"frame": rows["frame"], **boxes}).dropna()


def _boxed(rows: pd.DataFrame) -> pd.DataFrame:
    """Return boxes with their centre, the longer side as length, and the id as the vehicle's name."""
    return rows.assign(
        vehicle=rows["id"].map(as_text),
        col_px=rows["left"] + rows["width"] / 2 - 0.5,
        row_px=rows["top"] + rows["height"] / 2 - 0.5,
        length_px=rows[["width", "height"]].max(axis=1),
    )


def _gap(seen: pd.DataFrame, place: list[str], size: list[str], heading: str, reach: float) -> pd.Series:
    centre, body, degrees = (seen[names].to_numpy(float) for names in (place, size, heading))
    gap = nearest_gap(seen["frame"].to_numpy(np.int64), centre, body, degrees, reach=reach)
    return pd.Series(gap, index=seen.index)


def _sightings(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the columns of ``Truth.sightings``; what the layout does not give is NaN, a mover, and whole."""
    rows = rows.assign(whole=rows.get("whole", True), motion=rows.get("motion", "mover"))
    columns = ["frame", "vehicle", "detection_id", "motion", "whole", *SIGHTING_NUMBERS]
    return rows.reindex(columns=columns).astype({"frame": np.int64} | dict.fromkeys(SIGHTING_NUMBERS, float))


def _alarms(seen: pd.DataFrame) -> pd.DataFrame:
    """Return the detections that are no vehicle."""
    rows = seen.loc[seen["vehicle"].isna()]
    return rows.reindex(columns=["frame", "detection_id", "col_px", "row_px", "x_m", "y_m"])


def _parked(parked: pd.DataFrame, poses: pd.DataFrame) -> pd.DataFrame:
    """Return where each parked car lies in each frame: ``parked.csv`` through the homographies of ``poses.csv``."""
    if parked.empty or poses.empty:
        return pd.DataFrame({"frame": np.empty(0, np.int64)} | {name: np.empty(0) for name in ("col_px", "row_px")})
    at = parked[["ref_col_px", "ref_row_px"]].to_numpy(float)
    places = [homography.apply(pose.reshape(3, 3), at) for pose in poses[POSE].to_numpy(float)]
    col, row = np.concatenate([*places, np.empty((0, 2))]).T
    rows = pd.DataFrame({"frame": np.repeat(poses["frame"].to_numpy(np.int64), len(at)), "col_px": col, "row_px": row})
    known = [name for name in ("x_m", "y_m") if name in parked]
    return rows.assign(**{name: np.tile(parked[name].to_numpy(float), len(poses)) for name in known})


def _ignored(boxes: pd.DataFrame) -> pd.DataFrame:
    """Return the boxes to be ignored, one row a frame."""
    if boxes.empty:
        return pd.DataFrame({"frame": np.empty(0, np.int64), **dict.fromkeys(BOX, np.empty(0))})
    spans = [range(int(a), int(b) + 1) for a, b in zip(boxes["frame_from"], boxes["frame_to"], strict=True)]
    each = boxes[BOX].assign(frame=pd.Series(spans, boxes.index, dtype=object)).explode("frame", ignore_index=True)
    return each.dropna(subset=["frame"]).astype({"frame": np.int64})[["frame", *BOX]]


READERS: dict[Layout, Callable[[Tables], Truth]] = {
    "tables": tables_truth,
    "labelled": labelled_truth,
    "rendered": rendered_truth,
    "kit": kit_truth,
    "mot": mot_truth,
    "boxes": boxes_truth,
}
