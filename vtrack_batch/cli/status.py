"""``vtrack-batch status``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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

    Say whether the results are up to date (exit 0) or work is due (exit 1), and who is at work on them.
    """
    from vtrack_batch.pipeline.glance import glance

    record = glance(survey_yaml, out)
    answer, lines = _looked_into(survey_yaml, out, verbose) if record is None else (_remembered(record), [])
    if not quiet:
        text = "\n".join([*_sentences(answer), *lines])
        options.answer(answer, text, as_json=as_json)
    return 0 if answer["up_to_date"] else 1


def _remembered(record: Any) -> dict[str, Any]:
    known = {"snapshot": int(record.snapshot), "frames": record.frames, "set_aside": record.set_aside}
    return {**known, "due": {}, "up_to_date": True, "at_work": None}


def _looked_into(survey_yaml: Path, out: Path | None, verbose: bool) -> tuple[dict[str, Any], list[str]]:
    """Return what is due, found by indexing the archive and planning."""
    from vtrack_batch.pipeline.prepare import prepare
    from vtrack_batch.storage.lock import at_work

    prepared = prepare(options.load(survey_yaml, out))
    output = prepared.context.output
    manifest, holder = output.current_manifest(), at_work(output.state)
    by_step: dict[str, int] = {}
    for due in prepared.due:
        by_step[due.piece.step] = by_step.get(due.piece.step, 0) + 1
    answer = {
        "snapshot": manifest["snapshot"] if manifest else None,
        "frames": len(prepared.index.frames),
        "set_aside": len(prepared.index.quarantine),
        "due": by_step,
        "up_to_date": prepared.up_to_date(),
        "at_work": str(holder) if holder else None,
    }
    return answer, [f"  {due.piece.step} {due.piece.name}: {due.reason}" for due in prepared.due] if verbose else []


def _sentences(answer: dict[str, Any]) -> list[str]:
    work = ", ".join(f"{count} {step}" for step, count in answer["due"].items())
    work = work or ("nothing" if answer["up_to_date"] else "publishing what is done")
    shown = f"snapshot {answer['snapshot']}" if answer["snapshot"] else "nothing published yet"
    lines = [f"{shown}; {answer['frames']} frames, {answer['set_aside']} files set aside", f"due: {work}"]
    return [*lines, f"at work: {answer['at_work']}"] if answer["at_work"] else lines
