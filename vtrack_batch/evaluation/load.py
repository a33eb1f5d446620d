"""The rim: read a result folder and a truth folder into the two sides of an evaluation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.evaluation.frames import file_number
from vtrack_batch.evaluation.sides import Layout, Result, Truth
from vtrack_batch.model import homography
from vtrack_batch.model.flags import DetectionFlag
from vtrack_batch.model.tables import TABLES

_PANDAS = {"text": "object", "category": "object", "time": "datetime64[us, UTC]", "bool": "bool"}
_RESULT_TABLES = ("frames", "detections", "track_points", "trajectories", "od_pairs", "turns", "quarantine")
_LAYOUTS: dict[Layout, tuple[str, ...]] = {
    "tables": ("detections.parquet", "trajectories.parquet", "track_points.parquet"),
    "rendered": ("truth.csv", "parked.csv", "poses.csv"),
    "kit": ("tracks.csv", "vehicles.csv"),
}
_SIGHTING = [
    "frame",
    "vehicle",
    "col_px",
    "row_px",
    "length_px",
    "motion",
    "speed_mps",
    "standing_s",
    "luminance",
    "whole",
]
_BOX = ["left", "top", "width", "height"]


def load_result(out: str | Path) -> Result:
    """Read the newest snapshot of the result folder *out*, or a snapshot's own folder; the pointer is followed once.

    Raises ``ConfigError`` where there is no snapshot.
    """
    out = Path(out)
    snapshot = (out / "current").resolve()
    if not snapshot.is_dir():
        snapshot = out.resolve()
    if not (snapshot / "frames").is_dir():
        raise ConfigError(f"{out}: not a result folder; looked for {out / 'current'} and for {out / 'frames'}")
    return Result(**{name: _read(name, sorted((snapshot / name).rglob("*.parquet"))) for name in _RESULT_TABLES})


def load_truth(folder: str | Path) -> Truth:
    """Read a truth: the tables of ``simulate`` (in *folder* or its ``truth``), a rendered archive's or KIT's CSV files.

    One of the files may be named in place of its folder. Raises ``ConfigError`` where no such files are found.
    """
    folder = Path(folder)
    folder = folder.parent if folder.is_file() else folder
    for place in (folder, folder / "truth"):
        for layout, names in _LAYOUTS.items():
            if all((place / name).is_file() for name in names):
                return _READERS[layout](place)
    looked = "; ".join(f"{layout}: {', '.join(names)}" for layout, names in _LAYOUTS.items())
    raise ConfigError(f"{folder}: no truth found here nor in {folder / 'truth'}; looked for {looked}")


def _tables_truth(folder: Path) -> Truth:
    """The contract's tables with ``vehicle_id`` in detections; frames are numbered in order of time.

    Where ``frames.parquet`` is there, it says which frames there are; else those in which a vehicle is.
    """
    own = ("vehicle_id", "standing_s", "luminance")
    detections = _read("detections", [folder / "detections.parquet"], own)
    points = _read("track_points", [folder / "track_points.parquet"])
    frames = _numbered(folder, detections["t_utc"], points["t_utc"])
    speeds = points[["vehicle_id", "t_utc", "speed_mps"]]
    seen = detections.merge(speeds, on=["vehicle_id", "t_utc"], how="left").merge(frames, on="t_utc")
    seen["whole"] = (seen["flags"].astype(int) & int(DetectionFlag.TOUCHES_BORDER)) == 0
    seen = seen.rename(columns={"vehicle_id": "vehicle"}).assign(motion="mover", length_px=np.nan)
    trips = (_read(name, [folder / f"{name}.parquet"]) for name in ("trajectories", "od_pairs", "turns"))
    return Truth("tables", frames, _sightings(seen), _parked(folder), _ignored(folder / "ignore.csv"), *trips)


def _numbered(folder: Path, *times: pd.Series) -> pd.DataFrame:
    """Return the frames by time, numbered as in ``poses.csv``; raises ``UnusableData`` where the two do not agree."""
    if (folder / "frames.parquet").is_file():
        times = (_read("frames", [folder / "frames.parquet"])["t_utc"],)
    t_utc = pd.concat(times).drop_duplicates().sort_values(ignore_index=True)
    if (folder / "poses.csv").is_file():
        poses = len(_csv(folder / "poses.csv", ["frame"]))
        if poses != len(t_utc):
            raise UnusableData(
                f"{folder}: {poses} poses but {len(t_utc)} frames with vehicles; frames.parquet is missing"
            )
    return pd.DataFrame({"frame": np.arange(len(t_utc)), "t_utc": t_utc})


def _rendered_truth(folder: Path) -> Truth:
    """``truth.csv`` with centres in the frame, ``parked.csv`` in the reference frame, ``poses.csv`` between them."""
    rows = _csv(folder / "truth.csv", ["frame", "vehicle", "col_px", "row_px", "speed_mps", "standing_s", "luminance"])
    seen = rows.assign(vehicle=rows["vehicle"].astype(str), motion="mover", length_px=np.nan)
    frames = _csv(folder / "poses.csv", ["frame"])["frame"]
    return _csv_truth(folder, "rendered", frames, (_sightings(seen), _parked(folder), _ignored(folder / "ignore.csv")))


def _kit_truth(folder: Path) -> Truth:
    """``tracks.csv``: boxes whose ``left``, ``top`` are outer edges; ``vehicles.csv``: who moves; ``ignore.csv``."""
    rows = _csv(folder / "tracks.csv", ["frame", "id", *_BOX])
    motion = _csv(folder / "vehicles.csv", ["id", "motion"]).set_index("id")["motion"]
    if strangers := sorted(set(rows["id"]) - set(motion.index)):
        raise UnusableData(f"{folder / 'vehicles.csv'}: no motion is given for id {strangers[0]}")
    seen = rows.assign(
        vehicle=rows["id"].astype(str),
        col_px=rows["left"] + rows["width"] / 2 - 0.5,
        row_px=rows["top"] + rows["height"] / 2 - 0.5,
        length_px=rows[["width", "height"]].max(axis=1),
        motion=rows["id"].map(motion),
    )
    sides = _sightings(seen), _parked(folder), _ignored(folder / "ignore.csv")
    return _csv_truth(folder, "kit", rows["frame"], sides)


def _csv_truth(folder: Path, layout: Layout, frames: pd.Series, sides: tuple[pd.DataFrame, ...]) -> Truth:
    """Return the truth of a CSV layout, which knows no trips; times are those of ``times.csv``, where it is there."""
    number = np.unique(frames.to_numpy(np.int64))
    times = pd.DataFrame({"frame": number, "t_utc": pd.Series(pd.NaT, range(len(number)), _PANDAS["time"])})
    if (folder / "times.csv").is_file():
        rows = _csv(folder / "times.csv", ["file", "time"])
        at = pd.Series(pd.to_datetime(rows["time"], utc=True).to_numpy(), file_number(rows["file"]).to_numpy())
        times["t_utc"] = pd.to_datetime(times["frame"].map(at), utc=True).dt.as_unit("us")
    seen, parked, ignore = sides
    nothing = (_read(name, []) for name in ("trajectories", "od_pairs", "turns"))
    return Truth(layout, times, seen, parked, ignore, *nothing)


def _sightings(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the columns of ``Truth.sightings``; numbers that the layout does not give are NaN."""
    numbers = {"frame": np.int64} | dict.fromkeys(("speed_mps", "standing_s", "luminance"), float)
    return rows.assign(whole=rows.get("whole", True)).reindex(columns=_SIGHTING).astype(numbers)


def _parked(folder: Path) -> pd.DataFrame:
    """Return where each parked car lies in each frame: ``parked.csv`` through the homographies of ``poses.csv``."""
    if not ((folder / "parked.csv").is_file() and (folder / "poses.csv").is_file()):
        return pd.DataFrame({"frame": np.empty(0, np.int64), "col_px": np.empty(0), "row_px": np.empty(0)})
    at = _csv(folder / "parked.csv", ["ref_col_px", "ref_row_px"]).to_numpy(float)
    poses = _csv(folder / "poses.csv", ["frame", *(f"h{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))])
    places = [homography.apply(pose.reshape(3, 3), at) for pose in poses.drop(columns="frame").to_numpy(float)]
    col, row = np.concatenate([*places, np.empty((0, 2))]).T
    return pd.DataFrame({"frame": np.repeat(poses["frame"].to_numpy(np.int64), len(at)), "col_px": col, "row_px": row})


def _ignored(path: Path) -> pd.DataFrame:
    """Return the boxes to be ignored, one row a frame."""
    if not path.is_file():
        return pd.DataFrame({"frame": np.empty(0, np.int64), **dict.fromkeys(_BOX, np.empty(0))})
    boxes = _csv(path, ["frame_from", "frame_to", *_BOX])
    spans = [range(int(a), int(b) + 1) for a, b in zip(boxes["frame_from"], boxes["frame_to"], strict=True)]
    each = boxes.assign(frame=pd.Series(spans, boxes.index, dtype=object)).explode("frame", ignore_index=True)
    return each.dropna(subset=["frame"]).astype({"frame": np.int64})[["frame", *_BOX]]


def _csv(path: Path, columns: Sequence[str]) -> pd.DataFrame:
    """Read *columns* of a CSV file; raises ``UnusableData`` naming the file and what it lacks."""
    try:
        rows = pd.read_csv(path)
    except (OSError, ValueError) as problem:
        raise UnusableData(f"{path}: cannot be read ({problem})") from None
    if lacking := [name for name in columns if name not in rows.columns]:
        raise UnusableData(f"{path}: columns missing: {', '.join(lacking)}")
    return rows[list(columns)]


def _read(name: str, paths: Sequence[Path], more: Sequence[str] = ()) -> pd.DataFrame:
    """Read the files of the declared table *name*, without its geometry, and columns *more* where they are there.

    No file gives an empty table; nullable columns that a file lacks are null.
    """
    columns = [column for column in TABLES[name].columns if column.type != "geometry"]
    kinds = {column.name: _PANDAS.get(column.type, "float64") for column in columns} | dict.fromkeys(more, "object")
    parts = [_read_file(path, kinds) for path in paths if path.is_file()]
    needed = {column.name for column in columns if not column.nullable}
    for path, part in zip(paths, parts, strict=False):
        if lacking := sorted(needed - set(part.columns)):
            raise UnusableData(f"{path}: columns missing: {', '.join(lacking)}")
    whole = [part.reindex(columns=list(kinds)).astype(kinds) for part in parts if len(part)]
    return pd.concat(whole, ignore_index=True) if whole else pd.DataFrame(columns=list(kinds)).astype(kinds)


def _read_file(path: Path, kinds: Mapping[str, str]) -> pd.DataFrame:
    try:
        with pq.ParquetFile(path) as file:
            held = [name for name in kinds if name in file.schema_arrow.names]
            rows = file.read(columns=held).to_pandas()
    except (OSError, pa.ArrowException) as problem:
        raise UnusableData(f"{path}: cannot be read ({problem})") from None
    texts = [name for name in held if kinds[name] == "object"]
    return rows.assign(**{name: rows[name].astype(object).where(rows[name].notna(), None) for name in texts})


_READERS: dict[Layout, Callable[[Path], Truth]] = {
    "tables": _tables_truth,
    "rendered": _rendered_truth,
    "kit": _kit_truth,
}
