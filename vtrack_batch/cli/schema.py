"""``vtrack-batch schema``."""

from __future__ import annotations

import click

from vtrack_batch.cli import options


@click.command(
    "schema", short_help="Print the columns of all tables, of one table, or the JSON schema of the survey file."
)
@click.argument("what", default="tables")
@options.as_json
@options.quiet
@options.verbose
def command(what: str, as_json: bool, quiet: bool, verbose: bool) -> None:
    """\b
    Examples:
      vtrack-batch schema
      vtrack-batch schema od_pairs
      vtrack-batch schema config > survey.schema.json

    Print the columns of all tables, of one table, or the JSON schema of the survey file.
    """
    if what == "config":
        from vtrack_batch.config.example import schema_json

        click.echo(schema_json(), nl=False)
        return
    from dataclasses import asdict

    from vtrack_batch.model.describe import table_text
    from vtrack_batch.model.tables import TABLES
    from vtrack_batch.storage.results import only_table

    names = list(TABLES) if what == "tables" else [what]
    for name in names:
        only_table(name)
    text = "\n".join(table_text(TABLES[name]) for name in names)
    options.answer({name: asdict(TABLES[name]) for name in names}, text.rstrip(), as_json=as_json)
