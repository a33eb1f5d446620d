"""The error tree, sorted by the reaction each error calls for.

``VtrackError``
    ``ConfigError``      the survey file or the command is wrong: nothing is done (exit 78)
    ``NoArchive``        the archive is missing or empty: nothing is done (exit 66)
    ``UnusableData``     what was read cannot give results: nothing is published (exit 65)
    ``UnusableFrame``    one frame cannot be used: it is quarantined, the run goes on
    ``CannotCreate``     the output cannot be made (exit 73)
    ``StorageError``     reading or writing failed in mid-run: stop, publish nothing new (exit 74)
    ``Busy``             another run holds the output, or the deadline came (exit 75)

Everything else that is raised is a bug (exit 1).
"""

from __future__ import annotations

from typing import ClassVar


class VtrackError(Exception):
    """Root of all errors that a user can cause or cure."""

    exit_code: ClassVar[int] = 1


class ConfigError(VtrackError):
    """The survey file, a zone file or a parameter is wrong."""

    exit_code = 78


class NoArchive(VtrackError):
    """The archive of frames is missing or holds no frame."""

    exit_code = 66


class UnusableData(VtrackError):
    """The data that were read cannot give a result."""

    exit_code = 65


class UnusableFrame(VtrackError):
    """One frame cannot be used; ``reason`` is a short word for the quarantine table, ``detail`` a sentence."""

    exit_code = 65

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason
        self.detail = detail

    def __reduce__(self) -> tuple[type[UnusableFrame], tuple[str, str]]:
        return type(self), (self.reason, self.detail)


class CannotCreate(VtrackError):
    """The output folder or a file in it cannot be created."""

    exit_code = 73


class StorageError(VtrackError):
    """Reading or writing failed after the run had begun."""

    exit_code = 74


class Busy(VtrackError):
    """Another run holds the output, or the deadline came with work left."""

    exit_code = 75
