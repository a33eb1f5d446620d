"""``vtrack-batch calibrate``."""

from __future__ import annotations

from pathlib import Path

import click

from vtrack_batch.cli import options


@click.command("calibrate", short_help="Choose the matcher's parameters on simulated traffic like the survey's.")
@options.survey_file
@click.option("--scenario", type=click.Path(path_type=Path), help="Place to simulate, as for `simulate`.")
@click.option("--interval-s", type=click.FloatRange(0.05, 60), help="Time between frames; else the archive's own.")
@click.option("--vehicles", type=click.FloatRange(1, 10000), help="Vehicles a frame; else as the survey's result has.")
@click.option("--pairs", type=click.IntRange(8, 1000), default=40, show_default=True, help="Pairs of images.")
@click.option("--train", type=click.Path(path_type=Path), help="Retrain the learned score; file of the new model.")
@options.as_json
@options.quiet
@options.verbose
def command(
    survey_yaml: Path,
    scenario: Path | None,
    interval_s: float | None,
    vehicles: float | None,
    pairs: int,
    train: Path | None,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """\b
    Example:
      vtrack-batch calibrate survey.yaml
      vtrack-batch calibrate survey.yaml --scenario my-junction.yaml --pairs 100
      vtrack-batch calibrate survey.yaml --pairs 200 --train site.json

    Choose the matcher's parameters on simulated traffic like the survey's: A, B, C of the paper's relaxation are swept,
    all methods are compared on traffic that was not chosen on, and lines for the survey file are printed. --train
    corrects the default method's learned score for such traffic too. Needs SUMO (extra `sim`), and to train LightGBM
    (extra `train`).
    """
    from vtrack_batch.config.load import load_params
    from vtrack_batch.pipeline.calibrate import calibrate
    from vtrack_batch.simulation.params import Scenario

    found = calibrate(
        options.load(survey_yaml),
        scenario=load_params(scenario, Scenario) if scenario else None,
        base=scenario.parent if scenario else Path(),
        interval_s=interval_s,
        vehicles=vehicles,
        pairs=pairs,
        train=train,
        tell=options.speaker(quiet),
    )
    options.answer(found.as_dict(), found.text(), as_json=as_json)
