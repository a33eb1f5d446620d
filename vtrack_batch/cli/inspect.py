"""``vtrack-batch inspect``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command(
    "inspect", short_help="Look at a table, at what became of a frame, or write one frame on the ground grid."
)
@options.survey_file
@click.argument("what", required=False)
@click.option("--ortho", metavar="FRAME", help="Write this frame as GeoTIFF at the set gsd_m (path or frame_id).")
@click.option("--to", type=click.Path(path_type=Path), help="File that --ortho writes.")
@click.option("--rows", type=click.IntRange(1), default=10, help="Rows of a table to show.")
@options.out_folder
@options.as_json
@options.quiet
@options.verbose
def command(
    survey_yaml: Path,
    what: str | None,
    ortho: str | None,
    to: Path | None,
    rows: int,
    out: Path | None,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """\b
    Examples:
      vtrack-batch inspect survey.yaml od_pairs
      vtrack-batch inspect survey.yaml frames/0001.jpg
      vtrack-batch inspect survey.yaml --ortho frames/0001.jpg --to 0001.tif

    Look at a table, at what became of a frame, or write one frame on the ground grid.
    """
    from vtrack_batch.pipeline.inspect import inspect_frame, inspect_table, write_ortho

    survey = options.load(survey_yaml, out)
    if (ortho is None) == (what is None):
        raise click.UsageError("name a table or a frame, or use --ortho FRAME")
    if ortho is not None:
        target = write_ortho(survey, ortho, to)
        options.answer({"written": str(target)}, f"written: {target}", as_json=as_json)
    if what is not None:
        from vtrack_batch.model.tables import TABLES

        value, text = inspect_table(survey, what, rows) if what in TABLES else inspect_frame(survey, what)
        options.answer(value, text, as_json=as_json)
