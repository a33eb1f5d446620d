"""Run a peer's script on files: ``python -P exchange.py SCRIPT FOLDER``; called by ``benchmarks/environment.py``."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np


def main(script: str, folder: Path) -> None:
    """Give the script ``in_*.npz`` and ``settings.json``, write what it returns to ``out_*.npz``."""
    spec = importlib.util.spec_from_file_location("peer", script)
    peer = importlib.util.module_from_spec(spec)
    sys.path.append(str(Path(script).parent))
    spec.loader.exec_module(peer)
    tables = {path.stem.removeprefix("in_"): dict(np.load(path)) for path in sorted(folder.glob("in_*.npz"))}
    answers = peer.run(tables, json.loads((folder / "settings.json").read_text()))
    for table, columns in answers.items():
        np.savez(folder / f"out_{table}.npz", **columns)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
