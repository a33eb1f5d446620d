"""Published dates whose frames are no longer in the archive: they stay published, made as they were.

Frames are moved away to make room, and a disk may not be mounted: neither unmakes a result. What was made with other
parameters than the rest is not mixed into it; then nothing is published until it is asked for (`run --prune`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vtrack_batch.config.survey import Survey
from vtrack_batch.pipeline.plan import STEPS, Piece, Plan, Step, Unit
from vtrack_batch.storage.output import Output

_FREE = ("output", "execution")


def carried(plan: Plan, output: Output) -> Plan:
    """Return *plan* and the pieces of published dates of which it knows nothing, their parts being there."""
    parts = published_parts(output)
    planned = set(plan.dates)
    gone = {date: key for date, key in parts["traffic"].items() if date not in planned}
    dates = tuple(piece for date, key in sorted(gone.items()) for piece in _date(date, key, parts, output))
    if not dates:
        return plan
    tracks = {piece.key: piece for date in dates for piece in date.needs}
    pictures = tuple(
        Piece("picture", name, key, {}, needs=(track, _of(track, dates)))
        for name, key in sorted(parts["picture"].items())
        for track in tracks.values()
        if track.name == name
    )
    detect = tuple(piece for track in tracks.values() for piece in track.needs)
    return Plan(
        (*plan.detect, *detect),
        _sorted((*plan.track, *tracks.values())),
        _sorted((*plan.traffic, *dates)),
        _sorted((*plan.picture, *pictures)),
    )


def lost_dates(plan: Plan, output: Output) -> list[str]:
    """Return the published dates that *plan* does not hold."""
    return sorted(set(published_parts(output)["traffic"]) - set(plan.dates))


def same_making(survey: Survey, output: Output) -> bool:
    """Return whether the published snapshot was made with the parameters that *survey* has now."""
    manifest: Mapping[str, Any] = output.current_manifest() or {}
    now = survey.model_dump(mode="json")
    before = manifest.get("parameters", {})
    return all(before.get(name) == value for name, value in now.items() if name not in _FREE)


def published_parts(output: Output) -> Mapping[str, Mapping[str, str]]:
    """Return step → name of the piece → key of its part, of the newest snapshot."""
    manifest: Mapping[str, Any] = output.current_manifest() or {}
    return {step: dict(manifest.get("parts", {}).get(step, {})) for step in STEPS}


def _date(date: str, key: str, parts: Mapping[str, Mapping[str, str]], output: Output) -> list[Piece]:
    """Return the piece of a date as it was done, with what it builds on; none if a part of it is missing."""
    names = {step: {key: name for name, key in parts[step].items()} for step in STEPS}
    whole = output.part("traffic", key)
    tracks = []
    for track_key in whole.about["needs"] if whole else ():
        part = output.part("track", track_key)
        if part is None:
            return []
        needs = tuple(_stub("detect", names["detect"].get(each, each), each, date) for each in part.about["needs"])
        tracks.append(Piece("track", names["track"].get(track_key, part.about["name"]), track_key, {}, needs=needs))
    return [Piece("traffic", date, key, {}, needs=tuple(tracks))] if tracks else []


def _stub(step: Step, name: str, key: str, date: str) -> Piece:
    return Piece(step, name, key, {}, Unit(name.split(" ")[0], date, 0.0, (), (), ()))


def _of(track: Piece, dates: tuple[Piece, ...]) -> Piece:
    return next(date for date in dates if track in date.needs)


def _sorted(pieces: tuple[Piece, ...]) -> tuple[Piece, ...]:
    return tuple(sorted(pieces, key=lambda piece: piece.name))
