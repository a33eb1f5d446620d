"""Run other people's programs in environments of their own: what a peer needs never meets what the project needs.

``benchmarks/peers/NAME.txt`` pins every package of an environment, dependencies included (nothing else is installed).
``benchmarks/peers/SCRIPT.py`` holds ``run(tables, settings) -> tables``; tables are dicts of columns (NumPy arrays),
settings a dict of plain values. Script and project exchange them as files, so the peer needs NumPy and nothing of ours.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import venv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from filelock import FileLock

from benchmarks.page import PROJECT

PEERS = PROJECT / "benchmarks" / "peers"
BUILT = PROJECT / "build" / "peers"
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


def python_of(name: str) -> Path:
    """Return the interpreter of environment *name*; made once, and again when its list of packages has changed."""
    listed = PEERS / f"{name}.txt"
    wanted = hashlib.sha256(listed.read_bytes() + sys.version.encode()).hexdigest()
    place = BUILT / name
    python, stamp = place / "bin" / "python", place / "made-from"
    BUILT.mkdir(parents=True, exist_ok=True)
    with FileLock(BUILT / f"{name}.lock"):
        if not (stamp.is_file() and stamp.read_text() == wanted):
            shutil.rmtree(place, ignore_errors=True)
            venv.create(place, with_pip=True)
            pip = [
                python,
                "-m",
                "pip",
                "install",
                "--quiet",
                "--disable-pip-version-check",
                "--no-compile",
                "--no-deps",
                "-r",
                listed,
            ]
            subprocess.run(list(map(str, pip)), check=True)
            stamp.write_text(wanted)
    return python


def run_peer(name: str, script: str, tables_in: Mapping[str, pd.DataFrame], **settings: Any) -> dict[str, pd.DataFrame]:
    """Run ``benchmarks/peers/SCRIPT.py`` in environment *name* on one thread; return the tables it answers with.

    Columns are numbers or text. By custom the answer holds a table ``seconds``, measured inside, after warm-up.
    """
    with tempfile.TemporaryDirectory() as folder:
        for table, rows in tables_in.items():
            np.savez(Path(folder) / f"in_{table}.npz", **_columns(rows))
        (Path(folder) / "settings.json").write_text(json.dumps(settings))
        # -P: the script's folder stays out of the path, or peers/trackpy.py would be what it imports
        command = [python_of(name), "-P", PEERS / "exchange.py", PEERS / f"{script}.py", folder]
        subprocess.run(list(map(str, command)), check=True, env={**os.environ, **ONE_THREAD})
        return {
            path.stem.removeprefix("out_"): pd.DataFrame(dict(np.load(path)))
            for path in sorted(Path(folder).glob("out_*.npz"))
        }


def pinned(name: str) -> str:
    """Return ``NAME VERSION`` of the package after which an environment is called, as its list says."""
    lines = (PEERS / f"{name}.txt").read_text().splitlines()
    return next(line for line in lines if line.startswith(f"{name}==")).replace("==", " ")


def _columns(rows: pd.DataFrame) -> dict[str, np.ndarray]:
    """Return the columns as arrays that need no pickling: text is fixed-width."""
    columns = {name: rows[name].to_numpy() for name in rows}
    return {name: values.astype(str) if values.dtype == object else values for name, values in columns.items()}
