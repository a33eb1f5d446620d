"""``vtrack-batch doctor``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from vtrack_batch.cli import options

TROUBLE = 73


@click.command("doctor", short_help="Show versions, limits, disk, permissions and clock, and what will give trouble.")
@click.argument("survey_yaml", type=click.Path(path_type=Path), required=False)
@options.out_folder
@options.as_json
@options.quiet
@options.verbose
def command(survey_yaml: Path | None, out: Path | None, as_json: bool, quiet: bool, verbose: bool) -> int:
    """\b
    Examples:
      vtrack-batch doctor
      vtrack-batch doctor survey.yaml --json

    Show versions, limits, disk, permissions and clock, and what will give trouble (exit 73 if something will): paste
    it into a report of trouble.
    """
    from vtrack_batch.pipeline.doctor import examine

    found = examine(options.load(survey_yaml, out) if survey_yaml is not None else None)
    problems = [f"{one.name}: {one.problem}" for one in found if one.problem]
    lines = [f"{one.name}: {_words(one.value)}" for one in found]
    lines += [f"problem: {text}" for text in problems] or ["no problems found"]
    if not quiet or problems:
        answer = {**{one.name: one.value for one in found}, "problems": problems}
        options.answer(answer, "\n".join(lines), as_json=as_json)
    return TROUBLE if problems else 0


def _words(value: Any) -> str:
    return ", ".join(f"{name} {part}" for name, part in value.items()) if isinstance(value, dict) else str(value)
