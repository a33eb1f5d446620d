"""What is due and why: the archive indexed and planned, and compared with the parts that are there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import ConfigError, StorageError, UnusableData, UnusableFrame
from vtrack_batch.pipeline.carry import carried, published_parts, same_making
from vtrack_batch.pipeline.culprits import read_culprits
from vtrack_batch.pipeline.index import Index, make_index
from vtrack_batch.pipeline.parts import Context
from vtrack_batch.pipeline.plan import SITE_CANDIDATES, STEPS, Piece, Plan, Step, make_plan, reason_due, refs_of
from vtrack_batch.pipeline.record import file_hash
from vtrack_batch.storage.hashes import FileStore
from vtrack_batch.storage.output import Output


@dataclass(frozen=True)
class Due:
    """A piece of work that is due, and why."""

    piece: Piece
    reason: str


@dataclass(frozen=True)
class Prepared:
    """A survey whose archive has been indexed and planned."""

    context: Context
    index: Index
    plan: Plan
    due: tuple[Due, ...]

    def up_to_date(self) -> bool:
        """Return whether a run would change nothing: no piece is due, and the newest snapshot holds what is done."""
        from vtrack_batch.pipeline.publish import contents

        return not self.due and contents(self.whole(), self.index, self.context).published_in(self.context.output)

    def whole(self) -> Plan:
        """Return the plan with the published dates whose frames are gone, if they were made with these parameters."""
        output, survey = self.context.output, self.context.survey
        return carried(self.plan, output) if same_making(survey, output) else self.plan


def prepare(survey: Survey, *, force: Step | None = None) -> Prepared:
    """Index the archive and plan the work, without doing any of it; *force* makes a step and what follows it due."""
    output = Output(survey.resolve(survey.output.root))
    store = FileStore(output.state / "files.sqlite" if output.state.is_dir() else None)
    try:
        index = make_index(survey, store, read_culprits(output))
    finally:
        store.close()
    zones_text = read_zones_text(survey)
    if index.frames.empty:
        reasons = ", ".join(f"{n} {reason}" for reason, n in index.quarantine["reason"].value_counts().items())
        raise UnusableData(f"{index.root}: none of {len(index.quarantine)} files can be used ({reasons})")
    _check_ground(survey, index, zones_text)
    plan = make_plan(index.frames, survey, zones_text=zones_text, learned=_learned(survey))
    context = Context(survey, index.root, output.root, zones_text)
    return Prepared(context, index, plan, _due(plan, output, force))


def missing(plan: Plan, output: Output) -> list[Piece]:
    """Return the pieces of *plan* that have no finished part."""
    made = {step: output.keys(step) for step in STEPS}
    return [piece for piece in plan.pieces() if piece.key not in made[piece.step]]


def read_zones_text(survey: Survey) -> str | None:
    """Return the content of the zone file, or None where none is named; raises ``ConfigError`` if it cannot be read."""
    if survey.zones is None:
        return None
    path = survey.resolve(survey.zones)
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as problem:
        why = problem.strerror if isinstance(problem, OSError) else "it is not UTF-8 text"
        raise ConfigError(f"{path}: the zone file cannot be read ({why}); see `zones` in the survey file") from None


def _learned(survey: Survey) -> dict[str, str | None]:
    """Return the hash of every file of something learned elsewhere, None where none is named, by its key in the survey.

    Raises ``ConfigError`` if a file is not there.
    """
    found: dict[str, str | None] = {}
    for key, name in {"flow_map": survey.flow_map, "matching.model": survey.matching.model}.items():
        found[key] = None if name is None else file_hash(survey.resolve(name))
        if name is not None and found[key] is None:
            raise ConfigError(f"{survey.resolve(name)}: no such file; see `{key}` in the survey file")
    return found


def _due(plan: Plan, output: Output, force: Step | None) -> tuple[Due, ...]:
    forced = STEPS[STEPS.index(force) :] if force else ()
    absent = {piece.key for piece in missing(plan, output)}
    chosen = [piece for piece in plan.pieces() if piece.key in absent or piece.step in forced]
    former = published_parts(output) if chosen else {}
    return tuple(
        Due(piece, reason_due(piece, _made_of(output, piece, former)) if piece.key in absent else "forced")
        for piece in chosen
    )


def _made_of(output: Output, piece: Piece, former: Mapping[str, Mapping[str, str]]) -> Mapping[str, str] | None:
    """Return what the published part of the same name was made of; None where there is none."""
    key = former[piece.step].get(piece.name)
    try:
        part = output.part(piece.step, key) if key else None
    except StorageError:
        part = None
    if part is not None:
        return dict(part.about.get("made_of", {}))
    return piece.ingredients if key == piece.key else None


def _check_ground(survey: Survey, index: Index, zones_text: str | None) -> None:
    """Raise ``ConfigError`` before work begins if the first frame's ground or the zones on it cannot be had."""
    from vtrack_batch.archive.headers import read_header
    from vtrack_batch.archive.read import read_bytes
    from vtrack_batch.pipeline.ground import fix_ground

    for ref in refs_of(index.frames.iloc[:SITE_CANDIDATES]):
        try:
            data = read_bytes(index.root, ref.path)
            header = read_header(data)
        except UnusableFrame:
            continue
        fix = fix_ground(survey, index.root, ref, data, header.width_px, header.height_px)
        if zones_text is not None:
            from vtrack_batch.traffic.zones import parse_zones

            parse_zones(zones_text, crs=fix.crs, source=str(survey.zones))
        return
