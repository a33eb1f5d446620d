"""Read a YAML file into frozen parameters; report all mistakes at once with line, column and a suggestion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import AliasEvent, NodeEvent

from vtrack_batch.config.messages import sentences
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import ConfigError

MAX_FILE_BYTES = 1_000_000

Model = TypeVar("Model", bound=BaseModel)


def load_survey(path: str | Path) -> Survey:
    """Read the survey file at *path*; relative paths in it are resolved against its folder.

    Raises ``ConfigError`` with one line per mistake: ``file:line:column: what is wrong; what to do``.
    """
    path = Path(path)
    return load_params(path, Survey).based_at(path.resolve().parent)


def load_params(path: Path, model: type[Model]) -> Model:
    """Read the YAML file at *path* into *model*; raises ``ConfigError`` that lists every mistake."""
    tree = _read_yaml(path, model)
    try:
        return model.model_validate(_plain(tree))
    except ValidationError as problem:
        lines = list(sentences(problem.errors(), tree, model, file=path.name))
        count = f"{len(lines)} error{'s' if len(lines) > 1 else ''}"
        schema = ". Schema: vtrack-batch schema config" if model is Survey else ""
        raise ConfigError("\n".join([*lines, f"{count}{schema}"])) from None


def _read_yaml(path: Path, model: type[BaseModel]) -> Any:
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        hint = "`vtrack-batch init` writes a survey file" if model is Survey else "check the path"
        raise ConfigError(f"{path}: no such file; {hint}") from None
    except (OSError, ValueError) as problem:
        raise ConfigError(f"{path}: cannot be read ({problem})") from None
    if len(data) > MAX_FILE_BYTES:
        raise ConfigError(f"{path}: expected at most {MAX_FILE_BYTES} bytes, found {len(data)}; is it the right file?")
    try:
        text = data.decode("utf-8")
        _refuse_aliases_and_tags(path, text)
        tree = YAML(typ="rt").load(text)
    except UnicodeDecodeError as problem:
        raise ConfigError(f"{path.name}: expected UTF-8 text ({problem}); save it as UTF-8") from None
    except MarkedYAMLError as problem:
        mark = problem.problem_mark
        place = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        raise ConfigError(f"{path.name}{place}: {str(problem.problem).splitlines()[0]}") from None
    except (YAMLError, RecursionError, ValueError) as problem:
        raise ConfigError(f"{path.name}: not valid YAML: {str(problem).splitlines()[0]}") from None
    if tree is None:
        return {}
    if not isinstance(tree, Mapping):
        found = repr(tree)[:40] if isinstance(tree, str | int | float) else "a list"
        raise ConfigError(f"{path.name}:1:1: expected keys such as `{next(iter(model.model_fields))}:`, found {found}")
    return tree


def _refuse_aliases_and_tags(path: Path, text: str) -> None:
    """Refuse what a survey file never needs and what can swell or run code: aliases, anchors, tags."""
    for event in YAML(typ="safe", pure=True).parse(text):
        odd = isinstance(event, AliasEvent) or (
            isinstance(event, NodeEvent) and (event.anchor or getattr(event, "tag", None))
        )
        if odd:
            mark = event.start_mark
            raise ConfigError(
                f"{path.name}:{mark.line + 1}:{mark.column + 1}: "
                "anchors, aliases and tags are not read; write plain values"
            )


def _plain(node: Any) -> Any:
    """Return the YAML tree as plain dicts, lists and scalars."""
    if isinstance(node, Mapping):
        return {str(key): _plain(value) for key, value in node.items()}
    if isinstance(node, Sequence) and not isinstance(node, str):
        return [_plain(value) for value in node]
    if isinstance(node, bool) or node is None:
        return node
    for kind in (int, float, str):
        if isinstance(node, kind):
            return kind(node)
    return node
