"""``vtrack-batch verify``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options

DAMAGED = 74


@click.command("verify", short_help="Compare every published file with what was written (exit 74 if one differs).")
@options.survey_file
@options.out_folder
@click.option("--data", is_flag=True, help="Also the results of all steps, published or not.")
@click.option("--inputs", is_flag=True, help="Also the frames of the archive, against what they held when first read.")
@options.as_json
@options.quiet
@options.verbose
def command(
    survey_yaml: Path, out: Path | None, data: bool, inputs: bool, as_json: bool, quiet: bool, verbose: bool
) -> int:
    """\b
    Examples:
      vtrack-batch verify survey.yaml
      vtrack-batch verify survey.yaml --data --inputs

    Compare every published file with what was written: size and hash. Exit 0 if all is as written, 74 if not;
    `vtrack-batch repair` then clears away what is damaged, and a run makes it anew.
    """
    from vtrack_batch.pipeline.upkeep import verify

    found = verify(options.load(survey_yaml, out), data=data, inputs=inputs)
    if not quiet or found:
        lines = [f"{damage.place}: {damage.what}" for damage in found]
        text = "\n".join(lines) or "all is as it was written"
        options.answer([{"place": d.place, "what": d.what} for d in found], text, as_json=as_json)
    return DAMAGED if found else 0
