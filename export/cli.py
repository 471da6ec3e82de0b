"""``understudy export``: a trained run becomes a population that the runtime flies."""

from __future__ import annotations

from pathlib import Path

import click

from export.folder import write_population
from export.mirrors import with_mirrors
from export.population import TRAINING_RECORDS, load_run
from export.prior import PriorSettings, model_prior
from export.rates import RateSettings, rate_model
from task.config import load_toml


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.argument("population", type=click.Path(path_type=Path))
@click.option(
    "--prior",
    "prior_file",
    type=click.Path(path_type=Path),
    help="TOML of export.prior.PriorSettings: trims, flights and excitation behind the model prior.",
)
@click.option(
    "--mirrors", is_flag=True, help="Add the champion with reversed commands, seven members, for reversed surfaces."
)
def export(run: Path, population: Path, prior_file: Path | None, mirrors: bool) -> None:
    """Export the trained population in RUN to the folder POPULATION, whose name becomes the population's.

    Writes ONNX graphs, parameters, the incremental model's prior, the rate model and a manifest with
    hashes and golden samples.
    """
    settings = load_toml(prior_file, PriorSettings, "prior settings") if prior_file else PriorSettings()
    trained = load_run(run)
    if mirrors:
        trained = with_mirrors(trained, str(run))
    members, parameters = trained.parameters.shape
    click.echo(f"{run}: {members} members of {parameters} parameters, champion {trained.description.champion}")
    click.echo(
        f"model prior: {settings.flights} flights of {settings.duration:g} s at {len(settings.conditions)} trim(s)"
    )
    prior = model_prior(settings)
    flown = RateSettings()
    click.echo(f"rate model: {flown.flights} flights of {flown.duration:g} s at {len(flown.conditions)} trims")
    rates = rate_model(flown)
    click.echo("graphs, golden samples, hashes")
    records = {name: run / name for name in TRAINING_RECORDS if (run / name).exists()}
    manifest = write_population(trained, prior, population, records, rates=rates)
    size = sum((population / name).stat().st_size for name in manifest.files) / 1e6
    click.echo(f"{population}: {len(manifest.files)} files, {size:.1f} MB, verified against its golden samples")
