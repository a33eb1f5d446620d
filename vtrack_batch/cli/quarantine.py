"""``vtrack-batch quarantine``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command("quarantine", short_help="List frames that were set aside, or have them tried again by the next run.")
@click.argument("action", type=click.Choice(["list", "retry"]))
@options.survey_file
@click.argument("paths", nargs=-1)
@options.out_folder
@options.wait
@options.as_json
@options.quiet
@options.verbose
def command(
    action: str,
    survey_yaml: Path,
    paths: tuple[str, ...],
    out: Path | None,
    wait_s: float,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """\b
    Examples:
      vtrack-batch quarantine list survey.yaml
      vtrack-batch quarantine retry survey.yaml
      vtrack-batch quarantine retry survey.yaml north/0007.jpg

    List frames that were set aside, with reasons; or have those tried again that were set aside for something that may
    have passed (a disk error, missing permission, a worker's death), or the frames named, whatever the reason.
    """
    survey = options.load(survey_yaml, out)
    if action == "retry":
        from vtrack_batch.pipeline.upkeep import retry

        found = retry(survey, paths, wait_s=wait_s)
        text = "\n".join([*found, f"{len(found)} frames will be tried again by the next run"])
        if not quiet:
            options.answer(found, text, as_json=as_json)
        return
    from vtrack_batch.storage.results import open_results

    table = open_results(survey.resolve(survey.output.root))["quarantine"]
    rows = table.astype(object).where(table.notna(), None).to_dict("records")
    rows = [row for row in rows if not paths or row["path"] in paths]
    lines = [f"{row['path']}: {row['reason']}" + (f" ({row['detail']})" if row["detail"] else "") for row in rows]
    options.answer(rows, "\n".join(lines) or "no frame is set aside", as_json=as_json)
