"""``understudy aircraft``: identify, build and validate the Citation."""

from __future__ import annotations

from pathlib import Path

import click

from task.results import FOLDER as RESULTS


@click.group()
def aircraft() -> None:
    """Identify, build and validate the Citation."""


@aircraft.command()
@click.option("--recordings", type=click.Path(path_type=Path), help="Folder of <case>/<manoeuvre>.npz.")
@click.option("--out", type=click.Path(path_type=Path), help="Coefficients file to write; the package's by default.")
def identify(recordings: Path | None, out: Path | None) -> None:
    """Rebuild coefficients.json from recordings."""
    from sim_bridge.aircraft import coefficients, identify, structure
    from sim_bridge.aircraft import recordings as records
    from task.config import to_json

    folder = recordings or records.FOLDER
    unknowns = structure.aerodynamics()
    evidence = identify.gather_all(unknowns, folder)
    found = identify.identify(evidence, unknowns, records.load_case("ice", folder))
    path = out or coefficients.COEFFICIENTS
    path.write_bytes(to_json(found))
    for axis, share in identify.unexplained(evidence, found).items():
        click.echo(f"{axis}: {share:.4f} % of the variance is left unexplained")
    click.echo(f"{path}: {len(evidence)} recordings")


@aircraft.command()
def build() -> None:
    """Write the JSBSim model from coefficients.json."""
    from sim_bridge.aircraft import build, coefficients

    click.echo(build.build(coefficients.load()))


@aircraft.command()
@click.option("--recordings", type=click.Path(path_type=Path), help="Folder of <case>/<manoeuvre>.npz.")
def validate(recordings: Path | None) -> None:
    """Compare the aircraft with its reference; write results/aircraft.json and the page's tables."""
    from sim_bridge.aircraft import page
    from sim_bridge.aircraft import recordings as records
    from sim_bridge.aircraft.show import show
    from sim_bridge.aircraft.validate import validate
    from task.results import write

    result = validate(recordings or records.FOLDER, lambda line: click.echo(line, err=True))
    for line in show(result):
        click.echo(line)
    click.echo(write("aircraft", result, RESULTS))
    if page.PAGE.exists():
        page.PAGE.write_text(page.replace(page.PAGE.read_text(), result))
        click.echo(page.PAGE)
