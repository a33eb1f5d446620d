"""``vtrack-batch track``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command("track", short_help="Track a table of detections, anybody's.")
@click.argument("detections", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for the three tables.")
@click.option("--method", default="default", help="default, proposed, original, colour, opposite, assignment, nearest.")
@options.as_json
@options.quiet
@options.verbose
def command(detections: Path, out: Path, method: str, as_json: bool, quiet: bool, verbose: bool) -> None:
    """\b
    Example:
      vtrack-batch track detections.parquet --out tracked

    Track a table of detections, anybody's: detection_id, t_utc, x_m, y_m; sequence and colours if known.
    """
    from vtrack_batch.pipeline.tables import track_file

    made = track_file(detections, out, method=method)
    text = "\n".join(f"{name}: {rows} rows" for name, rows in made.items())
    options.answer({"out": str(out), "rows": made}, f"{text}\nin {out}", as_json=as_json)
