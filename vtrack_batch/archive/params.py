"""What the survey file says about the archive of frames."""

from __future__ import annotations

import difflib
import zoneinfo
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from vtrack_batch.archive.patterns import compile_pattern
from vtrack_batch.model.params import Params

LOCAL = "local"
"""Value of ``time_zone`` that means: the survey's own time zone."""


class ArchiveParams(Params):
    """Where the frames lie and how their times are known: a pattern, an index or EXIF; none given = ISO-like names."""

    root: str = Field("frames", min_length=1, description="directory of the frames, relative to the survey file")
    pattern: str | None = Field(
        None,
        description="how names give the time, e.g. '{camera}/{time:%Y%m%dT%H%M%S.%f}.jpg': the whole path below root "
        "if it holds a '/', else the whole file name. {time:...} takes strptime directives, epoch_s, epoch_ms or "
        "epoch_us; a Z inside it means UTC; {camera}, {platform} or {sequence} name the platform; * and any other "
        "{name} match anything",
    )
    index: str | None = Field(
        None,
        description="CSV file with the columns file (path below root) and time (ISO 8601 or epoch seconds), and "
        "optionally platform; its path is relative to the survey file",
    )
    exif: bool = Field(
        False, description="take times from EXIF (DateTimeOriginal, SubSecTimeOriginal, OffsetTimeOriginal)"
    )
    time_zone: str | None = Field(
        None,
        description="zone of stamps that carry none: UTC, an IANA name such as Europe/Berlin, or local for "
        "survey.time_zone; never guessed",
    )
    platform_from: Literal["directory", "none"] = Field(
        "directory",
        description="what tells platforms apart where neither pattern nor index does: the sub-directory, or nothing",
    )
    max_gap_s: float = Field(30.0, ge=1, le=86_400, description="a longer gap between frames ends a sequence")
    settle_s: float = Field(0.0, ge=0, description="files younger than this are left for the next run")
    extensions: tuple[str, ...] = Field(
        (".jpg", ".jpeg", ".png", ".tif", ".tiff"),
        min_length=1,
        description="files with these endings are taken for frames; case does not matter",
    )
    interlaced: bool | None = Field(
        None,
        description="whether frames hold two fields taken one after the other, of which the upper one is used then; "
        "null = told, unit by unit, by the comb that motion makes of them",
    )
    max_pixels: int = Field(200_000_000, gt=0, description="larger frames are refused before decoding")

    @field_validator("pattern")
    @classmethod
    def _pattern_is_readable(cls, pattern: str | None) -> str | None:
        if pattern is not None:
            compile_pattern(pattern)
        return pattern

    @field_validator("time_zone")
    @classmethod
    def _zone_exists(cls, zone: str | None) -> str | None:
        if zone is None or zone == LOCAL:
            return zone
        try:
            zoneinfo.ZoneInfo(zone)
        except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):
            near = difflib.get_close_matches(zone, sorted(zoneinfo.available_timezones()), 1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"{zone!r} is no IANA time zone{hint}") from None
        return zone

    @field_validator("extensions")
    @classmethod
    def _extensions_are_lower_case(cls, extensions: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(sorted({"." + text.lower().lstrip(".") for text in extensions}))

    @model_validator(mode="after")
    def _one_source_of_time(self) -> Self:
        given = [name for name in ("pattern", "index", "exif") if getattr(self, name)]
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)} are given, but times can come from one source only")
        return self
