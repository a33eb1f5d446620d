"""``vtrack-batch run SURVEY.yaml …`` with the steps of ``stub``."""

from __future__ import annotations

import sys

import stub

from vtrack_batch import cli
from vtrack_batch.pipeline import run

if __name__ == "__main__":
    run._work = stub.work
    sys.argv = ["vtrack-batch", "run", *sys.argv[1:]]
    cli.main()
