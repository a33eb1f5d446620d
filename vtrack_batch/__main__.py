"""``python -m vtrack_batch`` is ``vtrack-batch``."""

from vtrack_batch.cli import main

if __name__ == "__main__":
    main()
