"""All sections of a survey file, composed from the parameters that each chapter declares beside its algorithm."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Annotated
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError, available_timezones

from pydantic import AfterValidator, AwareDatetime, Field, PrivateAttr, model_validator

from vtrack_batch.archive.params import ArchiveParams
from vtrack_batch.background.params import BackgroundParams
from vtrack_batch.completeness.params import CompletenessParams
from vtrack_batch.detection.params import DetectionParams
from vtrack_batch.georeference.params import GeoreferenceParams
from vtrack_batch.matching.params import MatchingParams
from vtrack_batch.model.params import Params
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.revision.params import RevisionParams
from vtrack_batch.tracking.params import TrackingParams
from vtrack_batch.traffic.params import TrafficParams


def _known_zone(name: str) -> str:
    try:
        ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        near = difflib.get_close_matches(name, [zone for zone in available_timezones() if "/" in zone], n=1)
        hint = f'; did you mean "{near[0]}"?' if near else ", such as Europe/Berlin or Asia/Tokyo"
        raise ValueError(f"expected the name of an IANA time zone, found {name!r}{hint}") from None
    return name


class SurveyParams(Params):
    """What the survey is called, and the clock by which its days and bins are cut."""

    name: str = Field("survey", min_length=1, max_length=80, description="Name shown in reports.")
    time_zone: Annotated[str, AfterValidator(_known_zone)] = Field(
        "UTC", description="IANA zone whose local date divides the tables and whose clock aligns the bins."
    )
    start: AwareDatetime | None = Field(
        None, description='Frames before this moment are set aside, as "2026-05-17T06:00:00+09:00".'
    )
    end: AwareDatetime | None = Field(None, description="Frames from this moment on are set aside.")

    @model_validator(mode="after")
    def _in_order(self) -> SurveyParams:
        if self.start and self.end and self.start >= self.end:
            raise ValueError(f"survey.start ({self.start}) is not before survey.end ({self.end})")
        return self


class OutputParams(Params):
    """Where results go, and how many losses are tolerable."""

    root: str = Field("results", min_length=1, description="Folder of the results, relative to the survey file.")
    quarantine_tolerance: float = Field(
        0.05, ge=0, le=1, description="Share of frames in quarantine above which `run` ends with exit code 3."
    )


class ExecutionParams(Params):
    """How the work is cut and dealt out; nothing here changes a result but unit_s and halo_s."""

    workers: int = Field(1, ge=1, le=1024, description="Processes that work at the same time.")
    cluster: str | None = Field(
        None, description="Address of a Dask scheduler, such as tcp://host:8786, whose workers do the work instead."
    )
    frame_limit_s: float = Field(
        120.0, gt=0, le=3600, description="A worker that stays at one frame for longer is ended, the frame set aside."
    )
    memory_mb: int | None = Field(
        None, ge=512, description="Memory that one worker process may ask for; without it, what the machine has."
    )
    unit_s: float = Field(600.0, gt=0, description="Length of a unit of work, aligned to the clock in UTC.")
    halo_s: float = Field(
        120.0, ge=0, description="Frames this near to a unit also serve as samples for its background."
    )


class Survey(Params):
    """A whole survey file; every section has defaults that serve the example survey."""

    survey: SurveyParams = Field(default_factory=SurveyParams, description="Name and clock of the survey.")
    archive: ArchiveParams = Field(
        default_factory=ArchiveParams, description="Where the frames are and how their times are known."
    )
    georeference: GeoreferenceParams = Field(
        default_factory=GeoreferenceParams, description="How pixels become metres on the ground."
    )
    registration: RegistrationParams = Field(
        default_factory=RegistrationParams, description="How frames are laid onto their block's reference frame."
    )
    background: BackgroundParams = Field(
        default_factory=BackgroundParams,
        description="The ground without vehicles, learned from each block's own frames.",
    )
    detection: DetectionParams = Field(
        default_factory=DetectionParams, description="What counts as a vehicle in a single frame."
    )
    completeness: CompletenessParams = Field(
        default_factory=CompletenessParams,
        description="Known vehicles painted into copies of frames, to count how many are found again.",
    )
    matching: MatchingParams = Field(default_factory=MatchingParams, description="Who is who in the next frame.")
    tracking: TrackingParams = Field(default_factory=TrackingParams, description="How matches become trajectories.")
    revision: RevisionParams = Field(
        default_factory=RevisionParams,
        description="What a first tracking tells of the detections, before they are tracked again.",
    )
    zones: str | None = Field(
        None, description="GeoJSON of gates, zones, approaches, lanes and exclusions; without it zones are proposed."
    )
    flow_map: str | None = Field(
        None,
        description="Flow map of the place, made by `learn`, of this survey's coordinates; without it each sequence "
        "teaches its own.",
    )
    traffic: TrafficParams = Field(
        default_factory=TrafficParams, description="Time bins and thresholds of the measures."
    )
    output: OutputParams = Field(default_factory=OutputParams, description="Where results go.")
    execution: ExecutionParams = Field(
        default_factory=ExecutionParams, description="How the work is cut and dealt out."
    )

    _base: Path = PrivateAttr(default_factory=Path.cwd)

    @property
    def base(self) -> Path:
        """The folder of the survey file; paths in it are relative to this."""
        return self._base

    def resolve(self, path: str) -> Path:
        """Return *path* of the survey file as an absolute path."""
        return (self._base / path).resolve()

    @property
    def model_path(self) -> str | None:
        """The file of the model of links as an absolute path, None where none is named."""
        return None if self.matching.model is None else str(self.resolve(self.matching.model))

    def based_at(self, folder: Path) -> Survey:
        """Return the same survey with its relative paths resolved against *folder*."""
        copy = self.model_copy()
        copy._base = folder.resolve()
        return copy
