"""The commented example survey, written from the parameters' own descriptions and defaults."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from vtrack_batch.config.survey import Survey
from vtrack_batch.simulation.params import Scenario

HEADER = """\
# yaml-language-server: $schema=./survey.schema.json
# A survey of vtrack-batch. Every key is optional; what stands here are the defaults.
# Lengths are in metres, times in seconds, speeds in metres a second; paths are relative to this file.
"""


def example_yaml(chosen: Mapping[str, Mapping[str, Any] | Any] | None = None, *, ask: str | None = None) -> str:
    """Return a complete commented survey file.

    *chosen* replaces defaults, by section and key; the key *ask* is left for the user to write.
    """
    survey = Survey.model_validate(chosen or {})
    lines = [HEADER]
    for name, field in Survey.model_fields.items():
        value = getattr(survey, name)
        lines += _comment(field.description, "")
        if isinstance(value, BaseModel):
            lines.append(f"{name}:")
            lines += _section(value)
        else:
            lines.append(f"{name}: {_scalar(value)}")
        lines.append("")
    lines = [
        f"{line.replace(ask, f'# {ask}')}   <- to be written" if ask and line.strip().startswith(f"{ask}:") else line
        for line in lines
    ]
    return "\n".join(lines).rstrip() + "\n"


def survey_page() -> str:
    """Return the reference of the survey file in Markdown: every key with its default and what it means."""
    needed = "Every key is optional but `georeference.gsd_m`, where frames do not tell it themselves."
    lines = _head("The survey file", needed)
    survey = Survey()
    for name, field in Survey.model_fields.items():
        value = getattr(survey, name)
        lines += [f"## {name}", "", field.description or "", ""]
        lines += _table(_rows(value, "") if isinstance(value, BaseModel) else [(name, value, field.description or "")])
    return "\n".join(lines).rstrip() + "\n"


def scenario_page() -> str:
    """Return the reference of the scenario file of `simulate` in Markdown: first its own keys, then its sections."""
    lines = _head("The scenario file", "`vtrack-batch simulate` reads it; every key is optional.")
    scenario = Scenario()
    values = {name: getattr(scenario, name) for name in Scenario.model_fields}
    sections = [name for name, value in values.items() if isinstance(value, BaseModel)]
    lines += ["## The archive", "", *_table(row for row in _rows(scenario, "") if row[0].split(".")[0] not in sections)]
    for name in sections:
        lines += [f"## {name}", "", Scenario.model_fields[name].description or "", "", *_table(_rows(values[name], ""))]
    return "\n".join(lines).rstrip() + "\n"


def _head(title: str, needed: str) -> list[str]:
    made = "Made by `make docs` from the parameters' own descriptions."
    units = "Lengths are in metres, times in seconds, speeds in metres a second; paths are relative to the file."
    return [f"# {title}", "", made, "", units, needed, ""]


def _table(rows: Iterable[tuple[str, Any, str]]) -> list[str]:
    lines = ["| key | default | meaning |", "|---|---|---|"]
    return [*lines, *(f"| `{key}` | `{_scalar(default)}` | {text} |" for key, default, text in rows), ""]


def _rows(values: BaseModel, prefix: str) -> Iterator[tuple[str, Any, str]]:
    for name, field in type(values).model_fields.items():
        value = getattr(values, name)
        if isinstance(value, BaseModel):
            yield from _rows(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value, (field.description or "").replace("|", "or")


def schema_json() -> str:
    """Return the JSON schema of the survey file, for editors."""
    return json.dumps(Survey.model_json_schema(), indent=2, sort_keys=True, ensure_ascii=False) + "\n"


def _section(values: BaseModel, indent: str = "  ") -> list[str]:
    lines: list[str] = []
    for name, field in type(values).model_fields.items():
        value = getattr(values, name)
        lines += _comment(field.description, indent)
        if isinstance(value, BaseModel):
            lines.append(f"{indent}{name}:")
            lines += _section(value, indent + "  ")
        else:
            lines.append(f"{indent}{name}: {_scalar(value)}")
    return lines


def _comment(text: str | None, indent: str) -> list[str]:
    return textwrap.wrap(text or "", 116, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}# ")


def _scalar(value: Any) -> str:
    """Return *value* as YAML on one line; JSON is a subset of YAML 1.2."""
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_scalar(item) for item in value) + "]"
    if isinstance(value, BaseModel):
        return "{" + ", ".join(f"{key}: {_scalar(item)}" for key, item in value) + "}"
    if hasattr(value, "isoformat"):
        value = value.isoformat()
    return json.dumps(value, ensure_ascii=False)
