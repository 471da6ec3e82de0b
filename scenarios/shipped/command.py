"""Every scenario of this package in its own modes: the figures and pictures of single flights.

``python -m scenarios.shipped`` flies them over MAVLink and writes results/scenarios.json.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import click
from rich.markup import escape

from scenarios.campaign.report import short
from scenarios.cli import INTERRUPTED, chosen_modes, console, default_jobs, fly_scenario
from scenarios.outputs import copy
from scenarios.report import scores_by_mode, write_report
from scenarios.schema import Scenario, available, load_scenario
from scenarios.screen import print_table
from scenarios.summary import BASELINE, Row, summarise
from task.files import make_folder
from task.results import FOLDER, Claim, Result, Table, write

NAME = "scenarios"
"""Of the result file."""
OURS = ("ensemble", "understudy-soft")
"""Of these modes, the first that a scenario has is what its claim is about."""
WORSE = 2.0
"""An adaptation does harm when nMAE grows by more than this against no adaptation [%]."""
PICTURED = (
    "cg_beyond_neutral", "crossed_controls", "jammed_aileron", "late_commands", "reversed_at_limit",
    "reversed_elevator",
)  # fmt: skip
"""Scenarios of which README and docs show the picture."""


class Flown(NamedTuple):
    """One scenario that was flown."""

    scenario: Scenario
    rows: list[Row]


def table(name: str, flown: Flown) -> Table:
    """Return one row for each mode of a scenario."""
    columns = [
        "mode", "nMAE %", "change against none %", "theta %", "phi %", "beta %", "Sm rad Hz", "largest step deg",
        "changes of the cast", "lost", "lost at s",
    ]  # fmt: skip
    body = [
        [
            r.mode, *(short(v) for v in (r.nmae, r.change, r.theta, r.phi, r.beta, r.smoothness, r.step)),
            r.switches, r.lost, short(r.lost_at),
        ]
        for r in flown.rows
    ]  # fmt: skip
    return Table(title=f"{name}: {flown.scenario.title}", columns=columns, rows=body)


def claims(name: str, flown: Flown) -> list[Claim]:
    """Return what the scenario is to show: that adaptation keeps the aircraft, and does no harm where none is lost."""
    rows = {row.mode: row for row in flown.rows}
    mode = next((m for m in OURS if m in rows), None)
    if mode is None:
        return []
    ours, none = rows[mode], rows.get(BASELINE)
    others = [row.mode for row in flown.rows if row.lost and row.mode != mode]
    words = f"{name}, {mode}: nMAE" + f" (lost: {', '.join(others)})" * bool(others)
    if ours.lost:
        return [Claim(claim=words, value="lost", target="not lost", holds=False)]
    found = [Claim(claim=words, value=short(ours.nmae), unit="%", target="not lost", holds=True)]
    if none is not None and ours.change is not None:
        found.append(
            Claim(
                claim=f"{name}, {mode}: change of nMAE against no adaptation", value=short(ours.change), unit="%",
                target=f"<= {WORSE:g}", holds=ours.change <= WORSE,
            )
        )  # fmt: skip
    return found


def measured(flown: Mapping[str, Flown], seconds: float, command: str) -> Result:
    """Return the result file of all scenarios."""
    return Result(
        title="Every shipped scenario in its own modes",
        command=command,
        seconds=round(seconds, 1),
        runs=sum(row.flights for one in flown.values() for row in one.rows),
        seeds=[],
        claims=[claim for name, one in flown.items() for claim in claims(name, one)],
        tables=[table(name, one) for name, one in flown.items()],
        notes=[
            "One flight of each mode, in lockstep over MAVLink, as `understudy fly NAME` flies it: examples, not "
            "statistics. nMAE is that of the whole flight, before the fault too; a lost flight has none.",
            "Seeds, references and faults are in each scenario's file.",
        ],
    )


@click.command()
@click.option("--scenario", "names", multiple=True, type=click.Choice(list(available())), metavar="NAME",
              help="Only this one; may be repeated.  [default: all]")  # fmt: skip
@click.option("--out", type=Path, default=Path("flights"), show_default=True, help="Where the flights go.")
@click.option("--results", type=Path, default=FOLDER, show_default=True, help=f"Where {NAME}.json goes.")
@click.option("--figures", type=Path, help=f"Copy the pictures of {', '.join(PICTURED)} here.")
@click.option("--jobs", type=click.IntRange(min=1, max=64), help="Flights side by side.  [default: 2]")
@click.option("--fresh", is_flag=True, help="Fly everything again, also what was flown before from the same inputs.")
def main(names: tuple[str, ...], out: Path, results: Path, figures: Path | None, jobs: int | None, fresh: bool) -> None:
    """Fly every scenario of --list in its own modes; write results/scenarios.json."""
    known, screen, spent = available(), console(), 0.0
    flown: dict[str, Flown] = {}
    for folder in (results, *([figures] if figures else [])):
        make_folder(folder)
    for name in names or known:
        scenario = load_scenario(known[name])
        modes = chosen_modes(None, scenario.modes)
        screen.print(f"[bold]{name}: {escape(scenario.title)}[/]")
        try:
            done = fly_scenario(
                scenario, known[name].parent, modes, scenario.population, out / name, False, jobs, fresh, screen
            )
        except KeyboardInterrupt:
            click.echo(f"understudy: stopped; what was flown is kept in {out}, the same command goes on", err=True)
            raise SystemExit(INTERRUPTED) from None
        flown[name] = Flown(scenario, summarise(scores_by_mode(done)))
        spent += sum(result.seconds for result in done)
        print_table(screen, scenario.title, flown[name].rows)
        write_report(scenario, done, out / name)
        if figures is not None and name in PICTURED:
            copy(out / name / "figures" / "comparison.png", figures / f"{name}.png")
    command = "python -m scenarios.shipped" + "".join(f" --scenario {name}" for name in names)
    file = write(NAME, measured(flown, spent / (jobs or default_jobs(realtime=False)), command), results)
    screen.print(f"\n{file}")
