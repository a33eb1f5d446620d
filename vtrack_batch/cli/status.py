"""``vtrack-batch status``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command("status", short_help="Say whether the results are up to date (exit 0) or work is due (exit 1).")
@options.survey_file
@options.out_folder
@options.as_json
@options.quiet
@options.verbose
def command(survey_yaml: Path, out: Path | None, as_json: bool, quiet: bool, verbose: bool) -> int:
    """\b
    Example:
      vtrack-batch status survey.yaml

    Say whether the results are up to date (exit 0) or work is due (exit 1).
    """
    from vtrack_batch.pipeline.run import prepare

    prepared = prepare(options.load(survey_yaml, out))
    manifest = prepared.context.output.current_manifest()
    up_to_date = prepared.up_to_date()
    by_step: dict[str, int] = {}
    for due in prepared.due:
        by_step[due.piece.step] = by_step.get(due.piece.step, 0) + 1
    answer = {
        "snapshot": manifest["snapshot"] if manifest else None,
        "frames": len(prepared.index.frames),
        "set_aside": len(prepared.index.quarantine),
        "due": by_step,
        "up_to_date": up_to_date,
    }
    if not quiet:
        work = ", ".join(f"{count} {step}" for step, count in by_step.items())
        work = work or ("nothing" if up_to_date else "publishing what is done")
        shown = f"snapshot {answer['snapshot']}" if manifest else "nothing published yet"
        lines = [f"{shown}; {answer['frames']} frames, {answer['set_aside']} files set aside", f"due: {work}"]
        if verbose:
            lines += [f"  {due.piece.step} {due.piece.name}: {due.reason}" for due in prepared.due]
        options.answer(answer, "\n".join(lines), as_json=as_json)
    return 0 if up_to_date else 1
