"""``vtrack-batch simulate``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command(
    "simulate", short_help="Make traffic with known truth: truth tables, rendered frames, a survey file ready to run."
)
@click.argument("scenario_yaml", type=click.Path(path_type=Path))
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--workers", type=click.IntRange(1), default=1, help="Processes that render frames.")
@options.as_json
@options.quiet
@options.verbose
def command(scenario_yaml: Path, out: Path, workers: int, as_json: bool, quiet: bool, verbose: bool) -> None:
    """\b
    Example:
      vtrack-batch simulate configs/scenario-crossing.yaml demo
      vtrack-batch run demo/survey.yaml

    Make traffic with known truth: truth tables, rendered frames, a survey file ready to run.
    """
    from vtrack_batch.config.load import load_params
    from vtrack_batch.simulation.params import Scenario
    from vtrack_batch.simulation.write import simulate

    made = simulate(load_params(scenario_yaml, Scenario), out, workers=workers, base=scenario_yaml.parent)
    if not quiet:
        options.answer(made, "\n".join(f"{name}: {value}" for name, value in made.items()), as_json=as_json)
