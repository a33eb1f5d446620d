"""``vtrack-batch explain``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command("explain", short_help="Say why work is due: which frames came or changed, which parameters differ.")
@options.survey_file
@click.argument("what", required=False)
@options.out_folder
@options.as_json
@options.quiet
@options.verbose
def command(survey_yaml: Path, what: str | None, out: Path | None, as_json: bool, quiet: bool, verbose: bool) -> None:
    """\b
    Examples:
      vtrack-batch explain survey.yaml
      vtrack-batch explain survey.yaml 2026-05-17
      vtrack-batch explain survey.yaml north/0007.jpg

    Say why work is due: which frames came or changed, which parameters differ; or what holds for one piece of work,
    sequence, date or frame.
    """
    from vtrack_batch.pipeline.explain import explain

    found = explain(options.load(survey_yaml, out), what)
    lines = []
    for one in found:
        lines.append(f"{one.step:8} {one.piece}: {one.reason}")
        lines += [f"         {text}" for text in one.particulars]
    if not quiet:
        options.answer([asdict(one) for one in found], "\n".join(lines) or "nothing is due", as_json=as_json)
