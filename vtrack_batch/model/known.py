"""What was found out about a file of the archive earlier, so that it need not be opened again."""

from __future__ import annotations

from typing import NamedTuple, Protocol


class KnownFile(NamedTuple):
    """What an earlier scan and read found of a file; it holds as long as size and mtime are the same."""

    size_bytes: int
    mtime_ns: int
    sha256: str | None = None
    stamp: str | None = None


class Known(Protocol):
    """Remembered files by path, as a mapping gives them."""

    def get(self, path: str, /) -> KnownFile | None:
        """Return what is known of the file at *path*, None if nothing is."""
        ...

    def __len__(self) -> int:
        """Return how many files are known."""
        ...
