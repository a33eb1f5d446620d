"""How the cost of matching and tracking grows: ``make bench-scale`` writes a section of docs/performance.md.

Processor time of one core, the best of five runs, or of more where a run is short; peak memory of a process of its
own for every row.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from benchmarks.environment import ONE_THREAD
from benchmarks.page import PERFORMANCE, PROJECT, SHARED, markdown_table, stamp, write_section

ARCHIVE = SHARED / "sumo" / "archive_grid.parquet"
SIZES = (50, 1250, 2500, 5000, 10_000)
METHODS = ("proposed", "untrained", "default")
FRAMES = (200, 400, 800)
FILE_FRAMES = (1000, 4000)
INTERVAL_S = 1.5


def main() -> None:
    """Measure every row in its own process, print and write the tables; with arguments, measure one row."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--row", help="measure one row, as JSON")
    parser.add_argument("--frames", type=int, nargs="*", default=FRAMES, help="lengths tracked in memory")
    parser.add_argument("--file-frames", type=int, nargs="*", default=FILE_FRAMES, help="lengths tracked from a file")
    arguments = parser.parse_args()
    if arguments.row:
        work = json.loads(arguments.row)
        print(json.dumps({**ROWS[work.pop("what")](**work), "peak_mb": peak_mb()}))
        return
    pairs = [measured({"what": "pair", "method": m, "size": n}) for m in METHODS for n in SIZES]
    swept = measured({"what": "sweep"})
    days = [measured({"what": "sequence", "method": m, "frames": n}) for m in METHODS[1:] for n in arguments.frames]
    with TemporaryDirectory() as folder:
        days += [measured(written(Path(folder), frames)) for frames in arguments.file_frames]
    text = "\n\n".join([pair_table(pairs), sweep_line(swept), day_table(days), stamp("make bench-scale")])
    write_section(PERFORMANCE, "scale of matching", f"## Matching and tracking at scale\n\n{text}")
    print(text)


def pair_row(method: str, size: int) -> dict[str, Any]:
    """Match two images of a town of *size* vehicles."""
    from vtrack_batch.matching.match import match

    match(*town(200), elapsed_s=INTERVAL_S, method=method)
    images = town(size)
    seconds = least(lambda: match(*images, elapsed_s=INTERVAL_S, method=method), max(5, 5000 // size))
    return {"method": method, "size": size, "seconds": seconds}


def sweep_row() -> dict[str, Any]:
    """Try the paper's 28,611 settings on one pair of 52 vehicles on a road of 669 m."""
    from vtrack_batch.matching.candidates import candidates
    from vtrack_batch.matching.colour import colour_labels
    from vtrack_batch.matching.params import MatchingParams
    from vtrack_batch.matching.relaxation import paper_grid, sweep

    rng = np.random.default_rng(1)
    xy = np.column_stack([rng.uniform(0, 669, 52), rng.choice([0.0, 3.5], 52)])
    later, rgb = xy + np.array([21.0, 0.0]) + rng.normal(0, 1, xy.shape), rng.uniform(20, 235, (52, 3))
    params = MatchingParams()
    edges = candidates(xy, later, params.reach_m(INTERVAL_S))
    labels = colour_labels(edges, rgb, rgb)

    def run(settings: Any) -> Any:
        tolerance = params.paper.consistency_m(INTERVAL_S)
        return sweep(edges, labels, xy, later, settings=settings, tolerance=tolerance, params=params.paper)

    run(paper_grid()[:64])
    return {"edges": len(edges), "seconds": least(lambda: run(paper_grid()), 2)}


def sequence_row(method: str, frames: int) -> dict[str, Any]:
    """Track *frames* of the pinned grid's archive, laid end to end."""
    from vtrack_batch.tracking.track import track

    rows = sequence(frames)
    track(rows.head(3000), method=method)
    start = time.process_time()
    tracks = track(rows, method=method)
    seconds = time.process_time() - start
    found = {"sightings": len(rows), "tracks": len(tracks.trajectories)}
    return {"method": method, "frames": frames, "seconds": seconds, **found}


def file_row(path: str, frames: int) -> dict[str, Any]:
    """Track a Parquet table as ``vtrack-batch track`` does: read by row groups, written window by window."""
    from vtrack_batch.pipeline.tables import track_file

    start = time.process_time()
    made = track_file(Path(path), Path(path).with_suffix(""))
    seconds = time.process_time() - start
    found = {"sightings": pq.ParquetFile(path).metadata.num_rows, "tracks": made["trajectories"]}
    return {"method": "default, from file to files", "frames": frames, "seconds": seconds, **found}


ROWS: dict[str, Callable[..., dict[str, Any]]] = {
    "pair": pair_row,
    "sweep": sweep_row,
    "sequence": sequence_row,
    "file": file_row,
}


def town(size: int, seed: int = 0) -> list[pd.DataFrame]:
    """Two images of *size* vehicles on streets some 100 m apart, 15 vehicles to the hectare, none missed.

    Streets are as near to 100 m as fill the town evenly: at every size as many vehicles stand on a kilometre of them.
    """
    rng = np.random.default_rng(seed)
    side = np.sqrt(size / 15) * 100
    streets = max(round(side / 100), 1)
    along, lane = rng.uniform(0, side, size), (rng.integers(0, streets, size) + 0.5) * side / streets
    upright, sense = rng.integers(0, 2, size)[:, None] == 0, rng.choice([-1, 1], size)
    speed = sense * np.clip(9 + 4 * np.sin(along / 150 + lane) + rng.normal(0, 1.2, size), 0, None)
    paint = rng.choice([235, 25, 120, 185, 90], size)[:, None] + rng.normal(0, 20, (size, 3))
    images = []
    for image in range(2):
        at, beside = along + speed * INTERVAL_S * image, lane + sense * 3.0
        xy = np.where(upright, np.column_stack([beside, at]), np.column_stack([at, beside]))
        table = pd.DataFrame(xy + rng.normal(0, 0.33, xy.shape), columns=["x_m", "y_m"])
        light = 1 + rng.normal(0, 0.04, (size, 1))
        table[["red", "green", "blue"]] = np.clip(paint * light + rng.normal(0, 3, (size, 3)), 0, 255)
        table["detection_id"] = np.arange(size)
        images.append(table.sample(frac=1, random_state=image))
    return images


def sequence(frames: int) -> pd.DataFrame:
    """Some 270 vehicles in every frame of 1.5 s: the pinned grid's archive, repeated."""
    archive = pd.read_parquet(ARCHIVE)
    archive = archive[np.isclose(archive["t_s"] % INTERVAL_S, 0)]
    number = (archive["t_s"] / INTERVAL_S).round().astype(int)
    length = int(number.max()) + 1
    turns = [archive.assign(frame=number + turn * length) for turn in range(-(-frames // length))]
    rows = pd.concat(turns, ignore_index=True)
    rows = rows[rows["frame"] < frames].reset_index(drop=True)
    t_utc = pd.Timestamp("2026-05-17T00:00:00Z") + pd.to_timedelta(rows["frame"] * INTERVAL_S, unit="s")
    return rows[["x_m", "y_m", "red", "green", "blue"]].assign(detection_id=np.arange(len(rows)), t_utc=t_utc)


def written(folder: Path, frames: int) -> dict[str, Any]:
    """Write *frames* as a Parquet table in row groups of 100,000 rows; returns the row that tracks it."""
    path = folder / f"{frames}.parquet"
    sequence(frames).to_parquet(path, row_group_size=100_000, index=False)
    return {"what": "file", "path": str(path), "frames": frames}


def least(run: Callable[[], Any], times: int) -> float:
    """Return the least processor time of several runs."""
    found = []
    for _ in range(times):
        start = time.process_time()
        run()
        found.append(time.process_time() - start)
    return min(found)


def peak_mb() -> float:
    """Return the most memory that this process held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measured(work: dict[str, Any]) -> dict[str, Any]:
    """Return what one row measures in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.scale_matching", "--row", json.dumps(work)]
    alone = {**os.environ, **ONE_THREAD}
    done = subprocess.run(command, cwd=PROJECT, env=alone, capture_output=True, text=True, check=True)
    row: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    print(row, file=sys.stderr, flush=True)
    return row


def pair_table(rows: list[dict[str, Any]]) -> str:
    """Return time and memory by number of vehicles; growth is the factor from half as many."""
    cells = []
    for row in rows:
        half = [r for r in rows if r["method"] == row["method"] and 2 * r["size"] == row["size"]]
        growth = f"{row['seconds'] / half[0]['seconds']:.2f}" if half else "–"
        cells.append(
            [row["method"], f"{row['size']:,}", f"{1e3 * row['seconds']:.1f}", growth, f"{row['peak_mb']:.0f}"]
        )
    return markdown_table(["two images", "vehicles", "ms", "× half as many", "peak MB"], cells)


def sweep_line(row: dict[str, Any]) -> str:
    """Return the sentence on the paper's grid search."""
    return f"The paper's 28,611 settings of A, B, C on 52 vehicles ({row['edges']} candidates): {row['seconds']:.1f} s."


def day_table(rows: list[dict[str, Any]]) -> str:
    """Return time and memory by length of the sequence, and what a day of 57,600 frames would take.

    A day is reckoned by what the frames take that a longer sequence has more than the one in the row above: what is
    done once, such as learning a first flow map, weighs little in a day.
    """
    cells = []
    for above, row in zip([None, *rows], rows, strict=False):
        less = above if above is not None and above["method"] == row["method"] else {"seconds": 0.0, "frames": 0}
        ms = 1e3 * (row["seconds"] - less["seconds"]) / (row["frames"] - less["frames"])
        minutes = (less["seconds"] + (57600 - less["frames"]) * ms / 1e3) / 60
        cells.append(
            [row["method"], f"{row['frames']:,}", f"{row['sightings']:,}", f"{row['seconds']:.1f}", f"{ms:.1f}",
             f"{minutes:.0f}", f"{row['peak_mb']:.0f}"]
        )  # fmt: skip
    heads = ["track", "frames", "sightings", "s", "ms a further frame", "min a day", "peak MB"]
    return markdown_table(heads, cells)


if __name__ == "__main__":
    main()
