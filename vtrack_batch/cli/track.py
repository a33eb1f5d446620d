"""``vtrack-batch track``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from vtrack_batch.cli import options


@click.command("track", short_help="Track a table of detections, anybody's.")
@click.argument("detections", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the three tables.")
@options.method
@options.flow_map
@options.foreign_table
@options.as_json
@options.quiet
@options.verbose
def command(
    detections: Path,
    out: Path,
    method: str,
    flow_map: Path | None,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **table: Any,
) -> None:
    """\b
    Example:
      vtrack-batch track detections.parquet --out tracked
      vtrack-batch track cars.csv --out tracked --column x_m=Local_X --column y_m=Local_Y --time-zone Asia/Seoul

    Track a table of detections, anybody's: detection_id, t_utc, x_m, y_m; sequence, colours and velocities if known.
    CSV or Parquet.
    """
    from vtrack_batch.pipeline.tables import track_file

    made = track_file(detections, out, method=method, flow_map=flow_map, declared=options.declared(table))
    text = "\n".join(f"{name}: {rows} rows" for name, rows in made.items())
    options.answer({"out": str(out), "rows": made}, f"{text}\nin {out}", as_json=as_json)
