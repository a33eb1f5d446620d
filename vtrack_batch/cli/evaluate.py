"""``vtrack-batch evaluate``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command("evaluate", short_help="Measure a result against a truth: detection, links, tracks, OD pairs, speeds.")
@click.argument("result", type=click.Path(path_type=Path))
@click.argument("truth", type=click.Path(path_type=Path))
@options.as_json
@options.quiet
@options.verbose
def command(result: Path, truth: Path, as_json: bool, quiet: bool, verbose: bool) -> None:
    """\b
    Example:
      vtrack-batch evaluate demo/results demo/truth

    Measure a result against a truth: detection, links, tracks, OD pairs, speeds.

    TRUTH is a folder: tables as `simulate` writes them, a rendered archive's truth.csv, or KIT tracks.csv.
    """
    from vtrack_batch.evaluation.evaluate import evaluate
    from vtrack_batch.evaluation.load import load_result, load_truth

    found = evaluate(load_result(result), load_truth(truth))
    options.answer(found.numbers, found.text(), as_json=as_json)
