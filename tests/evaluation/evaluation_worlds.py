"""A small world with known traffic, the truth that describes it, and results with injected errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from vtrack_batch.evaluation.load import load_result
from vtrack_batch.evaluation.sides import Result, Truth
from vtrack_batch.model.tables import TABLES

START = pd.Timestamp("2026-05-17T08:00:00Z").as_unit("us")
WIDTH, HEIGHT, GSD_M, STEP_S = 1200, 700, 0.33, 1.5
FRAMES, VEHICLES = 40, 24
PLACES = ("north", "east", "south")


def world() -> pd.DataFrame:
    """One row per vehicle and frame: lanes 25 px apart, speeds and entries differ, every third vehicle stands."""
    rows = []
    for k in range(VEHICLES):
        speed = 0.0 if k % 3 == 0 else 4.0 + 0.5 * k
        first, last = k % 5, FRAMES - 1 - (k % 4)
        for f in range(first, last + 1):
            col = 40.0 + 3 * k + speed * STEP_S / GSD_M * (f - first)
            if col < WIDTH - 30:
                rows.append((f, f"car {k:02d}", col, 40.0 + 25 * k, speed, 30.0 if speed == 0 else 0.0, 20.0 + 9 * k))
    table = pd.DataFrame(rows, columns=["frame", "vehicle", "col_px", "row_px", "speed_mps", "standing_s", "luminance"])
    table["t_utc"] = START + pd.to_timedelta(table["frame"] * STEP_S, unit="s").astype("timedelta64[us]")
    table["track"] = "v-" + table["vehicle"]
    return table.assign(x_m=table["col_px"] * GSD_M, y_m=-table["row_px"] * GSD_M)


def trips() -> pd.DataFrame:
    """Where each vehicle of the world comes from and goes to."""
    k = np.arange(VEHICLES)
    ends = [PLACES[i % 3] for i in k], [PLACES[(i + 1 + i // 12) % 3] for i in k]
    return pd.DataFrame({"vehicle": [f"car {i:02d}" for i in k], "origin": ends[0], "destination": ends[1]})


def empty(name: str, rows: int = 0) -> pd.DataFrame:
    """The declared table *name* with nulls and zeros."""
    blank = {"text": None, "category": "", "time": START, "bool": True}
    columns = [c for c in TABLES[name].columns if c.type != "geometry"]
    return pd.DataFrame({c.name: [None if c.nullable else blank.get(c.type, 0)] * rows for c in columns})


def table(name: str, rows: int, **columns: object) -> pd.DataFrame:
    """The declared table *name* with the given columns, everything else blank."""
    return empty(name, rows).assign(**columns)


def frames_table(count: int = FRAMES, pattern: str = "f{:04d}.jpg", step_s: float = STEP_S) -> pd.DataFrame:
    """The result's frames, all used."""
    numbers = range(count)
    return table(
        "frames",
        count,
        frame_id=[f"frame{f:04d}" for f in numbers],
        sequence="a",
        path=["pass/" + pattern.format(f) for f in numbers],
        t_utc=START + pd.to_timedelta(np.arange(count) * step_s, unit="s").astype("timedelta64[us]"),
        width_px=WIDTH,
        height_px=HEIGHT,
        status="used",
    )


def od_table(ends: pd.DataFrame, factor: float = 1.0) -> pd.DataFrame:
    """Counts of trips in bins of 30 s, the trips dealt out to the bins in turn."""
    ends = ends.assign(bin_start_utc=START + pd.to_timedelta(30 * (np.arange(len(ends)) % 4), unit="s"))
    counts = ends.groupby(["origin", "destination", "bin_start_utc"]).size().rename("count").reset_index()
    return table(
        "od_pairs",
        len(counts),
        origin=counts["origin"],
        destination=counts["destination"],
        vehicle_class="all",
        bin_start_utc=counts["bin_start_utc"].astype("datetime64[us, UTC]"),
        bin_s=30,
        count=factor * counts["count"],
        observed_s=30.0,
        status="observed",
    )


def turn_table(ends: pd.DataFrame, factor: float = 1.0) -> pd.DataFrame:
    """The same trips as turns: the approach is the origin, the movement the destination."""
    od = od_table(ends, factor)
    same = {name: od[name] for name in ("vehicle_class", "bin_start_utc", "bin_s", "count", "observed_s", "status")}
    return table("turns", len(od), junction="j", approach=od["origin"], movement=od["destination"], **same)


def result_of(
    seen: pd.DataFrame, frames: pd.DataFrame | None = None, ends: pd.DataFrame | None = None, factor: float = 1.0
) -> Result:
    """What a run would have published that saw *seen*: columns of ``world``; ``track`` null = on no track."""
    frames = frames_table() if frames is None else frames
    ends = trips() if ends is None else ends
    seen = seen.sort_values(["frame", "vehicle"]).reset_index(drop=True)
    ids = [f"d{i:05d}" for i in np.random.default_rng(5).permutation(len(seen))]
    by_number = frames.assign(n=range(len(frames))).set_index("n")
    place = {"x_m": seen["col_px"] * GSD_M, "y_m": -seen["row_px"] * GSD_M}
    when = {"t_utc": seen["frame"].map(by_number["t_utc"]).astype("datetime64[us, UTC]")}
    detections = table(
        "detections",
        len(seen),
        detection_id=ids,
        frame_id=seen["frame"].map(by_number["frame_id"]),
        col_px=seen["col_px"],
        row_px=seen["row_px"],
        **when,
        **place,
    )
    points = table(
        "track_points",
        len(seen),
        vehicle_id=seen["track"],
        detection_id=ids,
        speed_mps=seen["speed_mps"],
        speed_sigma_mps=0.25,
        state="moving",
        **when,
        **place,
    ).dropna(subset=["vehicle_id"])
    trajectories = table(
        "trajectories",
        len(ends),
        vehicle_id="v-" + ends["vehicle"],
        origin=ends["origin"],
        destination=ends["destination"],
    )
    tables = (frames, detections, points, trajectories, od_table(ends, factor), turn_table(ends, factor))
    return Result(*tables, quarantine=empty("quarantine"))


def truth_of(rows: pd.DataFrame) -> Truth:
    """The truth in declared tables for *rows* of the world."""
    frames = pd.DataFrame({"frame": range(FRAMES), "t_utc": frames_table()["t_utc"]})
    sightings = rows.drop(columns=["t_utc", "track"]).assign(motion="mover", length_px=np.nan, whole=True)
    ends = trips()
    trajectories = table(
        "trajectories", len(ends), vehicle_id=ends["vehicle"], origin=ends["origin"], destination=ends["destination"]
    )
    nowhere = pd.DataFrame({"frame": np.empty(0, np.int64), "col_px": np.empty(0), "row_px": np.empty(0)})
    boxes = pd.DataFrame(
        {"frame": np.empty(0, np.int64)} | {k: np.empty(0) for k in ("left", "top", "width", "height")}
    )
    return Truth("tables", frames, sightings, nowhere, boxes, trajectories, od_table(ends), turn_table(ends))


def shuffled(result: Result, seed: int) -> Result:
    """The same tables with their rows in another order."""
    names = ("frames", "detections", "track_points", "trajectories", "od_pairs", "turns", "matches", "flows")
    return replace(
        result,
        **{name: getattr(result, name).sample(frac=1, random_state=seed).reset_index(drop=True) for name in names},
    )


def write_result(result: Result, out: Path) -> Path:
    """Write *result* as a published snapshot, two days a table, the way runs do."""
    snapshot = out / "snapshots" / "000001"
    for name in ("frames", "detections", "track_points", "trajectories", "od_pairs", "turns", "quarantine"):
        rows = getattr(result, name)
        for day, part in (("2026-05-17", rows[::2]), ("2026-05-18", rows[1::2])):
            folder = snapshot / name / f"date={day}"
            folder.mkdir(parents=True)
            texts = [c.name for c in TABLES[name].columns if c.type == "category"]
            part.astype(dict.fromkeys(texts, "category")).to_parquet(folder / "part.parquet", index=False)
    (out / "current").symlink_to(Path("snapshots") / "000001")
    return out


def written_and_read(result: Result, out: Path) -> Result:
    """The same result through Parquet."""
    return load_result(write_result(result, out))
