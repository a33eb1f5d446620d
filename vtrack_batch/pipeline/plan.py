"""Which pieces of work are due, and why: a pure plan made from keys.

A key is the hash of all that a piece depends on: content hashes of its inputs, the parameters that its step reads, the
step's algorithm version, and the keys of the pieces it builds on. A piece whose part exists under its key is done.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, overload

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import ConfigError
from vtrack_batch.model.ids import frame_id
from vtrack_batch.storage.output import digest

Step = Literal["detect", "track", "traffic", "picture"]
STEPS: tuple[Step, ...] = ("detect", "track", "traffic", "picture")

ALGORITHM: Mapping[Step, int] = {"detect": 9, "track": 6, "traffic": 2, "picture": 3}
"""Raised whenever a step may give other results from the same inputs and parameters."""

SITE_CANDIDATES = 5


@dataclass(frozen=True)
class FrameRef:
    """A frame without its pixels."""

    path: str
    t_utc: np.datetime64
    sha256: str
    beside: str = ""
    """Hash of the world file beside it, if there is one."""

    @property
    def frame_id(self) -> str:
        """Return the frame's id, made from its path."""
        return frame_id(self.path)


class Refs(Sequence[FrameRef]):
    """Frames of a plan by their place in its table, made when they are asked for; sent to a worker, they are all made.

    A plan of years holds many; each is needed for a moment when its unit's key is made, and when its unit is due.
    """

    def __init__(self, table: pd.DataFrame, places: NDArray[np.int64]) -> None:
        self._table, self._places = table, places

    def __len__(self) -> int:
        return len(self._places)

    def __iter__(self) -> Iterator[FrameRef]:
        # row by row, text in many chunks would be copied as a whole each time; frames of a unit are neighbours
        runs = np.split(self._places, np.flatnonzero(np.diff(self._places) != 1) + 1)
        return iter([ref for run in runs if len(run) for ref in refs_of(self._table.iloc[run[0] : run[-1] + 1])])

    @overload
    def __getitem__(self, at: int) -> FrameRef: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[FrameRef]: ...
    def __getitem__(self, at: int | slice) -> FrameRef | Sequence[FrameRef]:
        """Return one frame, or several."""
        places = self._places[at]
        return Refs(self._table, places) if isinstance(at, slice) else refs_of(self._table.iloc[int(places) :][:1])[0]

    def __reduce__(self) -> tuple[type[tuple[FrameRef, ...]], tuple[tuple[FrameRef, ...]]]:
        return tuple, (tuple(self),)


@dataclass(frozen=True)
class Unit:
    """A clock-aligned piece of a sequence: the smallest piece that is detected as a whole.

    ``halo`` are the neighbours whose frames also serve as samples of the background; ``site`` the first frames of the
    sequence, of which the first that can be read is the frame to which the georeference belongs.
    """

    sequence: str
    date: str
    start_s: float
    frames: Sequence[FrameRef]
    halo: Sequence[FrameRef]
    site: Sequence[FrameRef]

    @property
    def name(self) -> str:
        """What people call it."""
        start = np.datetime64(int(self.start_s), "s")
        return f"{self.sequence} {start}Z"


@dataclass(frozen=True)
class Piece:
    """One piece of work: a step on a unit, a sequence or a date, with the key of its result."""

    step: Step
    name: str
    key: str
    ingredients: Mapping[str, str]
    """Name → hash of each thing the key is made of; tells people why a piece is due."""
    unit: Unit | None = None
    needs: tuple[Piece, ...] = ()


@dataclass(frozen=True)
class Plan:
    """Every piece of the survey, by step."""

    detect: tuple[Piece, ...]
    track: tuple[Piece, ...]
    traffic: tuple[Piece, ...]
    picture: tuple[Piece, ...]

    def pieces(self) -> tuple[Piece, ...]:
        """Return all pieces in an order in which each comes after what it needs."""
        return (*self.detect, *self.track, *self.traffic, *self.picture)

    @property
    def dates(self) -> tuple[str, ...]:
        """Return the local dates of the plan."""
        return tuple(piece.name for piece in self.traffic)

    def restricted(self, dates: Collection[str]) -> Plan:
        """Return the pieces of these local dates."""
        return Plan(*(tuple(p for p in pieces if date_of(p) in dates) for pieces in self._steps()))

    def without(self, due: Collection[Piece]) -> Plan:
        """Return the dates of which no piece is *due*."""
        return self.restricted(set(self.dates) - {date_of(piece) for piece in due})

    def followers(self, pieces: Collection[Piece]) -> list[Piece]:
        """Return *pieces* and all that builds on them, each after what it needs."""
        keys = {piece.key for piece in pieces}
        found = []
        for piece in self.pieces():
            if piece.key in keys or any(need.key in keys for need in piece.needs):
                keys.add(piece.key)
                found.append(piece)
        return found

    def _steps(self) -> tuple[tuple[Piece, ...], ...]:
        return (self.detect, self.track, self.traffic, self.picture)


def make_plan(
    frames: pd.DataFrame, survey: Survey, *, zones_text: str | None, learned: Mapping[str, str | None]
) -> Plan:
    """Return the plan of *survey* for the indexed *frames*; *learned* holds hashes of files learned elsewhere."""
    settings = {step: _settings(survey, step, zones_text, learned) for step in STEPS}
    units = cut_units(frames, unit_s=survey.execution.unit_s, halo_s=survey.execution.halo_s)
    site = _named_site(frames, survey.georeference.reference_frame)
    if site is not None:
        units = [replace(unit, site=(site,)) for unit in units]
    detect = tuple(_piece("detect", unit.name, settings, {"frames": _frames_hash(unit)}, unit=unit) for unit in units)
    track = tuple(
        _piece("track", sequence, settings, {}, needs=tuple(pieces))
        for sequence, pieces in _grouped(detect, "sequence")
    )
    by_date: dict[str, list[Piece]] = {}
    for piece in track:
        by_date.setdefault(_unit_of(piece).date, []).append(piece)
    traffic = tuple(_piece("traffic", date, settings, {}, needs=tuple(by_date[date])) for date in sorted(by_date))
    picture = tuple(
        _piece("picture", piece.name, settings, {}, needs=(piece, whole)) for whole in traffic for piece in whole.needs
    )
    return Plan(detect, track, traffic, picture)


def cut_units(frames: pd.DataFrame, *, unit_s: float, halo_s: float) -> list[Unit]:
    """Cut each sequence of *frames* at multiples of *unit_s* since the epoch; never by what happened to be there."""
    units: list[Unit] = []
    all_s = frames["t_utc"].dt.tz_localize(None).to_numpy("datetime64[us]").astype("int64") / 1e6
    places_of = frames.groupby("sequence", sort=True, observed=True).indices
    for sequence in sorted(places_of, key=str):
        places = np.asarray(places_of[sequence], np.int64)
        seconds = all_s[places]
        bucket = np.floor(seconds / unit_s).astype("int64")
        numbers, firsts = np.unique(bucket, return_index=True)
        lasts = np.append(firsts[1:], len(bucket)) - 1
        lows = np.searchsorted(seconds, seconds[firsts] - halo_s, "left")
        highs = np.searchsorted(seconds, seconds[lasts] + halo_s, "right")
        site, date = Refs(frames, places[:SITE_CANDIDATES]), str(frames["date"].iloc[places[0]])
        for number, first, last, low, high in zip(numbers, firsts, lasts, lows, highs, strict=True):
            halo = np.concatenate([places[low:first], places[last + 1 : high]])
            inside = Refs(frames, places[first : last + 1])
            units.append(Unit(str(sequence), date, float(number) * unit_s, inside, Refs(frames, halo), site))
    return units


def refs_of(rows: pd.DataFrame) -> list[FrameRef]:
    """Return the rows of the index as frame references, in their order."""
    times = rows["t_utc"].dt.tz_localize(None).to_numpy("datetime64[us]")
    paths, sha256 = rows["path"].tolist(), rows["sha256"].tolist()
    beside = rows["beside"].tolist() if "beside" in rows else [""] * len(rows)
    return [FrameRef(*row) for row in zip(paths, times, sha256, beside, strict=True)]


def _named_site(frames: pd.DataFrame, path: str | None) -> FrameRef | None:
    """Return the frame to which the survey file says that the georeference belongs."""
    if path is None:
        return None
    found = refs_of(frames.loc[frames["path"] == path])
    if not found:
        raise ConfigError(
            f"georeference.reference_frame: no frame {path!r} in the archive; paths are below archive.root, "
            f"such as {frames['path'].iloc[0]!r}"
        )
    return found[0]


def date_of(piece: Piece) -> str:
    """Return the local date of *piece*."""
    return _unit_of(piece).date


def reason_due(piece: Piece, former: Mapping[str, str] | None) -> str:
    """Say why *piece* is due, from the ingredients recorded when a piece of its name was last done."""
    if former is None:
        return "new"
    changed = [name for name, value in piece.ingredients.items() if former.get(name) != value]
    return "changed: " + ", ".join(changed) if changed else "its result is missing"


def _unit_of(piece: Piece) -> Unit:
    while piece.unit is None:
        piece = piece.needs[0]
    return piece.unit


def _grouped(pieces: tuple[Piece, ...], attribute: str) -> list[tuple[str, list[Piece]]]:
    groups: dict[str, list[Piece]] = {}
    for piece in pieces:
        groups.setdefault(getattr(piece.unit, attribute), []).append(piece)
    return sorted(groups.items())


def _piece(
    step: Step,
    name: str,
    settings: Mapping[Step, Mapping[str, str]],
    inputs: Mapping[str, str],
    *,
    unit: Unit | None = None,
    needs: tuple[Piece, ...] = (),
) -> Piece:
    ingredients = {
        **inputs,
        **settings[step],
        **({"what it builds on": digest([need.key for need in needs])} if needs else {}),
    }
    return Piece(step, name, digest(step, name, ingredients), ingredients, unit, needs)


def _frames_hash(unit: Unit) -> str:
    groups = (unit.frames, unit.halo, unit.site)
    return digest([[(ref.path, ref.sha256, ref.beside, ref.t_utc.astype(int)) for ref in group] for group in groups])


def _settings(survey: Survey, step: Step, zones_text: str | None, learned: Mapping[str, str | None]) -> dict[str, str]:
    """Return name → hash of what *step* reads besides its inputs: only its own sections, defaults filled in."""
    reads: dict[Step, dict[str, Any]] = {
        "detect": {
            "archive.max_pixels": survey.archive.max_pixels,
            "archive.interlaced": survey.archive.interlaced,
            "georeference": survey.georeference.model_dump(mode="json"),
            "registration": survey.registration.model_dump(mode="json"),
            "background": survey.background.model_dump(mode="json"),
            "detection": survey.detection.model_dump(mode="json"),
            "completeness": survey.completeness.model_dump(mode="json"),
        },
        "track": {
            "matching": survey.matching.model_dump(mode="json", exclude={"model"}),
            "tracking": survey.tracking.model_dump(mode="json"),
            "revision": survey.revision.model_dump(mode="json"),
            "zones": zones_text,
            **learned,
        },
        "traffic": {
            "traffic": survey.traffic.model_dump(mode="json"),
            "zones": zones_text,
            "survey.time_zone": survey.survey.time_zone,
        },
        "picture": {"survey.name": survey.survey.name},
    }
    return {
        **{name: digest(value) for name, value in reads[step].items()},
        "algorithm": digest(ALGORITHM[step]),
    }
