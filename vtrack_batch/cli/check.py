"""``vtrack-batch check``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command("check", short_help="Check a survey file, its archive, zones and a sample of frames; process nothing.")
@options.survey_file
@options.as_json
@options.quiet
@options.verbose
def command(survey_yaml: Path, as_json: bool, quiet: bool, verbose: bool) -> int:
    """\b
    Example:
      vtrack-batch check survey.yaml

    Check a survey file, its archive, zones and a sample of frames; process nothing.
    """
    from vtrack_batch.pipeline.check import check_survey

    found = check_survey(options.load(survey_yaml))
    if not quiet:
        options.answer(found.as_dict(), found.text(), as_json=as_json)
    return found.exit_code
