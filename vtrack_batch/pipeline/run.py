"""Bring a survey's results up to date: index, plan, carry out what is due, publish."""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from vtrack_batch.archive.walk import listing_of
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import ConfigError, NoArchive, StorageError, UnusableData
from vtrack_batch.pipeline.carry import lost_dates
from vtrack_batch.pipeline.culprits import Culprit, remember
from vtrack_batch.pipeline.execute import Crew, Tell, carry_out
from vtrack_batch.pipeline.journal import Journal
from vtrack_batch.pipeline.plan import ALGORITHM, STEPS, Plan, Step, date_of
from vtrack_batch.pipeline.prepare import Prepared, missing, prepare
from vtrack_batch.pipeline.record import Record, file_hash, read_record, write_record
from vtrack_batch.pipeline.workers import DeadlineReached, InProcess, Local, Work, Workers
from vtrack_batch.storage.output import Output, digest


@dataclass(frozen=True)
class Orders:
    """How a run is to go about it.

    ``workers``: processes (0 = in this one); ``cluster``: address of a Dask scheduler in their place; ``wait_s`` for
    another run to end; ``force`` a step and what follows; ``only`` one local date; ``until`` when to stop; ``prune``
    what the archive no longer holds; ``survey_file``: where the survey was read from, by which `status` knows it again.
    """

    workers: int | None = None
    cluster: str | None = None
    wait_s: float = 0.0
    force: Step | None = None
    only: str | None = None
    until: datetime | None = None
    prune: bool = False
    survey_file: Path | None = None


@dataclass(frozen=True)
class RunReport:
    """What a run did."""

    out: Path
    snapshot: Path | None
    """The published snapshot; the former one if nothing changed; None if there is none yet."""
    published: bool
    done: Mapping[str, int]
    frames_used: int
    frames_quarantined: int
    exit_code: int
    left: int = 0
    """Pieces of work that are still due."""
    withheld: str = ""
    """Why what was done is not published."""

    def summary(self) -> str:
        """Return the last lines of a run, for people."""
        work = ", ".join(f"{count} {step}" for step, count in self.done.items() if count)
        if not work:
            work = (
                "nothing to compute, but files set aside or settings changed" if self.published else "nothing was due"
            )
        lines = [f"{work}; {self.frames_used} frames used, {self.frames_quarantined} quarantined"]
        if self.left:
            lines.append(f"{self.left} pieces of work are left: run again to go on")
        if self.withheld:
            lines.append(f"not published: {self.withheld}")
        if self.snapshot is not None:
            lines.append(f"{'published' if self.published else 'unchanged'}: {self.snapshot}")
            lines.append(f"report: {self.out / 'current' / 'report' / 'report.html'}")
        return "\n".join(lines)


def run_survey(
    survey: Survey,
    *,
    workers: int | None = None,
    force: Step | None = None,
    wait_s: float = 0.0,
    orders: Orders | None = None,
    tell: Tell | None = None,
) -> RunReport:
    """Process what is due of *survey* and publish it; a run without changes computes nothing.

    *workers*: processes at work, 0 or None with ``execution.workers: 1`` = this one alone; *force* computes a step, and
    what follows from it, again; *orders* for all else. *tell* is called with the name of each event and its facts.
    Raises a ``VtrackError`` whose ``exit_code`` says how bad it is; what was published before stays intact.
    """
    orders = orders or Orders(workers, force=force, wait_s=wait_s)
    output = Output(survey.resolve(survey.output.root))
    archive = survey.resolve(survey.archive.root)
    if not archive.is_dir():
        raise NoArchive(f"{archive}: no such folder; check archive.root in the survey file")
    output.create()
    with output.locked(orders.wait_s), Journal(output.state / "runs") as journal:
        listeners: list[Tell] = [journal] if tell is None else [journal, tell]

        def tell_all(event: str, **facts: Any) -> None:
            for listener in listeners:
                listener(event, **facts)

        tell_all("started", survey=survey.survey.name, out=str(output.root))
        began_s = time.monotonic()
        try:
            report = _run(survey, output, orders, tell_all)
        except OSError as problem:
            where = problem.filename or output.root
            raise StorageError(
                f"{where}: {problem.strerror or problem}; what was published before is intact"
            ) from problem
        facts = {"done": dict(report.done), "left": report.left, "exit_code": report.exit_code}
        frames = {"frames_used": report.frames_used, "frames_quarantined": report.frames_quarantined}
        tell_all("ended", seconds=round(time.monotonic() - began_s, 3), published=report.published, **facts, **frames)
        return report


def _run(survey: Survey, output: Output, orders: Orders, tell: Tell) -> RunReport:
    shutil.rmtree(output.state / "hands", ignore_errors=True)
    if orders.force is None and orders.only is None and not orders.prune and unchanged(survey, output):
        _recognise(output, orders.survey_file)
        return _report(output, survey, dict.fromkeys(STEPS, 0), published=False)
    done: dict[str, int] = dict.fromkeys(STEPS, 0)
    with closing(_workers(survey, orders)) as workers:
        prepared, late = _work_off(survey, orders, Crew(workers, tell, _until_s(orders.until)), done)
    return _publish(prepared, done, orders, late=late)


def _work_off(survey: Survey, orders: Orders, crew: Crew, done: dict[str, int]) -> tuple[Prepared, bool]:
    """Do what is due, planned anew whenever frames must be left out; returns the plan, and whether time ran out."""
    force = orders.force
    while True:
        prepared = _narrowed(prepare(survey, force=force), orders.only)
        output = prepared.context.output
        for due in prepared.due:
            output.drop_part(due.piece.step, due.piece.key)
        force = None
        try:
            culprits = _carry_out(prepared, crew, done)
        except DeadlineReached:
            return prepared, True
        if not culprits:
            return prepared, False
        remember(output, culprits, prepared.index.frames)


def settings_of(survey: Survey) -> str:
    """Return the fingerprint of all that a result depends on besides the archive."""
    named = {name: file_hash(survey.resolve(name)) for name in named_files(survey)}
    dump = survey.model_dump(mode="json", exclude={"output": True, "execution": _NO_RESULT})
    return digest(dump, sorted(survey.georeference.model_fields_set), named, dict(ALGORITHM))


_NO_RESULT = {"workers": True, "cluster": True, "memory_mb": True, "frame_limit_s": True}


def named_files(survey: Survey) -> list[str]:
    """Return the files that a survey names, as it names them."""
    named = (survey.zones, survey.flow_map, survey.matching.model, survey.archive.index)
    return [name for name in named if name is not None]


def unchanged(survey: Survey, output: Output) -> bool:
    """Return whether the last complete run saw just this, and its results stand: nothing need be looked into."""
    record = read_record(output)
    if record is None or record.settings != settings_of(survey) or not record.results_stand(output):
        return False
    root = survey.resolve(survey.archive.root)
    if record.listing is None or record.archive != str(root) or output.is_distrusted():
        return False
    return record.listing == listing_of(root, settle_s=survey.archive.settle_s)


def _recognise(output: Output, survey_file: Path | None) -> None:
    """Have `status` know the survey file again, should its remarks have changed or another have said the same."""
    record = read_record(output)
    found = file_hash(survey_file) if survey_file else None
    if record is not None and found is not None and record.survey_file != found:
        with suppress(OSError):
            write_record(output, replace(record, survey_file=found))


def _workers(survey: Survey, orders: Orders) -> Workers:
    cluster = orders.cluster or survey.execution.cluster
    if cluster:
        from vtrack_batch.pipeline.cluster import Cluster

        return Cluster(cluster)
    count = orders.workers
    if count is None:
        count = survey.execution.workers if survey.execution.workers > 1 else 0
    return Local(count, survey.execution.memory_mb) if count else InProcess()


def _until_s(until: datetime | None) -> float | None:
    """Return *until* on the monotonic clock, which nobody sets."""
    return None if until is None else time.monotonic() + (until - datetime.now(until.tzinfo)).total_seconds()


def _narrowed(prepared: Prepared, only: str | None) -> Prepared:
    """Keep of what is due what belongs to the local date *only*."""
    if only is None:
        return prepared
    dates = prepared.plan.dates
    if only not in dates:
        shown = f"{dates[0]} to {dates[-1]}" if len(dates) > 3 else ", ".join(dates)
        raise ConfigError(f"--only {only}: no frame of that date; there are frames of {shown}")
    return replace(prepared, due=tuple(due for due in prepared.due if date_of(due.piece) == only))


def _carry_out(prepared: Prepared, crew: Crew, done: dict[str, int]) -> list[Culprit]:
    """Do what is due, step by step; stops after a step in which frames were found that must be left out."""
    for step in STEPS:
        pieces = [due.piece for due in prepared.due if due.piece.step == step]

        def count(event: str, step: str = step, **facts: Any) -> None:
            if event == "done":
                done[step] += 1
            crew.tell(event, step=step, **facts)

        if pieces:
            crew.tell("step", step=step, total=len(pieces))
            culprits = carry_out(pieces, _work(step), prepared.context, replace(crew, tell=count))
            if culprits:
                return culprits
        if step == "detect":
            _refuse_if_nothing_usable(prepared)
    return []


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
    """Raise ``UnusableData`` if of all units not one frame could be used."""
    reasons: dict[str, int] = {}
    for piece in prepared.plan.detect:
        part = prepared.context.output.part(piece.step, piece.key)
        if part is None or part.about["frames_used"]:
            return
        for reason, count in part.about["quarantined"].items():
            reasons[reason] = reasons.get(reason, 0) + count
    shown = ", ".join(f"{count} {reason}" for reason, count in sorted(reasons.items()))
    raise UnusableData(f"{prepared.index.root}: none of {len(prepared.index.frames)} frames can be used ({shown})")


def _publish(prepared: Prepared, done: Mapping[str, int], orders: Orders, *, late: bool) -> RunReport:
    """Publish the dates that are complete, unless a date would vanish that was published before."""
    from vtrack_batch.pipeline.publish import publish

    output, survey = prepared.context.output, prepared.context.survey
    left = missing(prepared.plan, output)
    whole = prepared.plan if orders.prune else prepared.whole()
    ready = whole.without(left)
    lost = [] if orders.prune else lost_dates(ready, output)
    made = publish(ready, prepared.index, prepared.context) if ready.dates and not lost else None
    withheld = _why_withheld(prepared, ready, lost)
    if not left and not withheld:
        _record(prepared, orders)
    report = _report(output, survey, done, published=made is not None)
    return replace(report, left=len(left), withheld=withheld, exit_code=75 if late and left else report.exit_code)


def _why_withheld(prepared: Prepared, ready: Plan, lost: list[str]) -> str:
    """Return why what was done is not published, "" if it is."""
    if not ready.dates:
        return "no date is complete yet"
    if not lost:
        return ""
    due = [date for date in lost if date in prepared.plan.dates]
    if due:
        return f"work is left for {len(due)} of the published dates, {due[0]} first; they stay as they were"
    return (
        f"the archive has no frame any more of {len(lost)} published dates, {lost[0]} first, and they were made with "
        "other parameters; `run --prune` publishes without them"
    )


def _record(prepared: Prepared, orders: Orders) -> None:
    """Note what this complete run saw, so that the next one knows in a moment whether anything is new."""
    output, survey = prepared.context.output, prepared.context.survey
    parts: dict[str, list[str]] = {step: [] for step in STEPS}
    for piece in prepared.plan.pieces():
        parts[piece.step].append(piece.key)
    named = {str(path): file_hash(path) for path in map(survey.resolve, named_files(survey))}
    record = Record(
        settings=settings_of(survey),
        listing=prepared.index.listing,
        snapshot=output.current.resolve().name,
        frames=len(prepared.index.frames),
        set_aside=len(prepared.index.quarantine),
        parts=parts,
        archive=str(prepared.index.root),
        settle_s=survey.archive.settle_s,
        named_files=named,
        survey_file=file_hash(orders.survey_file) if orders.survey_file else None,
    )
    try:
        write_record(output, record)
    except OSError as problem:
        raise StorageError(f"{output.state}: cannot be written ({problem}); what was published is intact") from None


def _report(output: Output, survey: Survey, done: Mapping[str, int], *, published: bool) -> RunReport:
    manifest = output.current_manifest()
    if manifest is None:
        return RunReport(output.root, None, False, done, 0, 0, 0)
    used, lost = manifest["frames"]["used"], manifest["frames"]["quarantined"]
    too_many = lost > survey.output.quarantine_tolerance * (used + lost)
    return RunReport(output.root, output.current.resolve(), published, done, used, lost, 3 if too_many else 0)
