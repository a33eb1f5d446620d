"""``vtrack-batch learn``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from vtrack_batch.cli import options


@click.command("learn", short_help="Learn a place's flow map from detections, without truth.")
@click.argument("detections", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="File for the flow map.")
@options.foreign_table
@options.as_json
@options.quiet
@options.verbose
def command(detections: Path, out: Path, as_json: bool, quiet: bool, verbose: bool, **table: Any) -> None:
    """\b
    Example:
      vtrack-batch learn archive.parquet --out place.flow
      vtrack-batch track today.parquet --out tracked --flow-map place.flow

    Learn a place's flow map from detections, without truth: how vehicles move where. Best from some ten minutes or
    more, taken at the interval at which the map will be used. Columns as for `track`.
    """
    from vtrack_batch.pipeline.tables import learn_file

    motions = len(learn_file(detections, out, declared=options.declared(table)).xy)
    options.answer({"flow_map": str(out), "motions": motions}, f"{motions} motions: {out}", as_json=as_json)
