"""``vtrack-batch match``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from vtrack_batch.cli import options


@click.command("match", short_help="Match two tables of detections, anybody's.")
@click.argument("earlier", type=click.Path(path_type=Path))
@click.argument("later", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for matches.parquet.")
@options.method
@options.flow_map
@click.option("--elapsed-s", type=click.FloatRange(min=0, min_open=True), help="Time between; else from t_utc.")
@options.foreign_table
@options.as_json
@options.quiet
@options.verbose
def command(
    earlier: Path,
    later: Path,
    out: Path,
    method: str,
    flow_map: Path | None,
    elapsed_s: float | None,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **table: Any,
) -> None:
    """\b
    Example:
      vtrack-batch match earlier.parquet later.parquet --out matched --elapsed-s 1.5
      vtrack-batch match a.csv b.csv --out matched --elapsed-s 1.5 --metres-per-unit 0.33 --y-down

    Match two tables of detections, anybody's: detection_id, x_m, y_m; red, green, blue if known. CSV or Parquet.
    """
    from vtrack_batch.pipeline.tables import match_files

    path, count = match_files(
        earlier,
        later,
        out,
        method=method,
        elapsed_s=elapsed_s,
        flow_map=flow_map,
        declared=options.declared(table),
    )
    options.answer({"matches": str(path), "linked": count}, f"{count} linked: {path}", as_json=as_json)
