"""The rim: read a result and a truth into the two sides of an evaluation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from vtrack_batch.errors import ConfigError, UnusableData
from vtrack_batch.evaluation.layouts import BOX, POSE, READERS, as_text, geotrax_truth
from vtrack_batch.evaluation.sides import Layout, Result, Truth
from vtrack_batch.model.tables import TABLES

_PANDAS = {"text": "object", "category": "object", "time": "datetime64[us, UTC]", "bool": "bool"}
_RESULT_TABLES = (
    "frames", "detections", "track_points", "trajectories", "od_pairs", "turns", "quarantine", "matches", "flows",
)  # fmt: skip
_TRUTH_TABLES = (
    "detections", "track_points", "frames", "trajectories", "od_pairs", "turns", "flows", "crossings",
)  # fmt: skip
_TRACKED = ("track_points", "matches")
_NEEDED = {"detections": {"detection_id", "t_utc", "x_m", "y_m"}, "matches": {"detection_id_from", "detection_id_to"}}
"""Columns that tables must have when they are anybody's: of a run, all that are declared."""
_FILES: dict[Layout, tuple[str, ...]] = {
    "tables": ("detections.parquet", "track_points.parquet"),
    "rendered": ("truth.csv", "parked.csv", "poses.csv"),
    "kit": ("tracks.csv", "vehicles.csv"),
}
_CSV = {
    "truth": ["frame", "vehicle", "col_px", "row_px", "speed_mps", "standing_s", "luminance"],
    "poses": ["frame", *POSE],
    "parked": ["ref_col_px", "ref_row_px"],
    "ignore": ["frame_from", "frame_to", *BOX],
    "times": ["file", "time"],
    "tracks": ["frame", "id", *BOX],
    "vehicles": ["id", "motion"],
}
_GEOTRAX = ["Vehicle_ID", "Frame_Number", "Local_X", "Local_Y", "Vehicle_Length", "Vehicle_Speed"]


def load_result(out: str | Path) -> Result:
    """Read a result: the newest snapshot of a result folder, a snapshot's own folder, or tables of others.

    Tables of others: a folder with what ``track`` or ``match`` writes (or one of its files), ``detections.parquet``
    beside unless the ids are those of the truth's detections; or a tracker's boxes as of MOTChallenge (.txt, .csv).
    Raises ``ConfigError`` where there is nothing of the kind.
    """
    out = Path(out)
    if out.is_file() and out.suffix in (".txt", ".csv"):
        return _boxes_result(_boxes(out))
    folder = _snapshot(out)
    if folder is not None:
        return _result({name: _read(name, sorted((folder / name).rglob("*.parquet"))) for name in _RESULT_TABLES})
    folder = out.parent if out.is_file() else out
    if any((folder / f"{name}.parquet").is_file() for name in _TRACKED):
        return _tables_result(folder)
    raise ConfigError(
        f"{out}: not a result folder; looked for {out / 'current'}, for {out / 'frames'}, "
        f"and for {' or '.join(f'{name}.parquet' for name in _TRACKED)}; "
        "`vtrack-batch evaluate --help` says what serves"
    )


def load_truth(place: str | Path, *, time_zone: str | None = None) -> Truth:
    """Read a truth, known by its files (in *place* or its ``truth``), or by the head line of the file *place*.

    Declared tables as ``simulate`` writes them, or a published result; a rendered archive's or KIT's CSV files;
    MOTChallenge's gt.txt, boxes without a head line (SkySat), geo-trax's CSV; a Parquet table of detections with
    ``truth_vehicle``. *time_zone* is that of local times (geo-trax). Raises ``ConfigError`` where nothing is found.
    """
    place = Path(place)
    if place.is_file() and (truth := _file_truth(place, time_zone)) is not None:
        return truth
    folder = place.parent if place.is_file() else place
    for at in (folder, folder / "truth"):
        for layout, names in _FILES.items():
            if all((at / name).is_file() for name in names):
                tables = _declared_tables(at) if layout == "tables" else {}
                return READERS[layout](tables | _csv_tables(at))
        for name in ("gt.txt", "gt/gt.txt", "tracks.csv", "geotrax.csv"):
            if (at / name).is_file() and (truth := _file_truth(at / name, time_zone)) is not None:
                return truth
    if (snapshot := _snapshot(folder)) is not None:
        return READERS["tables"](_declared_tables(snapshot) | _csv_tables(snapshot))
    looked = "; ".join(f"{layout}: {', '.join(names)}" for layout, names in _FILES.items())
    raise ConfigError(
        f"{place}: no truth found here nor in {folder / 'truth'}; looked for {looked}; mot: gt.txt; "
        "a CSV of geo-trax, or of boxes without a head line; a result folder; a Parquet table with truth_vehicle"
    )


def _snapshot(out: Path) -> Path | None:
    """Return the folder of the snapshot in *out*, or None; the pointer is followed once."""
    current = (out / "current").resolve()
    folder = current if current.is_dir() else out.resolve()
    return folder if (folder / "frames").is_dir() else None


def _tables_result(folder: Path) -> Result:
    """Read tables of ``track`` or ``match``; frames are the times of the detections beside them, if any."""
    tables = {name: _read(name, [folder / f"{name}.parquet"], strict=False) for name in _RESULT_TABLES}
    detections = tables["detections"]
    borrowed = not (folder / "detections.parquet").is_file()
    if not borrowed and not len(tables["frames"]):
        frame_id = detections["t_utc"].astype(str)
        tables["detections"] = detections.assign(frame_id=frame_id)
        times = detections.assign(frame_id=frame_id).drop_duplicates("frame_id").sort_values("t_utc")
        sequence = times["sequence"].where(times["sequence"].notna(), "all")
        tables["frames"] = tables["frames"].reindex(range(len(times)))
        tables["frames"] = tables["frames"].assign(
            frame_id=times["frame_id"].to_numpy(), t_utc=times["t_utc"].array, path="", status="used"
        )
        tables["frames"]["sequence"] = sequence.to_numpy()
    found = _result(tables)
    tracked, counted = ((folder / f"{name}.parquet").is_file() for name in ("track_points", "od_pairs"))
    return replace(found, borrowed=borrowed, tracked=tracked, counted=counted)


def _boxes_result(boxes: pd.DataFrame) -> Result:
    """Return a tracker's boxes as a result: centres in pixels, frames by number; nothing is known in metres."""
    tables = {name: _read(name, []) for name in _RESULT_TABLES}
    ids = [f"{n}" for n in range(len(boxes))]
    centre = {
        "col_px": boxes["left"] + boxes["width"] / 2 - 0.5,
        "row_px": boxes["top"] + boxes["height"] / 2 - 0.5,
    }
    frame = boxes["frame"].map(as_text)
    number = np.sort(boxes["frame"].unique())
    detections = pd.DataFrame({"detection_id": ids, "frame_id": frame, **centre})
    points = pd.DataFrame({"vehicle_id": boxes["id"].map(as_text), "detection_id": ids})
    frames = pd.DataFrame({"frame_id": pd.Series(number).map(as_text), "path": pd.Series(number).map(as_text)})
    made = {"detections": detections, "track_points": points, "frames": frames.assign(status="used", sequence="all")}
    for name, rows in made.items():
        kinds = tables[name].dtypes.to_dict()
        tables[name] = rows.reindex(columns=list(kinds)).astype({k: v for k, v in kinds.items() if v != "bool"})
    return replace(_result(tables), counted=False)


def _result(tables: Mapping[str, pd.DataFrame]) -> Result:
    frames, detections, points, trajectories, od_pairs, turns, quarantine, matches, flows = (
        tables[name] for name in _RESULT_TABLES
    )
    return Result(frames, detections, points, trajectories, od_pairs, turns, quarantine, matches, flows)


def _declared_tables(folder: Path) -> dict[str, pd.DataFrame]:
    """Read declared tables: one file each as ``simulate`` writes them, or a snapshot's folders."""
    more = {"detections": ("vehicle_id", "standing_s", "luminance", "visible_share")}
    tables = {
        name: _read(name, [folder / f"{name}.parquet", *sorted((folder / name).rglob("*.parquet"))], more.get(name, ()))
        for name in _TRUTH_TABLES
    }
    keys, made = folder / "detection_keys.parquet", folder.parent / "detections.parquet"
    if keys.is_file() and made.is_file():  # what a simulated detector saw, and which vehicles are in it
        tables["keys"], tables["detected"] = _parquet(keys, None), _read("detections", [made])
    if (folder / "others.parquet").is_file():
        tables["others"] = _parquet(folder / "others.parquet", None)
    return tables


def _csv_tables(folder: Path) -> dict[str, pd.DataFrame]:
    """Read those CSV files of a truth that are there."""
    return {
        name: _csv(path, columns) if (path := folder / f"{name}.csv").is_file() else pd.DataFrame(columns=columns)
        for name, columns in _CSV.items()
    }


def _file_truth(path: Path, time_zone: str | None) -> Truth | None:
    """Read a truth that is a single file, known by its head; None where it is none."""
    if path.suffix == ".parquet":
        rows = _parquet(path, None)
        named = {"truth_vehicle", "vehicle_id"} & set(rows.columns)
        timed = {"t_utc", "t_s", "image"} & set(rows.columns)
        single = path.stem not in TABLES  # detections.parquet of `simulate` is one of several
        return READERS["labelled"]({"labelled": rows}) if named and timed and single else None
    head = _head(path)
    if set(_GEOTRAX) <= set(head):
        return geotrax_truth({"geotrax": _csv(path, None)}, time_zone=time_zone)
    if head and _is_number(head[0]):
        rows = _boxes(path)
        return READERS["mot" if path.name == "gt.txt" else "boxes"]({"boxes": rows})
    return None


def _boxes(path: Path) -> pd.DataFrame:
    """Read boxes without a head line: frame, id, left, top, width, height, and perhaps a flag."""
    try:
        rows = pd.read_csv(path, header=None)
    except (OSError, ValueError) as problem:
        raise UnusableData(f"{path}: cannot be read ({problem})") from None
    if rows.shape[1] < 6 or not all(pd.api.types.is_numeric_dtype(rows[c]) for c in range(6)):
        first = ", ".join(map(str, rows.iloc[0])) if len(rows) else "nothing"
        raise UnusableData(
            f"{path}: not boxes; expected numbers: frame, id, left, top, width, height, found in its first row: {first}"
        )
    rows = rows.reindex(columns=range(7)).set_axis(["frame", "id", *BOX, "flag"], axis=1)
    return rows.astype({"frame": np.int64} | dict.fromkeys(BOX, float))


def _head(path: Path) -> list[str]:
    try:
        with path.open(encoding="utf-8") as file:
            return [name.strip() for name in file.readline().split(",")]
    except (OSError, UnicodeDecodeError) as problem:
        raise UnusableData(f"{path}: cannot be read ({problem})") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _csv(path: Path, columns: Sequence[str] | None) -> pd.DataFrame:
    """Read a CSV file; raises ``UnusableData`` naming the file and which of *columns* it lacks."""
    try:
        rows = pd.read_csv(path)
    except (OSError, ValueError) as problem:
        raise UnusableData(f"{path}: cannot be read ({problem})") from None
    _require(columns or (), rows.columns, path)
    return rows


def _require(columns: Iterable[str], held: Iterable[str], path: Path) -> None:
    """Raise ``UnusableData`` that names those of *columns* that a file does not hold."""
    there = list(map(str, held))
    if lacking := [name for name in columns if name not in there]:
        found = ", ".join(there) or "none"
        raise UnusableData(f"{path}: columns missing: {', '.join(lacking)}; of those that are read it has: {found}")


def _read(name: str, paths: Sequence[Path], more: Sequence[str] = (), *, strict: bool = True) -> pd.DataFrame:
    """Read the files of the declared table *name*, without its geometry, and columns *more* where they are there.

    No file gives an empty table; nullable columns that a file lacks are null. Unless *strict*, so are all others that
    are not needed to compare anything.
    """
    columns = [column for column in TABLES[name].columns if column.type != "geometry"]
    kinds = {column.name: _PANDAS.get(column.type, "float64") for column in columns} | dict.fromkeys(more, "object")
    parts = [(path, _parquet(path, kinds)) for path in paths if path.is_file()]
    needed = {column.name for column in columns if not column.nullable}
    needed = needed if strict else _NEEDED.get(name, needed & {"vehicle_id", "t_utc", "x_m", "y_m"})
    for path, part in parts:
        _require(sorted(needed), part.columns, path)
    if not strict:
        kinds = {name: "float64" if kind == "bool" else kind for name, kind in kinds.items()}
    whole = [part.reindex(columns=list(kinds)).astype(kinds) for _, part in parts if len(part)]
    return pd.concat(whole, ignore_index=True) if whole else pd.DataFrame(columns=list(kinds)).astype(kinds)


def _parquet(path: Path, kinds: Mapping[str, str] | None) -> pd.DataFrame:
    """Read the columns of *kinds*, or all of them; texts (and ids given as numbers) as text, missing ones as None."""
    try:
        with pq.ParquetFile(path) as file:
            held = [name for name in kinds or () if name in file.schema_arrow.names]
            rows = file.read(columns=held if kinds is not None else None).to_pandas()
    except (OSError, pa.ArrowException) as problem:
        raise UnusableData(f"{path}: cannot be read ({problem})") from None
    if kinds is None:
        return rows
    texts = [name for name in held if kinds[name] == "object"]
    ids = [name for name in texts if "_id" in name and pd.api.types.is_numeric_dtype(rows[name])]
    rows = rows.assign(**{name: rows[name].map(as_text) for name in ids})
    return rows.assign(**{name: rows[name].astype(object).where(rows[name].notna(), None) for name in texts})
