"""Options shared by commands, and how they speak: answers to stdout, remarks to stderr."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

survey_file = click.argument("survey_yaml", type=click.Path(path_type=Path))
out_folder = click.option(
    "--out", type=click.Path(path_type=Path), help="Result folder, in place of output.root in the survey file."
)
as_json = click.option("--json", "as_json", is_flag=True, help="Answer as JSON.")
wait = click.option(
    "--wait", "wait_s", type=click.FloatRange(0), default=0.0, help="Seconds to wait for another run to end."
)
quiet = click.option("-q", "--quiet", is_flag=True, help="Say nothing but errors.")
verbose = click.option("-v", "--verbose", is_flag=True, help="Say more.")

METHODS = (
    "default", "untrained", "original", "colour", "opposite", "proposed", "regions", "assignment", "nearest",
)  # fmt: skip
method = click.option("--method", type=click.Choice(METHODS), default="default", show_default=True, help="What links.")
flow_map = click.option("--flow-map", type=click.Path(path_type=Path), help="Flow map of the place, made by `learn`.")


def foreign_table(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that declare what the columns of anybody's table of detections mean."""
    for option in reversed(_FOREIGN):
        command = option(command)
    return command


_FOREIGN = (
    click.option(
        "--column", "columns", multiple=True, metavar="OURS=THEIRS", help="Name of a column, say x_m=Local_X."
    ),
    click.option(
        "--metres-per-unit",
        type=click.FloatRange(min=0, min_open=True),
        default=1.0,
        help="Unit of x and y; 0.33 for pixels of 33 cm.",
    ),
    click.option("--y-down", is_flag=True, help="y grows downward, as rows of an image do."),
    click.option(
        "--seconds-per-unit",
        type=click.FloatRange(min=0, min_open=True),
        help="Unit of times that are numbers, counted from 1970-01-01 UTC.",
    ),
    click.option("--time-zone", help="Zone of times that name none, say UTC."),
)


def declared(chosen: Mapping[str, Any]) -> Any:
    """Return what the options of ``foreign_table`` declare."""
    from vtrack_batch.pipeline.foreign import Declared

    for pair in chosen["columns"]:
        if "=" not in pair:
            raise click.BadParameter(f"expected OURS=THEIRS, say x_m=Local_X, found {pair!r}", param_hint="--column")
    named = {**chosen, "columns": dict(pair.split("=", 1) for pair in chosen["columns"])}
    return Declared(**named)


def speaker(quiet: bool) -> Callable[[str], None]:
    """Return a function that writes a remark to stderr, or nothing when *quiet*."""
    return (lambda message: None) if quiet else (lambda message: click.echo(message, err=True))


def answer(value: Any, text: str, *, as_json: bool) -> None:
    """Write the answer to stdout: *value* as JSON, or *text*."""
    click.echo(as_text(value) if as_json else text)


def as_text(value: Any) -> str:
    """Return *value* as JSON for people and programs."""
    return json.dumps(_plain(value), indent=2, sort_keys=True, ensure_ascii=False)


def _plain(value: Any) -> Any:
    """Return *value* in what JSON knows: numbers of tables as numbers, missing ones as null, times in ISO 8601."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # of NumPy
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "isoformat") and value == value:
        return value.isoformat()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return None if str(value) in ("<NA>", "NaT") else str(value)


def load(survey_yaml: Path, out: Path | None = None) -> Any:
    """Return the survey of *survey_yaml*, writing to *out* if given."""
    from vtrack_batch.config.load import load_survey

    survey = load_survey(survey_yaml)
    if out is None:
        return survey
    moved = survey.model_copy(update={"output": survey.output.model_copy(update={"root": str(out.resolve())})})
    return moved.based_at(survey.base)
