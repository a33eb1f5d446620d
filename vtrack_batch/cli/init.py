"""``vtrack-batch init``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command(
    "init", short_help="Write a commented survey.yaml, its JSON schema for editors and a template for zones."
)
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False), default=Path())
@click.option("--from", "archive", type=click.Path(path_type=Path), help="Archive of frames to look at for proposals.")
@options.quiet
@options.verbose
def command(folder: Path, archive: Path | None, quiet: bool, verbose: bool) -> None:
    """\b
    Example:
      vtrack-batch init my-survey --from /archive/frames

    Write a commented survey.yaml, its JSON schema for editors and a template for zones.
    """
    from vtrack_batch.pipeline.init import write_survey

    for line in write_survey(folder, archive):
        options.speaker(quiet)(line)
