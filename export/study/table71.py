"""Table 7.1: champion, population average and TD3 actor in the ten cases of table 2."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

import click

from export.study.campaign import SEEDS, Trials
from export.study.cases import CASES, choose
from export.study.contest import CaseScores, Contest, contest, flights, fly_contest
from export.study.pictures import picture
from export.study.show import flights_progress, show
from export.study.tables71 import claims, draw, jammed_rudder, nmae_table, safety_table, significance_table, td3_table
from export.training.evaluate import DURATION
from task import results
from task.errors import UserError


def _notes(who: Contest, scores: Mapping[str, CaseScores], trials: Trials, few: Trials) -> list[str]:
    unseen = len(next(iter(scores.values())).unseen)
    own = few.duration != trials.duration
    part = (
        f"{few.total} references of {few.duration:g} s, steeper than these" if own else f"the first {few.total} of them"
    )
    return [
        f"Champion {who.population.description.champion}: picked once, by nominal validation references that are "
        "not among these. Champion and TD3 actor flew the same "
        f"{trials.total} references of {trials.duration:g} s, one from each seed in turn.",
        f"The population flew {part}; the re-picked champion is the member with the lowest nMAE there, and its "
        f"figure is of the {unseen} references that had no part in it.",
        "TD3 actor: "
        + (f"trained alone ({who.td3.run}), of the runs given the best by its validation." if who.alone else "within."),
        "± is the standard deviation over references (champion, TD3), over members (average).",
        "nMAE by the definition of the published experiments (task.metrics), of the true state, over the flown part "
        "where a flight is lost.",
        "Lowest: significantly lower than both others by the thesis's t-test (p < 0.05); its thesis counterpart is "
        "what table 7.1 prints bold. The intervals are paired over references.",
        "The time is that of the last start; flights kept from earlier ones are not in it.",
        "The thesis flew its own plant (DASMAT) with its own references; its champion was probably re-picked per case.",
    ]


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--td3", "td3_runs", multiple=True, type=click.Path(path_type=Path), help="Runs of TD3 alone.")
@click.option("--cases", default=",".join(c.name for c in CASES), show_default=True)
@click.option("--references", type=click.IntRange(1), default=30, show_default=True, help="In all.")
@click.option("--population-references", type=click.IntRange(1), default=3, show_default=True, help="In all.")
@click.option("--duration", type=click.FloatRange(1.0), default=DURATION, show_default=True, help="Of a flight [s].")
@click.option("--population-duration", type=click.FloatRange(1.0), help="Of the population's.  [default: --duration]")
@click.option("--name", default="table71", show_default=True, help="Of the files in results/ and docs/img/.")
def table71(
    run: Path,
    td3_runs: tuple[Path, ...],
    cases: str,
    references: int,
    population_references: int,
    duration: float,
    population_duration: float | None,
    name: str,
) -> None:
    """Fly the population in RUN through the ten cases. A stopped command goes on where it was."""
    began = time.perf_counter()
    chosen = choose(cases)
    trials = Trials(references, duration)
    few = Trials(population_references, population_duration or duration)
    if few.total > trials.total:
        raise UserError(f"--population-references: expected at most --references = {references}")
    who = contest(run, td3_runs)
    with flights_progress(flights(who, chosen, trials, few)) as progress:
        scores, rivals = fly_contest(who, chosen, trials, few, progress)
    tables = [
        nmae_table(scores),
        significance_table(scores),
        safety_table(scores),
        *([jammed_rudder(scores["F6"])] if "F6" in scores else []),
        td3_table(rivals),
    ]
    arguments = "".join(f" --td3 {path}" for path in td3_runs) + f" --references {references}"
    arguments += f" --population-references {population_references} --name {name}"
    if population_duration:
        arguments += f" --population-duration {population_duration:g}"
    if duration != DURATION:
        arguments += f" --duration {duration:g}"
    if len(chosen) < len(CASES):
        arguments += f" --cases {','.join(case.name for case in chosen)}"
    results.write(
        name,
        results.Result(
            title=f"Table 7.1: {run.name} in the thesis's ten cases",
            command=f"python -m export.study table71 {run}{arguments}",
            seconds=round(time.perf_counter() - began, 1),
            runs=trials.total,
            seeds=list(SEEDS),
            claims=claims(scores),
            tables=tables,
            notes=_notes(who, scores, trials, few),
        ),
    )
    with picture(name) as figure:
        draw(figure, scores, run.name)
    show(tables)
