"""``understudy export``: a trained run becomes a population that the runtime flies."""

from __future__ import annotations

from pathlib import Path

import click

from export.folder import check_place, write_population
from export.gains import with_gains
from export.golden import golden_actions
from export.mirrors import with_mirrors
from export.population import TRAINING_RECORDS, load_run
from export.prior import PriorSettings, model_prior
from export.rates import RateSettings, rate_model
from export.screening import ScreeningSettings, annotated, fit, flights, screen
from export.study.campaign import STORE
from export.study.show import flights_progress
from task.config import load_toml
from task.errors import UserError
from understudy import stopping


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
    "--screening",
    "screening_file",
    type=click.Path(path_type=Path),
    help="TOML of export.screening.ScreeningSettings: references and constraints.",
)
@click.option("--no-screening", is_flag=True, help="Export without flying the members first.")
@click.option("--only-fit", is_flag=True, help="Leave out members that keep the safety constraints in no case.")
@click.option(
    "--mirrors", is_flag=True, help="Add the champion with reversed commands, seven members, for reversed surfaces."
)
@click.option(
    "--gains", is_flag=True, help="Add the champion with stronger and weaker answers to sideslip, rates and errors."
)
@stopping("the population is as it was, flights that were screened are kept; the same command goes on")
def export(
    run: Path,
    population: Path,
    prior_file: Path | None,
    screening_file: Path | None,
    no_screening: bool,
    only_fit: bool,
    mirrors: bool,
    gains: bool,
) -> None:
    """Export the trained population in RUN to the folder POPULATION, whose name becomes the population's.

    Writes ONNX graphs, parameters, the incremental model's prior, the rate model, a model card with what every
    member was seen to do in the thesis's ten cases and with reversed surfaces, and a manifest with hashes and
    golden samples.
    """
    screened = (
        load_toml(screening_file, ScreeningSettings, "screening settings") if screening_file else ScreeningSettings()
    )
    settings = load_toml(prior_file, PriorSettings, "prior settings") if prior_file else PriorSettings()
    if no_screening and only_fit:
        raise UserError("--only-fit: who is fit is what the screening says; export without --no-screening")
    check_place(population)
    trained = load_run(run)
    if mirrors:
        trained = with_mirrors(trained, str(run))
    if gains:
        trained = with_gains(trained, str(run))
    golden_actions(trained)  # members that single precision does not fly are refused before the flights, not after
    members, parameters = trained.parameters.shape
    click.echo(f"{run}: {members} members of {parameters} parameters, champion {trained.description.champion}")
    click.echo(
        f"model prior: {settings.flights} flights of {settings.duration:g} s at {len(settings.conditions)} trim(s)"
    )
    prior = model_prior(settings)
    flown = RateSettings()
    click.echo(f"rate model: {flown.flights} flights of {flown.duration:g} s at {len(flown.conditions)} trims")
    rates = rate_model(flown)
    screening = None
    if not no_screening:
        with flights_progress(flights(trained, screened), "screening flights") as progress:
            screening = screen(trained, screened, run / STORE, progress)
        left_out: dict[str, str] = {}
        if only_fit:
            trained, screening, left_out = fit(trained, screening)
            click.echo(f"left out: {', '.join(left_out) or 'nobody'}")
        trained = annotated(trained, screening, left_out)
        click.echo(f"champion {trained.description.champion}: {screening.verdict(trained.champion)}")
    click.echo("graphs, golden samples, model card, hashes")
    records = {name: run / name for name in TRAINING_RECORDS if (run / name).exists()}
    manifest = write_population(trained, prior, population, records, rates=rates, screening=screening)
    size = sum((population / name).stat().st_size for name in manifest.files) / 1e6
    click.echo(f"{population}: {len(manifest.files)} files, {size:.1f} MB, verified against its golden samples")
