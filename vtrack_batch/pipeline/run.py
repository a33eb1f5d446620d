"""Bring a survey's results up to date: index, plan, carry out what is due, publish."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import ConfigError, NoArchive, StorageError, UnusableData, UnusableFrame
from vtrack_batch.pipeline.execute import Work, carry_out
from vtrack_batch.pipeline.index import Index, make_index
from vtrack_batch.pipeline.parts import Context
from vtrack_batch.pipeline.plan import SITE_CANDIDATES, STEPS, Piece, Plan, Step, make_plan, reason_due
from vtrack_batch.storage.hashes import HashStore
from vtrack_batch.storage.output import Output

Say = Callable[[str], None]


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

        return not self.due and contents(self.plan, self.index, self.context).published_in(self.context.output)


@dataclass(frozen=True)
class RunReport:
    """What a run did."""

    out: Path
    snapshot: Path | None
    """The published snapshot; the former one if nothing changed."""
    published: bool
    done: Mapping[str, int]
    frames_used: int
    frames_quarantined: int
    exit_code: int

    def summary(self) -> str:
        """Return the last lines of a run, for people."""
        work = ", ".join(f"{count} {step}" for step, count in self.done.items() if count) or "nothing was due"
        kept = "published" if self.published else "unchanged"
        return (
            f"{work}; {self.frames_used} frames used, {self.frames_quarantined} quarantined\n"
            f"{kept}: {self.snapshot}\n"
            f"report: {self.out / 'current' / 'report' / 'report.html'}"
        )


def run_survey(
    survey: Survey,
    *,
    workers: int | None = None,
    wait_s: float = 0.0,
    force: Step | None = None,
    say: Say | None = None,
) -> RunReport:
    """Process what is due of *survey* and publish it; a run without changes computes nothing.

    *force* computes a step, and what follows from it, again. Raises a ``VtrackError`` whose ``exit_code`` says how bad
    it is; what was published before stays intact.
    """
    output = Output(survey.resolve(survey.output.root))
    archive = survey.resolve(survey.archive.root)
    if not archive.is_dir():
        raise NoArchive(f"{archive}: no such folder; check archive.root in the survey file")
    output.create()
    with output.locked(wait_s):
        prepared = prepare(survey, force=force)
        for due in prepared.due:
            output.drop_part(due.piece.step, due.piece.key)
        done = _carry_out(prepared, workers or survey.execution.workers, say or _silent)
        return _publish(prepared, done)


def prepare(survey: Survey, *, force: Step | None = None) -> Prepared:
    """Index the archive and plan the work, without doing any of it; *force* makes a step and what follows it due."""
    output = Output(survey.resolve(survey.output.root))
    index = make_index(survey, HashStore(output.state / "files.sqlite" if output.state.is_dir() else None))
    zones_text = read_zones_text(survey)
    if index.frames.empty:
        reasons = ", ".join(f"{n} {reason}" for reason, n in index.quarantine["reason"].value_counts().items())
        raise UnusableData(f"{index.root}: none of {len(index.quarantine)} files can be used ({reasons})")
    _check_ground(survey, index, zones_text)
    plan = make_plan(index.frames, survey, zones_text=zones_text)
    context = Context(survey, index.root, output.root, zones_text)
    ledger = _ledger(output)
    forced = STEPS[STEPS.index(force) :] if force else ()
    due = tuple(
        Due(piece, "forced" if made else reason_due(piece, ledger.get(f"{piece.step} {piece.name}")))
        for piece in plan.pieces()
        if not (made := output.part(piece.step, piece.key) is not None) or piece.step in forced
    )
    return Prepared(context, index, plan, due)


def _carry_out(prepared: Prepared, workers: int, say: Say) -> dict[str, int]:
    """Do what is due, step by step."""
    output = prepared.context.output
    done: dict[str, int] = dict.fromkeys(STEPS, 0)
    ledger = _ledger(output)
    for step in STEPS:
        pieces = [due.piece for due in prepared.due if due.piece.step == step]

        def progress(piece: Piece, step: Step = step, total: int = len(pieces)) -> None:
            done[step] += 1
            ledger[f"{piece.step} {piece.name}"] = dict(piece.ingredients)
            say(f"{step} {done[step]}/{total}: {piece.name}")

        if pieces:
            carry_out(pieces, _work(step), prepared.context, workers=workers, progress=progress)
            _write_ledger(output, ledger)
        if step == "detect":
            _refuse_if_nothing_usable(prepared)
    return done


def _work(step: Step) -> Work:
    """Return the function of a step; imported late, so that a run with nothing to do starts fast."""
    if step == "detect":
        from vtrack_batch.pipeline.detect import detect_unit

        return detect_unit
    if step == "track":
        from vtrack_batch.pipeline.track import track_sequence

        return track_sequence
    if step == "traffic":
        from vtrack_batch.pipeline.traffic import measure_date

        return measure_date
    from vtrack_batch.pipeline.picture import draw_sequence

    return draw_sequence


def _refuse_if_nothing_usable(prepared: Prepared) -> None:
    parts = [prepared.context.part(piece) for piece in prepared.plan.detect]
    if any(part.about["frames_used"] for part in parts):
        return
    reasons: dict[str, int] = {}
    for part in parts:
        for reason, count in part.about["quarantined"].items():
            reasons[reason] = reasons.get(reason, 0) + count
    shown = ", ".join(f"{count} {reason}" for reason, count in sorted(reasons.items()))
    raise UnusableData(f"{prepared.index.root}: none of {len(prepared.index.frames)} frames can be used ({shown})")


def _publish(prepared: Prepared, done: Mapping[str, int]) -> RunReport:
    from vtrack_batch.pipeline.publish import publish

    made = publish(prepared.plan, prepared.index, prepared.context)
    output, survey = prepared.context.output, prepared.context.survey
    manifest = made[1] if made else output.current_manifest()
    if manifest is None:
        raise StorageError(f"{output.root}: the published snapshot vanished during the run; run again")
    used, lost = manifest["frames"]["used"], manifest["frames"]["quarantined"]
    too_many = lost > survey.output.quarantine_tolerance * (used + lost)
    return RunReport(output.root, output.current.resolve(), made is not None, done, used, lost, 3 if too_many else 0)


def read_zones_text(survey: Survey) -> str | None:
    """Return the content of the zone file, or None where none is named; raises ``ConfigError`` if it cannot be read."""
    if survey.zones is None:
        return None
    path = survey.resolve(survey.zones)
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as problem:
        raise ConfigError(f"{path}: the zone file cannot be read ({problem}); see `zones` in the survey file") from None


def _check_ground(survey: Survey, index: Index, zones_text: str | None) -> None:
    """Raise ``ConfigError`` before work begins if the first frame's ground or the zones on it cannot be had."""
    from vtrack_batch.archive.headers import read_header
    from vtrack_batch.archive.read import read_bytes
    from vtrack_batch.pipeline.ground import fix_ground
    from vtrack_batch.pipeline.plan import refs_of

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


def _ledger(output: Output) -> dict[str, dict[str, str]]:
    """Return what each piece of work was made of when it was last done; only used to explain why one is due."""
    try:
        return dict(json.loads((output.state / "ledger.json").read_bytes()))
    except (OSError, ValueError):
        return {}


def _write_ledger(output: Output, ledger: Mapping[str, Any]) -> None:
    draft = output.state / "staging" / "ledger.json"
    draft.write_text(json.dumps(ledger, sort_keys=True) + "\n")
    draft.replace(output.state / "ledger.json")


def _silent(message: str) -> None:
    """Say nothing."""
