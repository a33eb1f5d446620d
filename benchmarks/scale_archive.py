"""How indexing, planning and doing nothing grow with the archive: tiny generated files, a process for each step.

``python -m benchmarks.scale_archive 100000 1000000`` writes the section ``archive`` of docs/performance.md.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.page import PERFORMANCE, markdown_table, stamp, write_section

FOLDER_FRAMES = 10_000
SURVEY = "archive: {root: frames, time_zone: UTC}\ngeoreference: {gsd_m: 0.3}\n"


STEPS = ("first index", "second index", "plan", "nothing changed")


def main(counts: list[int]) -> None:
    """Measure archives of so many frames each; write what was found and what ten million would take."""
    rows, per_frame = [], {}
    for count in counts:
        folder = Path(tempfile.mkdtemp(prefix="vtrack-scale-"))
        try:
            make_archive(folder, count)
            first, second, nothing = (measured(folder, step) for step in ("index", "index", "listing"))
        finally:
            shutil.rmtree(folder)
        seconds = [first["index_s"], second["index_s"], second["plan_s"], nothing["listing_s"]]
        peak_mb = max(one["peak_mb"] for one in (first, second, nothing))
        per_frame[count] = [*seconds, peak_mb]
        rows.append([f"{count:,}", *(f"{value:.1f}" for value in seconds), f"{peak_mb:.0f}"])
    low, high = min(per_frame), max(per_frame)
    if low < high:
        slopes = [(b - a) / (high - low) for a, b in zip(per_frame[low], per_frame[high], strict=True)]
        far = [b + slope * (10**7 - high) for b, slope in zip(per_frame[high], slopes, strict=True)]
        rows.append(["10,000,000 (by the slope)", *(f"{value:.0f}" for value in far)])
    heads = ["frames", *(f"{step}, CPU s" for step in STEPS), "peak MB"]
    command = f"python -m benchmarks.scale_archive {' '.join(map(str, counts))}"
    text = f"{INTRODUCTION}\n\n{markdown_table(heads, rows)}\n\n{stamp(command)}"
    write_section(PERFORMANCE, "archive", text)
    print(text)


INTRODUCTION = """## Large archives

Files of a few bytes, 1 s apart, in folders of 10,000. *First index*: each file read and hashed. *Second index*:
names, sizes and times compared with what is remembered, as after a day's new frames. *Plan*: units and keys. *Nothing
changed*: what `run` and `status` do when names, sizes and times are as the last run saw them. CPU seconds of one
process."""


def make_archive(folder: Path, count: int) -> None:
    """Write *count* frames of a few bytes, 1 s apart, an hour old, each with a content of its own."""
    start_s = 1_779_000_000
    old_s = time.time() - 3600
    for number in range(count):
        place = folder / "frames" / f"{number // FOLDER_FRAMES:05d}"
        if number % FOLDER_FRAMES == 0:
            place.mkdir(parents=True)
        stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(start_s + number))
        path = f"{place}/{stamp}.jpg"
        with open(path, "wb") as stream:  # noqa: PTH123 # a path object costs more than the file
            stream.write(b"%d" % number)
    for path in (folder / "frames").rglob("*.jpg"):
        os.utime(path, (old_s, old_s))
    (folder / "survey.yaml").write_text(SURVEY.replace("UTC}", "UTC, platform_from: none}"))
    (folder / "results" / "state").mkdir(parents=True)


def measured(folder: Path, step: str) -> dict[str, float]:
    """Return seconds and peak memory of *step* in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.scale_archive", "--step", step, str(folder)]
    return dict(json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout))


def in_process(step: str, folder: Path) -> dict[str, float]:
    """Do *step* here."""
    found: dict[str, float] = {}
    began_s = time.process_time()
    if step == "listing":
        from vtrack_batch.archive.walk import listing_of

        assert listing_of(folder / "frames") is not None
        found["listing_s"] = time.process_time() - began_s
    else:
        from vtrack_batch.config.load import load_survey
        from vtrack_batch.pipeline.culprits import Culprits
        from vtrack_batch.pipeline.index import make_index
        from vtrack_batch.pipeline.plan import make_plan
        from vtrack_batch.storage.hashes import FileStore

        survey = load_survey(folder / "survey.yaml")
        began_s = time.process_time()
        index = make_index(survey, FileStore(folder / "results" / "state" / "files.sqlite"), Culprits({}))
        found["index_s"] = time.process_time() - began_s
        began_s = time.process_time()
        found["pieces"] = len(make_plan(index.frames, survey, zones_text=None, learned={}).pieces())
        found["plan_s"] = time.process_time() - began_s
    found["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return found


if __name__ == "__main__":
    if sys.argv[1] == "--step":
        print(json.dumps(in_process(sys.argv[2], Path(sys.argv[3]))))
    else:
        main([int(text) for text in sys.argv[1:]] or [100_000, 1_000_000])
