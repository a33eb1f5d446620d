"""``vtrack-batch evaluate``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command("evaluate", short_help="Measure a result against a truth: detection, links, tracks, OD pairs, speeds.")
@click.argument("result", type=click.Path(path_type=Path))
@click.argument("truth", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="Folder for evaluation.json and evaluation.md.")
@click.option("--time-zone", help="Zone of local times in TRUTH, such as Asia/Seoul; only geo-trax needs it.")
@options.as_json
@options.quiet
@options.verbose
def command(
    result: Path, truth: Path, out: Path | None, time_zone: str | None, as_json: bool, quiet: bool, verbose: bool
) -> None:
    """\b
    Example:
      vtrack-batch evaluate demo/results demo/truth

    Measure a result against a truth: detection, links, tracks, OD pairs, speeds.

    RESULT is a result folder, or a folder of tables as `track` and `match` write them (with detections.parquet beside,
    unless they were made from TRUTH's own detections), or a tracker's boxes (MOTChallenge).

    TRUTH is a folder or one of its files: tables as `simulate` writes them, a result folder, a rendered archive's
    truth.csv, KIT tracks.csv, MOTChallenge gt.txt, boxes without a head line (SkySat), geo-trax CSV, or a Parquet
    table of detections with a column truth_vehicle.
    """
    from vtrack_batch.evaluation.evaluate import evaluate
    from vtrack_batch.evaluation.load import load_result, load_truth
    from vtrack_batch.storage.output import make_folder

    found = evaluate(load_result(result), load_truth(truth, time_zone=time_zone))
    if out is not None:
        make_folder(out)
        (out / "evaluation.json").write_text(options.as_text(found.numbers) + "\n", encoding="utf-8")
        (out / "evaluation.md").write_text(found.markdown(), encoding="utf-8")
    options.answer(found.numbers, found.text(), as_json=as_json)
