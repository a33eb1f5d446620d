"""What is made from the code is not stale, and every command and table has its place in the documentation."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vtrack_batch.cli import COMMANDS
from vtrack_batch.cli.reference import pages
from vtrack_batch.model.tables import TABLES

PROJECT = Path(__file__).resolve().parents[1]
PAGES = [
    *(PROJECT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "benchmarks/README.md")),
    *sorted((PROJECT / "docs").rglob("*.md")),
]


@pytest.mark.parametrize("place", sorted(pages()))
def test_made_pages_are_fresh(place: str) -> None:
    assert (PROJECT / place).read_text(encoding="utf-8") == pages()[place], "run `make docs`"


def test_the_reference_names_every_command_and_table() -> None:
    commands = (PROJECT / "docs/reference/commands.md").read_text(encoding="utf-8")
    tables = (PROJECT / "docs/reference/tables.md").read_text(encoding="utf-8")
    assert all(f"## {name}\n" in commands for name in COMMANDS)
    assert all(f"## {name}\n" in tables for name in TABLES)


def test_links_between_pages_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
            assert "://" in target or (page.parent / target).exists(), f"{page.name}: {target}"


def test_pages_name_commands_that_exist() -> None:
    targets = re.findall(r"^([a-z-]+):", (PROJECT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    benches = [path.stem for path in (PROJECT / "benchmarks").glob("*.py")]
    known = {"vtrack-batch ": set(COMMANDS), "make ": set(targets), "python -m benchmarks.": set(benches)}
    seen = dict.fromkeys(known, 0)
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for start, name in re.findall(r"(?:^|[`/])(vtrack-batch |make |python -m benchmarks\.)([a-z_-]+)", text, re.M):
            assert name in known[start], f"{page.name}: {start}{name}"
            seen[start] += 1
    assert min(seen.values()) > 5


def test_no_page_names_a_folder_of_a_machine() -> None:
    for page in [*PAGES, *(PROJECT / "vtrack_batch").rglob("*.py")]:
        assert not re.search(r"/(home|root|work|Users)/", page.read_text(encoding="utf-8")), page
