"""What each file of the frame zoo costs: time and memory of its decoding, and its outcome.

``python -m benchmarks.zoo`` (`make bench-zoo`) writes the section ``zoo`` of docs/reliability.md. The files are those
of tests/archive/frame_zoo.py, which also says what they are; the promise is 1 s and 500 MB each.
"""

from __future__ import annotations

import sys
import time
from collections import Counter

from benchmarks.faults import PAGE
from benchmarks.page import PROJECT, markdown_table, stamp, write_section

sys.path.insert(0, str(PROJECT / "tests" / "archive"))

from frame_zoo import ZOO, memory_mb, outcome

DECODERS = ("vtrack-batch", "simplejpeg", "opencv-python-headless", "rasterio")


def main() -> None:
    """Measure each file: memory when it is decoded first, with what that loads, time when all is loaded."""
    outcomes: Counter[str] = Counter()
    most_mb, largest = max(
        (memory_mb(lambda data=data: outcomes.update([outcome(data)])), n) for n, data in ZOO.items()
    )
    slowest_s, slowest = max((seconds_of(data), name) for name, data in ZOO.items())
    rows = [[name, str(count)] for name, count in outcomes.most_common()]
    told = (
        f"{len(ZOO)} files. The slowest: {slowest}, {1e3 * slowest_s:.1f} ms. The most memory beyond what the process "
        f"held before, libraries included: {largest}, {most_mb:.1f} MB."
    )
    table = markdown_table(["outcome", "files"], rows)
    text = f"## Frame zoo\n\n{told}\n\n{table}\n\n{stamp('python -m benchmarks.zoo', DECODERS)}"
    write_section(PAGE, "zoo", text)
    print(text)


def seconds_of(data: bytes) -> float:
    """Return the wall clock of one decoding."""
    began_s = time.perf_counter()
    outcome(data)
    return time.perf_counter() - began_s


if __name__ == "__main__":
    main()
