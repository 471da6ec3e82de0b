"""``understudy fly`` and ``understudy results``."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

import click
import msgspec
from rich.console import Console
from rich.markup import escape

from scenarios import schema
from scenarios.outputs import claimed, copy, prepare_file
from scenarios.processes import StoppedError, ended_as_by_ctrl_c
from scenarios.references import build, with_count
from scenarios.report import scores_by_mode, write_report
from scenarios.run import Result, fly_all, plan
from scenarios.screen import LEGEND, Board, print_table
from scenarios.summary import summarise
from task.errors import UserError
from task.files import find_population

INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def console() -> Console:
    """Return the terminal; where there is none, lines wide enough for the table."""
    screen = Console(highlight=False)
    return screen if screen.is_terminal else Console(highlight=False, width=160)


def chosen_modes(text: str | None, default: Sequence[str]) -> list[schema.Mode]:
    """Return the modes of a comma-separated list, or the default ones. Raises UserError."""
    names = list(default) if text is None else [name.strip() for name in text.split(",")]
    modes = []
    for name in dict.fromkeys(names):
        mode = schema.mode_named(name)
        if mode is None:
            raise UserError(f"--modes {text}: unknown mode {name!r}; choose from {schema.KNOWN}")
        modes.append(mode)
    return modes


def default_jobs(realtime: bool) -> int:
    """Return how many flights go side by side: a core each, two at most; in real time one."""
    return 1 if realtime else min(2, os.cpu_count() or 1)


def fly_scenario(
    scenario: schema.Scenario,
    folder: Path,
    modes: Sequence[schema.Mode],
    population: str | Path,
    out: Path,
    realtime: bool = False,
    jobs: int | None = None,
    fresh: bool = False,
    screen: Console | None = None,
) -> list[Result]:
    """Fly a scenario in ``modes`` and return the results; progress goes to ``screen``.

    ``folder`` is where a relative reference file lies. Raises UserError, also while another command flies into
    ``out``, and KeyboardInterrupt after Ctrl-C, SIGTERM or SIGHUP with every process ended.
    """
    cast = find_population(population)
    flights = plan(scenario.flight, build(scenario, folder), modes, cast, out, realtime)
    try:
        with ended_as_by_ctrl_c(), claimed(out), Board(screen or console(), len(flights)) as board:
            return fly_all(flights, jobs or default_jobs(realtime), fresh, board)
    except StoppedError:
        raise KeyboardInterrupt from None


def _list(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
    """Print the scenarios and leave."""
    if not value or ctx.resilient_parsing:
        return
    for name, path in schema.available().items():
        click.echo(f"{name:<24} {schema.load_scenario(path).title}")
    ctx.exit()


@click.command()
@click.argument("scenario")
@click.option("--list", is_flag=True, is_eager=True, expose_value=False, callback=_list, help="List the scenarios.")
@click.option("--modes", help=f"Comma-separated, of: {schema.KNOWN}.  [default: the scenario's]")
@click.option("--references", "count", type=click.IntRange(min=1, max=1000),
              help="Fly this many random references in place of the scenario's.")  # fmt: skip
@click.option("--population", help="Folder of the cast, or its name under populations/.  [default: the scenario's]")
@click.option("--out", type=Path, help="Where flights and report go.  [default: flights/SCENARIO]")
@click.option("--realtime", is_flag=True, help="100 Hz of wall clock; without it, lockstep.")
@click.option("--jobs", type=click.IntRange(min=1, max=64),
              help="Flights side by side.  [default: 2; in real time 1]")  # fmt: skip
@click.option("--fresh", is_flag=True, help="Fly everything again, also what was flown before from the same inputs.")
@click.option("--picture", type=Path, help="Also save the picture of the modes side by side (PNG) here.")
def fly(
    scenario: str,
    modes: str | None,
    count: int | None,
    population: str | None,
    out: Path | None,
    realtime: bool,
    jobs: int | None,
    fresh: bool,
    picture: Path | None,
) -> None:
    """Fly SCENARIO, a .toml file or a name from --list, over MAVLink; print a table and write an HTML report.

    A mode is a way of flying it: no adaptation (none), a preset of the adaptation, or a classical law alone. All modes
    fly the same references with the same faults, sensors and air. What was flown before is not flown again.
    """
    began = time.monotonic()
    path = schema.find(scenario)
    script = schema.load_scenario(path)
    if count is not None:
        script = msgspec.structs.replace(script, references=with_count(script.references, count))
    chosen = chosen_modes(modes, script.modes)
    where = out or Path("flights") / path.stem
    cast = find_population(population or script.population)
    for wanted in (where / "report.html", where / "figures" / "comparison.png", picture):
        if wanted is not None:
            prepare_file(wanted)
    screen = console()
    screen.print(f"[bold]{escape(script.title)}[/]")
    try:
        results = fly_scenario(script, path.parent, chosen, cast, where, realtime, jobs, fresh, screen)
    except KeyboardInterrupt:
        click.echo(f"understudy: stopped; what was flown is kept in {where}", err=True)
        raise SystemExit(INTERRUPTED) from None
    print_table(screen, script.title, summarise(scores_by_mode(results)))
    screen.print(f"[dim]{LEGEND}[/]", highlight=False)
    report = write_report(script, results, where)
    if picture is not None:
        copy(where / "figures" / "comparison.png", picture)
    screen.print(f"\n[dim]{len(results)} flights in {time.monotonic() - began:.0f} s.[/] Report: {escape(str(report))}")


@click.command()
@click.option("--folder", type=Path, default=Path("results"), show_default=True, help="Where the figures are.")
@click.option("--out", type=Path, default=Path("docs/results.md"), show_default=True, help="Where the page goes.")
def results(folder: Path, out: Path) -> None:
    """Render docs/results.md from results/*.json."""
    from scenarios.results_page import write_page

    count = write_page(folder, out)
    click.echo(f"{out}: {count} results")
