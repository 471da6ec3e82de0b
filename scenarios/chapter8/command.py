"""Chapter 8 on many references: the sudden CG shift in every mode, classical laws included.

``python -m scenarios.chapter8`` flies scenarios/cg_shift.toml over MAVLink and writes results/chapter8.json.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

import click
import msgspec

from scenarios.cli import INTERRUPTED, console, default_jobs, fly_scenario
from scenarios.references import with_count
from scenarios.report import scores_by_mode, write_report
from scenarios.schema import MODES, PEERS, find, load_scenario
from scenarios.score import Score
from scenarios.screen import print_table
from scenarios.summary import BASELINE, Row, Scores, change, changes, summarise
from task.files import find_population, make_folder
from task.results import FOLDER, Claim, Result, Table, write

SCENARIO = "cg_shift"
FLOWN_LAWS = ("pid", "indi", "indi-rls-signfree", "indi-rls-protected")
"""The peers of the stored table."""
WORSE = 2.0
"""A flight counts as made worse when its nMAE grows by more than this [%]."""


def summary_table(rows: Sequence[Row], scores: Scores) -> Table:
    """Return one row for each mode: means, worst cases, paired change against no adaptation."""
    columns = [
        "mode", "mean nMAE %", "worst nMAE %", "mean change %", "median change %", "worst change %",
        "flights > 2 % worse", "nMAE after the fault %", "Sm rad Hz", "largest step deg", "switches", "lost",
    ]  # fmt: skip
    body = []
    for row in rows:
        paired = changes(scores, row.mode)
        body.append(
            [
                row.mode, _short(row.nmae), _short(row.worst), _short(row.change),
                _short(statistics.median(paired) if paired else None), _short(row.worst_change),
                sum(value > WORSE for value in paired) if paired else None, _short(row.after),
                _short(row.smoothness), _short(row.step), row.switches, row.lost,
            ]
        )  # fmt: skip
    return Table(title="By mode, over all references", columns=columns, rows=body)


def reference_table(scores: Scores) -> Table:
    """Return the nMAE of every flight [%], one row for each reference."""
    names = list(next(iter(scores.values())))
    body = [[name, *(_cell(by_reference[name]) for by_reference in scores.values())] for name in names]
    return Table(title="nMAE [%] of every flight", columns=["reference", *scores], rows=body)


def _cell(score: Score) -> float | str | None:
    return _short(score.nmae) if score.survived else f"lost at {score.lost_at:.1f} s"


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.5g}")


def claims(rows: Sequence[Row], scores: Scores) -> list[Claim]:
    """Return what chapter 8 says of hard and soft switching, held against what was flown."""
    found = []
    by_mode = {row.mode: row for row in rows}
    if (none := by_mode.get(BASELINE)) is not None:
        found.append(Claim(claim="none: mean nMAE", value=_short(none.nmae), unit="%"))
    for mode, target in (
        ("thesis-soft", 20.0),
        ("thesis-hard", 0.0),
        ("understudy-soft", 0.0),
        ("understudy-hard", 0.0),
    ):
        if mode in by_mode and (value := by_mode[mode].change) is not None:
            words = f"more than {target:g} % lower (chapter 8, one reference)" if target else "lower"
            found.append(
                Claim(
                    claim=f"{mode}: mean change of nMAE",
                    value=_short(value),
                    unit="%",
                    target=words,
                    holds=value < -target,
                )
            )
    for preset in ("thesis", "understudy"):
        hard, soft = (scores.get(f"{preset}-{kind}") for kind in ("hard", "soft"))
        if hard is not None and soft is not None:
            value = _mean_change(soft, hard)
            found.append(
                Claim(
                    claim=f"{preset}: mean change of nMAE, soft against hard", value=_short(value), unit="%",
                    target="lower (chapter 8)" if preset == "thesis" else "",
                    holds=(value is not None and value < 0.0) if preset == "thesis" else None,
                )
            )  # fmt: skip
    return found


def _mean_change(scores: Mapping[str, Score], baseline: Mapping[str, Score]) -> float | None:
    paired = [value for name, score in scores.items() if (value := change(score, baseline[name])) is not None]
    return statistics.fmean(paired) if paired else None


def measured(scores: Scores, population: str, seeds: Sequence[int], seconds: float, command: str) -> Result:
    """Return the result file of flown references."""
    rows = summarise(scores)
    lost = {row.mode: row.lost for row in rows if row.lost}
    notes = [
        f"Population {population}; 100 s in lockstep over MAVLink, ideal sensors, still air, evaluation references; "
        "the centre of gravity moves 0.25 m aft at 20 s. The same references in every mode.",
        "A change is that of nMAE against no adaptation on the same reference; negative is better. A flight that was "
        "lost has no nMAE and no change.",
        "The classical laws are peers, not members of the cast: where one of them tracks better, it does.",
        "The aircraft and the population are ours, not the thesis's; its figure 8.2 shows one reference.",
    ]
    if lost:
        notes.append("Lost flights: " + ", ".join(f"{count} in {mode}" for mode, count in lost.items()) + ".")
    return Result(
        title=f"Chapter 8: a sudden shift of the centre of gravity, cast {population}",
        command=command,
        seconds=round(seconds, 1),
        runs=sum(row.flights for row in rows),
        seeds=list(seeds),
        claims=claims(rows, scores),
        tables=[summary_table(rows, scores), reference_table(scores)],
        notes=notes,
    )


@click.command()
@click.option("--references", "count", type=click.IntRange(min=1), default=12, show_default=True,
              help="How many references are flown in every mode.")  # fmt: skip
@click.option("--population", help="Folder of the cast, or its name under populations/.  [default: the scenario's]")
@click.option("--out", type=Path, help="Where the flights go.  [default: flights/NAME]")
@click.option("--results", type=Path, default=FOLDER, show_default=True, help="Where NAME.json goes.")
@click.option("--jobs", type=click.IntRange(min=1, max=64), help="Flights side by side.  [default: 2]")
@click.option("--fresh", is_flag=True, help="Fly everything again.")
def main(count: int, population: str | None, out: Path | None, results: Path, jobs: int | None, fresh: bool) -> None:
    """Fly the sudden CG shift on many references in all modes; write results/NAME.json.

    NAME is chapter8, with another cast than the scenario's chapter8_CAST.
    """
    path = find(SCENARIO)
    scenario = load_scenario(path)
    scenario = msgspec.structs.replace(scenario, references=with_count(scenario.references, count))
    cast = find_population(population or scenario.population)
    name = "chapter8" if cast.name == scenario.population else f"chapter8_{cast.name}"
    out = out or Path("flights") / name
    make_folder(results)
    screen = console()
    try:
        flown = fly_scenario(
            scenario,
            path.parent,
            [*MODES.values(), *(PEERS[law] for law in FLOWN_LAWS)],
            cast,
            out,
            False,
            jobs,
            fresh,
            screen,
        )
    except KeyboardInterrupt:
        click.echo(f"understudy: stopped; what was flown is kept in {out}", err=True)
        raise SystemExit(INTERRUPTED) from None
    scores = scores_by_mode(flown)
    print_table(screen, scenario.title, summarise(scores))
    # Of the flights themselves, whenever they were flown: a resumed run took no less.
    spent = sum(result.seconds for result in flown) / (jobs or default_jobs(realtime=False))
    command = f"make chapter8 POPULATION=populations/{cast.name} ARGS='--references {count}'"
    file = write(name, measured(scores, cast.name, scenario.references.drawn(), spent, command), results)
    report = write_report(scenario, flown, out)
    screen.print(f"\n{file}\nReport: {report}")
