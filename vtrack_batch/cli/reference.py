"""Write what is made from the code: the example survey, the reference and the methods pages.

``make docs`` runs this module; a test fails when a page is stale.
"""

from __future__ import annotations

import inspect
from importlib import import_module
from pathlib import Path

import click

from vtrack_batch.cli import COMMANDS, group
from vtrack_batch.model.describe import tables_page

CHAPTERS = (
    "archive", "registration", "georeference", "background", "detection", "completeness", "matching", "tracking",
    "revision", "traffic", "evaluation", "simulation",
)  # fmt: skip


def pages() -> dict[str, str]:
    """Return path (from the project's root) → content of every made page."""
    from vtrack_batch.config.example import example_yaml, scenario_page, survey_page

    return {
        "configs/example.yaml": example_yaml(),
        "docs/reference/survey-file.md": survey_page(),
        "docs/reference/scenario-file.md": scenario_page(),
        "docs/reference/tables.md": tables_page(),
        "docs/reference/commands.md": commands_page(),
        **{f"docs/methods/{chapter}.md": chapter_page(chapter) for chapter in CHAPTERS},
    }


def chapter_page(chapter: str) -> str:
    """Return the page of a chapter: the text that its package begins with."""
    text = inspect.getdoc(import_module(f"vtrack_batch.{chapter}")) or ""
    note = f"Made by `make docs` from `vtrack_batch/{chapter}/__init__.py`."
    question, _, rest = text.replace("``", "").partition("\n\n")
    return f"# {chapter.capitalize()}\n\n{note}\n\n**{question}**\n\n```text\n{rest.rstrip()}\n```\n"


def commands_page() -> str:
    """Return the help of all commands in Markdown."""
    parent = click.Context(group, info_name="vtrack-batch", **group.context_settings)
    lines = ["# Commands", "", "Made by `make docs` from the commands' own help.", ""]
    for name in COMMANDS:
        command = group.get_command(parent, name)
        if command is not None:
            context = click.Context(command, info_name=name, parent=parent, terminal_width=100)
            lines += [f"## {name}", "", "```text", command.get_help(context), "```", ""]
    return "\n".join(lines).rstrip() + "\n"


def main(root: Path) -> None:
    """Write every made page below *root*."""
    for place, content in pages().items():
        (root / place).parent.mkdir(parents=True, exist_ok=True)
        (root / place).write_text(content, encoding="utf-8")


if __name__ == "__main__":
    main(Path.cwd())
