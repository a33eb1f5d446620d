"""File names as text that is safe in tables, logs and pages, and leads back to the file."""

from __future__ import annotations

import re

_ESCAPE = re.compile(r"\\(?:\\|x[89a-f][0-9a-f]|u[0-9a-f]{4}|U[0-9a-f]{8})")


def escape(name: str) -> str:
    """Return *name* with everything unprintable written as ``\\xNN`` or ``\\uNNNN``, and ``\\`` as ``\\\\``.

    *name* is a file name as Python gives it: bytes that are no UTF-8 stand as surrogates. Different names give
    different texts.
    """
    if name.isprintable() and "\\" not in name:
        return name
    return "".join(_escaped(character) for character in name)


def unescape(text: str) -> str:
    """Return the file name of which ``escape`` made *text*."""
    return _ESCAPE.sub(lambda found: _unescaped(found[0]), text)


def escape_bytes(data: bytes, limit: int = 24) -> str:
    """Return the first *limit* bytes of *data* as printable text, for messages about what a file holds."""
    return repr(data[:limit])[2:-1]


def _escaped(character: str) -> str:
    if character == "\\":
        return "\\\\"
    if character.isprintable():
        return character
    code = ord(character)
    if 0xDC80 <= code <= 0xDCFF:
        return f"\\x{code - 0xDC00:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def _unescaped(escape_sequence: str) -> str:
    kind, digits = escape_sequence[1], escape_sequence[2:]
    if kind == "\\":
        return "\\"
    return chr(int(digits, 16) + (0xDC00 if kind == "x" else 0))
