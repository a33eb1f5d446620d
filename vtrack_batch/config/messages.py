"""What is wrong with a survey file, in the words of the one who wrote it: where, expected, found, what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from pydantic import BaseModel

_UNITS = {
    "_m": "metres",
    "_m2": "square metres",
    "_s": "seconds",
    "_mps": "metres a second",
    "_mps2": "metres a second squared",
    "_deg": "degrees",
    "_px": "pixels",
}
_TIME = 'a time with its offset from UTC, such as "2026-05-17T06:00:00+02:00"'
_KINDS = {
    "string_type": "text",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "tuple_type": "a list",
    "list_type": "a list",
    "timezone_aware": _TIME,
    "datetime_type": _TIME,
    "datetime_parsing": _TIME,
    "datetime_from_date_parsing": _TIME,
    "missing": "a value",
}
_BOUNDS = {
    "greater_than": ("gt", "more than"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"),
    "too_short": ("min_length", "a list with a length of at least"),
    "too_long": ("max_length", "a list with a length of at most"),
    "string_too_short": ("min_length", "text with a length of at least"),
    "string_too_long": ("max_length", "text with a length of at most"),
}


def sentences(errors: Sequence[Any], tree: Any, model: type[BaseModel], *, file: str) -> Iterator[str]:
    """Yield one line per mistake: ``file:line:column: key: expected ..., found ...``.

    *errors* are those of pydantic's ``ValidationError`` for *model*; *tree* is what ruamel.yaml read, with its marks.
    """
    placed = [(_known(model, error["loc"]), error) for error in errors]
    for loc, group in groupby(placed, key=lambda pair: pair[0]):
        line, column = _position(tree, loc)
        yield f"{file}:{line}:{column}: {_sentence(model, loc, [error for _, error in group])}"


def _sentence(model: type[BaseModel], loc: tuple[int | str, ...], errors: Sequence[Any]) -> str:
    first = errors[0]
    if first["type"] == "extra_forbidden":
        known = list(_fields_at(model, loc[:-1]))
        inside = f' in "{_joined(loc[:-1])}"' if len(loc) > 1 else ""
        hint = _nearest(str(loc[-1]), known) or "known here: " + ", ".join(known)
        return f'unknown key "{loc[-1]}"{inside}; {hint}'
    if first["type"] in ("value_error", "assertion_error"):
        return f"{_joined(loc)}: " * bool(loc) + str(first["msg"]).removeprefix("Value error, ")
    wanted = " or ".join(dict.fromkeys(_expected(model, loc, error) for error in errors))
    # with several ways to write a value, the innermost mistake shows what of it is wrong
    found = min((error.get("input") for error in errors), key=lambda value: len(repr(value)))
    near = _nearest(str(found), _choices(first)) if first["type"] == "literal_error" else None
    return f"{_joined(loc)}: expected {wanted}, found {_shown(found)}" + (f"; {near}" if near else "")


def _expected(model: type[BaseModel], loc: tuple[int | str, ...], error: Any) -> str:
    kind = error["type"]
    if kind in _BOUNDS:
        name, words = _BOUNDS[kind]
        return f"{words} {error['ctx'][name]}"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return f"keys of its own below it: {', '.join(_fields_at(model, loc))}"
    if kind == "literal_error":
        return f"one of {', '.join(_choices(error))}"
    unit = next((unit for end, unit in _UNITS.items() if str(loc[-1]).endswith(end)), None)
    words = _KINDS.get(kind, str(error["msg"]).removeprefix("Input should be "))
    return f"{words} of {unit}, without the unit" if unit and words.endswith("number") else words


def _choices(error: Any) -> list[str]:
    """Return the choices of a ``literal_error``, which pydantic gives as one sentence."""
    return str(error["ctx"]["expected"]).replace(" or ", ", ").replace("'", "").split(", ")


def _shown(value: Any) -> str:
    return {list: "a list", tuple: "a list", dict: "keys", type(None): "nothing"}.get(type(value), repr(value))


def _nearest(word: str, known: Sequence[str]) -> str | None:
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    return f'did you mean "{near[0]}"?' if near else None


def _joined(loc: Sequence[int | str]) -> str:
    return ".".join(map(str, loc))


def _known(model: type[BaseModel], loc: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """Return *loc* without the names that pydantic gives to the members of a union."""
    kept: list[int | str] = []
    for index, part in enumerate(loc):
        names = set(_fields_at(model, kept))
        last = index == len(loc) - 1
        if isinstance(part, int) or part in names or (names and last and not str(part).startswith(("tuple[", "list["))):
            kept.append(part)
    return tuple(kept)


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
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            if part not in kind.model_fields:
                return
            kind = _model_in(kind.model_fields[str(part)].annotation)
        elif not isinstance(part, int):
            return
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
