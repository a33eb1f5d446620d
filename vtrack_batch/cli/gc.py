"""``vtrack-batch gc``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command("gc", short_help="Remove snapshots superseded a day ago or more, and results that no snapshot names.")
@options.survey_file
@options.out_folder
@click.option(
    "--keep-hours",
    type=click.FloatRange(24),
    default=24.0,
    show_default=True,
    help="How long a superseded snapshot stays for those who still read it.",
)
@click.option("--dry-run", is_flag=True, help="Say what would go; remove nothing.")
@options.wait
@options.as_json
@options.quiet
@options.verbose
def command(
    survey_yaml: Path,
    out: Path | None,
    keep_hours: float,
    dry_run: bool,
    wait_s: float,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """\b
    Examples:
      vtrack-batch gc survey.yaml --dry-run
      vtrack-batch gc survey.yaml -q

    Remove snapshots superseded a day ago or more, and results that no snapshot names. What is published, what the last
    run built on, and whatever is younger stays.
    """
    from vtrack_batch.pipeline.upkeep import collect

    gone = collect(options.load(survey_yaml, out), keep_hours=keep_hours, dry_run=dry_run, wait_s=wait_s)
    counts = {"snapshots": len(gone.snapshots), "parts": len(gone.parts), "bytes": gone.bytes}
    text = f"{counts['snapshots']} snapshots and {counts['parts']} parts, {gone.bytes / 1e6:.1f} MB"
    if verbose:
        text = "\n".join([*map(str, gone.snapshots), *map(str, gone.parts), text])
    if not quiet:
        options.answer(counts, f"{'would go' if dry_run else 'gone'}: {text}", as_json=as_json)
