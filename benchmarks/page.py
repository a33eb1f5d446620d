"""Write sections of pages that commands make, and leave the rest of the page alone."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
SHARED = PROJECT.parent / "shared" / "data"
DOCS = PROJECT / "docs"
FIGURES = DOCS / "figures"
ACCURACY, PERFORMANCE, PAPER = DOCS / "accuracy.md", DOCS / "performance.md", DOCS / "paper.md"
OURS = ("vtrack-batch", "numpy", "scipy", "numba", "pandas")


def write_section(page: Path, name: str, markdown: str) -> None:
    """Replace what stands between ``<!-- begin NAME -->`` and ``<!-- end NAME -->``; append it where there is none."""
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    section = f"{begin}\n\n{markdown.strip()}\n\n{end}"
    text = page.read_text(encoding="utf-8") if page.exists() else f"# {page.stem.capitalize()}\n"
    if (begin in text) != (end in text) or text.count(begin) > 1:
        raise ValueError(f"{page}: section {name} has no clear begin and end")
    if begin in text:
        before, rest = text.split(begin)
        text = before + section + rest.split(end, 1)[1]
    else:
        text = text.rstrip("\n") + "\n\n" + section + "\n"
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(text, encoding="utf-8")


def stamp(command: str, names: Iterable[str] = OURS, peers: Iterable[str] = ()) -> str:
    """Return the line that says which command made a section, with which versions; *peers* are ``NAME VERSION``."""
    own = [f"{name} {version(name)}" for name in names]
    versions = dict.fromkeys([f"Python {platform.python_version()}", *own, *peers])
    return f"Made by `{command}`. Versions: {', '.join(versions)}."


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table, the first column to the left, the others to the right."""
    lines = ["| " + " | ".join(heads) + " |", "|---|" + "---:|" * (len(heads) - 1)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])
