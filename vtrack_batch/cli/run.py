"""``vtrack-batch run``."""

from __future__ import annotations

import re
import signal
import time
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import click

from vtrack_batch.cli import options
from vtrack_batch.cli.progress import Progress

NOT_PUBLISHED = "the newest snapshot holds something else"


@click.command("run", short_help="Process what is due of a survey and publish its tables.")
@options.survey_file
@click.option("--workers", type=click.IntRange(1), help="Processes at work, in place of execution.workers.")
@click.option("--cluster", metavar="ADDRESS", help="Dask scheduler whose workers do the work, as tcp://host:8786.")
@options.out_folder
@click.option("--dry-run", is_flag=True, help="Say what is due and why; do nothing.")
@click.option(
    "--force",
    type=click.Choice(["detect", "track", "traffic", "picture"]),
    is_flag=False,
    flag_value="detect",
    help="Do this step and what follows again; all of them if none is named (then write it last).",
)
@click.option("--only", metavar="DATE", help="Do what is due of this local date alone, as 2026-05-17.")
@click.option("--deadline", metavar="HH:MM", help="Stop at this time by the machine's clock; the next run goes on.")
@click.option("--prune", is_flag=True, help="Drop published dates of which the archive holds no frame any more.")
@options.wait
@click.option("--metrics-file", type=click.Path(path_type=Path), help="Write a text file for Prometheus.")
@options.as_json
@options.quiet
@options.verbose
def command(survey_yaml: Path, out: Path | None, dry_run: bool, **chosen: Any) -> int:
    """\b
    Examples:
      vtrack-batch run survey.yaml --workers 2
      vtrack-batch run survey.yaml -q --deadline 05:30

    Process what is due of a survey and publish its tables.

    A second run does only what new frames or changed parameters make due. Exit codes: 0 done, 3 done with losses,
    65 nothing usable, 66 archive missing or empty, 73 or 74 output trouble, 75 another run is at work or the deadline
    came with work left, 78 survey file wrong, 130 or 143 stopped.
    """
    until = _next(chosen["deadline"]) if chosen["deadline"] else None
    survey = options.load(survey_yaml, out)
    if dry_run:
        return _dry_run(survey, chosen)
    hang_up = getattr(signal, "SIGHUP", None)
    if hang_up is not None:
        signal.signal(hang_up, signal.SIG_IGN)  # a closed terminal does not end a night's work
    return _run(survey, survey_yaml, until, chosen)


def _run(survey: Any, survey_yaml: Path, until: datetime | None, chosen: dict[str, Any]) -> int:
    from vtrack_batch.pipeline.journal import exit_code_of
    from vtrack_batch.pipeline.run import Orders, run_survey

    workers = chosen["workers"] or survey.execution.workers
    named = {name: chosen[name] for name in ("cluster", "wait_s", "force", "only", "prune")}
    orders = Orders(workers, until=until, survey_file=survey_yaml, **named)
    progress = Progress(quiet=chosen["quiet"], verbose=chosen["verbose"])
    began_s, report, code = time.monotonic(), None, 1
    try:
        report = run_survey(survey, orders=orders, tell=progress)
        code = report.exit_code
    except BaseException as problem:
        code = exit_code_of(problem)
        raise
    finally:
        progress.close()
        if chosen["metrics_file"] is not None:
            from vtrack_batch.pipeline.metrics import write_metrics

            seconds = time.monotonic() - began_s
            write_metrics(chosen["metrics_file"], survey.survey.name, exit_code=code, seconds=seconds, report=report)
    _show(report, chosen)
    return code


def _show(report: Any, chosen: dict[str, Any]) -> None:
    if not chosen["as_json"]:
        quiet = chosen["quiet"] and report.exit_code == 0
        options.speaker(quiet)(report.summary())
        return
    answer = {
        "snapshot": str(report.snapshot) if report.snapshot else None,
        "published": report.published,
        "withheld": report.withheld or None,
        "done": dict(report.done),
        "left": report.left,
        "frames_used": report.frames_used,
        "frames_quarantined": report.frames_quarantined,
    }
    options.answer(answer, "", as_json=True)


def _dry_run(survey: Any, chosen: dict[str, Any]) -> int:
    from vtrack_batch.pipeline.plan import date_of
    from vtrack_batch.pipeline.prepare import prepare

    prepared = prepare(survey, force=chosen["force"])
    due = [one for one in prepared.due if chosen["only"] in (None, date_of(one.piece))]
    rows = [{"step": one.piece.step, "piece": one.piece.name, "reason": one.reason} for one in due]
    if not rows and not prepared.up_to_date():
        rows = [{"step": "publish", "piece": survey.survey.name, "reason": NOT_PUBLISHED}]
    text = "\n".join(f"{row['step']:8} {row['piece']}: {row['reason']}" for row in rows) or "nothing is due"
    options.answer(rows, text, as_json=chosen["as_json"])
    return 0


def _next(clock: str) -> datetime:
    """Return the next moment at which the machine's clock shows *clock*."""
    found = re.fullmatch(r"([01]?\d|2[0-3]):([0-5]\d)", clock)
    if found is None:
        raise click.BadParameter(f"{clock!r} is no time of day such as 05:30", param_hint="--deadline")
    now = datetime.now().astimezone()
    moment = now.replace(hour=int(found[1]), minute=int(found[2]), second=0, microsecond=0)
    return moment if moment > now else moment + timedelta(days=1)
