"""The data dictionary and the flags as text, for the command line and the reference pages."""

from __future__ import annotations

from vtrack_batch.model.flags import DetectionFlag, TrajectoryFlag, legend
from vtrack_batch.model.tables import TABLES, Table


def table_text(table: Table) -> str:
    """Return *table* as plain text: one line a column."""
    wide = max(len(column.name) for column in table.columns)
    lines = [f"{table.name}: {table.meaning}", f"  key: {', '.join(table.key)}"]
    for column in table.columns:
        kind = column.type + ("?" if column.nullable else "")
        unit = "" if column.unit == "-" else f" [{column.unit}]"
        lines.append(f"  {column.name:{wide}}  {kind:10}{unit} {column.meaning}")
    return "\n".join(lines) + "\n"


def tables_page() -> str:
    """Return the reference page of all tables and flags, in Markdown."""
    lines = [
        "# Tables",
        "",
        "Made by `make docs` from `vtrack_batch/model/tables.py`. Missing = null; `?` marks columns that may be.",
        "Times are UTC; intervals (`_lo`, `_hi`) are 95 %. Every table but `quarantine` is divided by `date`, the",
        "local date in `survey.time_zone`.",
        "",
    ]
    for table in TABLES.values():
        lines += [f"## {table.name}", "", f"{table.meaning} Key: {', '.join(f'`{name}`' for name in table.key)}.", ""]
        lines += ["| column | type | unit | meaning |", "|---|---|---|---|"]
        for column in table.columns:
            kind = column.type + ("?" if column.nullable else "")
            lines.append(f"| `{column.name}` | {kind} | {column.unit} | {column.meaning} |")
        lines.append("")
    lines += ["## Flags", ""]
    for name, kind_of_flag in (("detections.flags", DetectionFlag), ("trajectories.flags", TrajectoryFlag)):
        lines += [f"`{name}` is a sum of bits:", "", "| bit | name | meaning |", "|---|---|---|"]
        lines += [f"| {flag.bit} | {flag.name} | {flag.meaning} |" for flag in legend(kind_of_flag)]
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"
