"""Options shared by commands, and how they speak: answers to stdout, remarks to stderr."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

survey_file = click.argument("survey_yaml", type=click.Path(path_type=Path))
out_folder = click.option(
    "--out", type=click.Path(path_type=Path), help="Result folder, in place of output.root in the survey file."
)
as_json = click.option("--json", "as_json", is_flag=True, help="Answer as JSON.")
quiet = click.option("-q", "--quiet", is_flag=True, help="Say nothing but errors.")
verbose = click.option("-v", "--verbose", is_flag=True, help="Say more.")


def speaker(quiet: bool) -> Callable[[str], None]:
    """Return a function that writes a remark to stderr, or nothing when *quiet*."""
    return (lambda message: None) if quiet else (lambda message: click.echo(message, err=True))


def answer(value: Any, text: str, *, as_json: bool) -> None:
    """Write the answer to stdout: *value* as JSON, or *text*."""
    click.echo(json.dumps(value, indent=2, sort_keys=True, ensure_ascii=False, default=str) if as_json else text)


def load(survey_yaml: Path, out: Path | None = None) -> Any:
    """Return the survey of *survey_yaml*, writing to *out* if given."""
    from vtrack_batch.config.load import load_survey

    survey = load_survey(survey_yaml)
    if out is None:
        return survey
    moved = survey.model_copy(update={"output": survey.output.model_copy(update={"root": str(out.resolve())})})
    return moved.based_at(survey.base)
