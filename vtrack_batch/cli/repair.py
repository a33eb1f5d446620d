"""``vtrack-batch repair``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command("repair", short_help="Clear away what is damaged or half written, so that the next run makes it anew.")
@options.survey_file
@options.out_folder
@options.wait
@options.as_json
@options.quiet
@options.verbose
def command(survey_yaml: Path, out: Path | None, wait_s: float, as_json: bool, quiet: bool, verbose: bool) -> None:
    """\b
    Example:
      vtrack-batch repair survey.yaml && vtrack-batch run survey.yaml

    Clear away what is damaged or half written, and all that can be made again: remembered hashes, the record of the
    last run. A crash never calls for this; a disk that lost data, or a hand in the folder, does.
    """
    from vtrack_batch.pipeline.upkeep import repair

    done = repair(options.load(survey_yaml, out), wait_s=wait_s)
    lines = [f"dropped: {name}" for name in done.dropped]
    lines += ["the published snapshot is damaged: the next run publishes a whole one"] if done.snapshot_damaged else []
    lines += [f"{len(done.dropped)} damaged results dropped; `vtrack-batch run` makes anew what is missing"]
    if not quiet:
        value = {"dropped": list(done.dropped), "snapshot_damaged": done.snapshot_damaged}
        options.answer(value, "\n".join(lines), as_json=as_json)
