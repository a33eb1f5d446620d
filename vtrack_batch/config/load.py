"""Read a YAML file into frozen parameters; report all mistakes at once with line, column and a suggestion."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import AliasEvent, NodeEvent

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
    tree = _read_yaml(path)
    try:
        return model.model_validate(_plain(tree))
    except ValidationError as problem:
        lines = [_sentence(path.name, tree, model, error) for error in problem.errors()]
        count = f"{len(lines)} error{'s' if len(lines) > 1 else ''}"
        schema = ". Schema: vtrack-batch schema config" if model is Survey else ""
        raise ConfigError("\n".join([*lines, f"{count}{schema}"])) from None


def _read_yaml(path: Path) -> Any:
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; `vtrack-batch init` writes a survey file") from None
    except (OSError, ValueError) as problem:
        raise ConfigError(f"{path}: cannot be read ({problem})") from None
    if len(data) > MAX_FILE_BYTES:
        raise ConfigError(f"{path}: {len(data)} bytes; a survey file has at most {MAX_FILE_BYTES}")
    try:
        text = data.decode("utf-8")
        _refuse_aliases_and_tags(path, text)
        tree = YAML(typ="rt").load(text)
    except UnicodeDecodeError as problem:
        raise ConfigError(f"{path.name}: not UTF-8 text ({problem})") from None
    except MarkedYAMLError as problem:
        mark = problem.problem_mark
        place = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        raise ConfigError(f"{path.name}{place}: {str(problem.problem).splitlines()[0]}") from None
    except (YAMLError, RecursionError, ValueError) as problem:
        raise ConfigError(f"{path.name}: not valid YAML: {str(problem).splitlines()[0]}") from None
    if tree is None:
        return {}
    if not isinstance(tree, Mapping):
        raise ConfigError(f"{path.name}:1:1: expected sections such as `archive:`, found {type(tree).__name__}")
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


def _sentence(file: str, tree: Any, model: type[BaseModel], error: Any) -> str:
    loc: tuple[int | str, ...] = error["loc"]
    line, column = _position(tree, loc)
    where = f"{file}:{line}:{column}"
    if error["type"] == "extra_forbidden":
        known = list(_fields_at(model, loc[:-1]))
        near = difflib.get_close_matches(str(loc[-1]), known, n=1, cutoff=0.6)
        inside = f' in "{".".join(map(str, loc[:-1]))}"' if len(loc) > 1 else ""
        hint = f'did you mean "{near[0]}"?' if near else f"known here: {', '.join(known)}"
        return f'{where}: unknown key "{loc[-1]}"{inside}; {hint}'
    message = str(error["msg"]).removeprefix("Value error, ")
    found = error.get("input")
    shown = f" (found {found!r})" if isinstance(found, str | int | float | bool) else ""
    name = ".".join(str(part) for part in loc)
    return f"{where}: {name + ': ' if name else ''}{message}{shown}"


def _position(tree: Any, loc: Sequence[int | str]) -> tuple[int, int]:
    """Return line and column (from 1) of the deepest part of *loc* that the file holds."""
    line, column = 1, 1
    node = tree
    for part in loc:
        marks = getattr(node, "lc", None)
        try:
            if isinstance(node, Mapping) and part in node and marks is not None:
                line, column = (n + 1 for n in marks.key(part))
                node = node[part]
            elif (
                isinstance(node, Sequence) and not isinstance(node, str) and isinstance(part, int) and marks is not None
            ):
                line, column = (n + 1 for n in marks.item(part))
                node = node[part]
            else:
                break
        except (KeyError, IndexError, TypeError, AttributeError):
            break
    return line, column


def _fields_at(model: type[BaseModel], loc: Sequence[int | str]) -> Iterator[str]:
    """Yield the names of the keys that are known at *loc*."""
    kind: Any = model
    for part in loc:
        if isinstance(kind, type) and issubclass(kind, BaseModel) and part in kind.model_fields:
            kind = _model_in(kind.model_fields[str(part)].annotation)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield from kind.model_fields


def _model_in(annotation: Any) -> Any:
    """Return the parameter class inside an annotation such as ``list[Point] | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        found = _model_in(inner)
        if found is not None:
            return found
    return None
