"""What is made from the code is not stale, and every command and table has its place in the documentation."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vtrack_batch.cli import COMMANDS
from vtrack_batch.cli.reference import pages
from vtrack_batch.model.tables import TABLES

PROJECT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("place", sorted(pages()))
def test_made_pages_are_fresh(place: str) -> None:
    assert (PROJECT / place).read_text(encoding="utf-8") == pages()[place], "run `make docs`"


def test_the_reference_names_every_command_and_table() -> None:
    commands = (PROJECT / "docs/reference/commands.md").read_text(encoding="utf-8")
    tables = (PROJECT / "docs/reference/tables.md").read_text(encoding="utf-8")
    assert all(f"## {name}\n" in commands for name in COMMANDS)
    assert all(f"## {name}\n" in tables for name in TABLES)


def test_links_between_pages_lead_somewhere() -> None:
    for page in [PROJECT / "README.md", PROJECT / "CONTRIBUTING.md", *(PROJECT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
            assert "://" in target or (page.parent / target).exists(), f"{page.name}: {target}"


def test_no_page_names_a_folder_of_a_machine() -> None:
    for page in [PROJECT / "README.md", *(PROJECT / "docs").rglob("*.md"), *(PROJECT / "vtrack_batch").rglob("*.py")]:
        assert not re.search(r"/(home|root|work|Users)/", page.read_text(encoding="utf-8")), page
