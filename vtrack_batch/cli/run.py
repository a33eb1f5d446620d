"""``vtrack-batch run``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options

NOT_PUBLISHED = "the newest snapshot holds something else"


@click.command("run", short_help="Process what is due of a survey and publish its tables.")
@options.survey_file
@click.option("--workers", type=click.IntRange(1), help="Processes at work, in place of execution.workers.")
@options.out_folder
@click.option("--dry-run", is_flag=True, help="Say what is due and why; do nothing.")
@click.option(
    "--force",
    type=click.Choice(["detect", "track", "traffic", "picture"]),
    is_flag=False,
    flag_value="detect",
    help="Do this step and what follows again; all of them if none is named (then write it last).",
)
@click.option("--wait", "wait_s", type=click.FloatRange(0), default=0.0, help="Seconds to wait for another run to end.")
@options.as_json
@options.quiet
@options.verbose
def command(
    survey_yaml: Path,
    workers: int | None,
    out: Path | None,
    dry_run: bool,
    force: str | None,
    wait_s: float,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> int:
    """\b
    Example:
      vtrack-batch run survey.yaml --workers 2

    Process what is due of a survey and publish its tables.

    A second run does only what new frames or changed parameters make due. Exit codes: 0 done, 3 done with losses,
    65 nothing usable, 66 archive missing or empty, 73 or 74 output trouble, 75 another run is at work, 78 survey file
    wrong.
    """
    from vtrack_batch.pipeline.run import prepare, run_survey

    survey = options.load(survey_yaml, out)
    if dry_run:
        prepared = prepare(survey, force=force)  # type: ignore[arg-type]
        rows = [{"step": due.piece.step, "piece": due.piece.name, "reason": due.reason} for due in prepared.due]
        if not rows and not prepared.up_to_date():
            rows = [{"step": "publish", "piece": survey.survey.name, "reason": NOT_PUBLISHED}]
        text = "\n".join(f"{r['step']:8} {r['piece']}: {r['reason']}" for r in rows) or "nothing is due"
        options.answer(rows, text, as_json=as_json)
        return 0
    say = options.speaker(quiet or not verbose)
    report = run_survey(survey, workers=workers, wait_s=wait_s, force=force, say=say)  # type: ignore[arg-type]
    if as_json:
        options.answer(
            {
                "snapshot": str(report.snapshot),
                "published": report.published,
                "done": dict(report.done),
                "frames_used": report.frames_used,
                "frames_quarantined": report.frames_quarantined,
            },
            "",
            as_json=True,
        )
    else:
        options.speaker(quiet)(report.summary())
    return report.exit_code
