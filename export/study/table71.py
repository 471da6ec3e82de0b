"""Table 7.1: champion, population average and TD3 actor in the ten cases of table 2."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from export.population import Population, load_run
from export.study.campaign import SEEDS, STORE, Progress, Trials, fly_once, join
from export.study.cases import CASES, Case, CaseFleet, choose
from export.study.pictures import picture
from export.study.show import flights_progress, show
from export.study.tables71 import claims, draw, jammed_rudder, nmae_table, safety_table, significance_table, td3_table
from export.training.evaluate import DURATION, Scores
from task import results
from task.errors import UserError

BLOCK = 5
"""Members whose flights are kept together."""
TD3 = "td3"
"""Name of the gradient actor among a run's members."""


class CaseScores(NamedTuple):
    """What was flown in one case; every actor flew the same references."""

    champion: Scores
    """(1, E)."""
    repicked: Scores
    """(1, E) of the member that is best in this case by the population's flights."""
    repicked_name: str
    td3: Scores
    """(1, E) of the TD3 actor that trained alone, or within the population where no other is given."""
    population: Scores
    """(N, E') genetic actors, the TD3 actor that trains beside them left out."""
    unseen: list[int]
    """Which of the E references had no part in re-picking."""


class Contest(NamedTuple):
    """Who flies."""

    run: Path
    population: Population
    rivals: dict[str, Population]
    """Runs of TD3 alone, by name."""

    @property
    def td3(self) -> tuple[Path | None, Population, int]:
        """Return the TD3 actor of the table: of the given runs the best by its own validation, else the one within."""
        if not self.rivals:
            return None, self.population, names(self.population).index(TD3)
        best = min(self.rivals, key=lambda name: _validation(self.rivals[name]))
        return Path(best), self.rivals[best], self.rivals[best].champion


def names(population: Population) -> list[str]:
    """Return the members' names."""
    return [member.name for member in population.description.members]


def _validation(population: Population) -> float:
    scores = population.description.members[population.champion].scores
    lost = scores.get("validation_lost", 0.0)
    return float("inf") if lost else scores.get("validation_nmae", float("inf"))


def flights(cases: tuple[Case, ...], trials: Trials, few: Trials, contest: Contest) -> int:
    """Return how many flights the table takes when everything is flown."""
    genetic = sum(name != TD3 for name in names(contest.population))
    return len(cases) * (3 * trials.total + genetic * few.total)


def fly_contest(
    contest: Contest, cases: tuple[Case, ...], trials: Trials, few: Trials, progress: Progress
) -> dict[str, CaseScores]:
    """Fly champion, TD3 actor and re-picked members on ``trials``, the population on ``few`` of them."""
    fleet, population = CaseFleet(), contest.population
    store = contest.run / STORE
    genetic = [i for i, name in enumerate(names(population)) if name != TD3]
    home, rival, row = contest.td3
    scores = {}
    for case in cases:

        def one(i: int, of: Population = population, at: Path = store, case: Case = case) -> Scores:
            return fly_once(at, fleet, case, of.network, of.parameters[i : i + 1], trials, progress)

        blocks = [genetic[i : i + BLOCK] for i in range(0, len(genetic), BLOCK)]
        flown = join(
            [fly_once(store, fleet, case, population.network, population.parameters[b], few, progress) for b in blocks],
            axis=0,
        )
        ranking = flown.ranking()
        survivors = np.isfinite(ranking).any()
        repicked = genetic[int(np.argmin(ranking if survivors else flown.nmae.mean(axis=1)))]
        scores[case.name] = CaseScores(
            champion=one(population.champion),
            repicked=one(repicked),
            repicked_name=names(population)[repicked],
            td3=one(row, rival, store if home is None else home / STORE),
            population=flown,
            unseen=[e for e in range(trials.total) if e not in few.chosen],
        )
    return scores


def rivals_scores(contest: Contest, trials: Trials, progress: Progress) -> dict[str, Scores]:
    """Return the nominal scores of every TD3 actor: of the runs given and within the population."""
    fleet, population = CaseFleet(), contest.population
    found = {
        name: fly_once(
            Path(name) / STORE,
            fleet,
            CASES[0],
            rival.network,
            rival.parameters[rival.champion : rival.champion + 1],
            trials,
            progress,
        )
        for name, rival in contest.rivals.items()
    }
    if TD3 in names(population):
        i = names(population).index(TD3)
        found[f"within {contest.run.name}"] = fly_once(
            contest.run / STORE,
            fleet,
            CASES[0],
            population.network,
            population.parameters[i : i + 1],
            trials,
            progress,
        )
    return found


def _notes(contest: Contest, scores: Mapping[str, CaseScores], trials: Trials, few: Trials) -> list[str]:
    home = contest.td3[0]
    unseen = len(next(iter(scores.values())).unseen)
    part = f"the first {few.until:g} s of " if few.until else ""
    return [
        f"Champion {contest.population.description.champion}: picked once, by nominal validation references that are "
        "not among these. Champion and TD3 actor flew the same "
        f"{trials.total} references of {trials.duration:g} s ({trials.each} of each seed).",
        f"The population flew {part}{few.total} of them; the re-picked champion is the member with the lowest nMAE "
        f"there, and its figure is of the {unseen} others.",
        "TD3 actor: "
        + (f"trained alone ({home}), of the runs given the best by its validation." if home else "within the run."),
        "± is the standard deviation over references (champion, TD3), over members (average).",
        "nMAE by the definition of the published experiments (task.metrics), of the true state, over the flown part "
        "where a flight is lost.",
        "Lowest: significantly lower than both others by the thesis's t-test (p < 0.05); its thesis counterpart is "
        "what table 7.1 prints bold. The intervals are paired over references.",
        "The thesis flew its own plant (DASMAT) with its own references; its champion was probably re-picked per case.",
    ]


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--td3", "td3_runs", multiple=True, type=click.Path(path_type=Path), help="Runs of TD3 alone.")
@click.option("--cases", default=",".join(c.name for c in CASES), show_default=True)
@click.option("--references", type=click.IntRange(1), default=10, show_default=True, help=f"Of each of seeds {SEEDS}.")
@click.option("--population-references", type=click.IntRange(1), default=3, show_default=True, help="In all.")
@click.option("--population-seconds", type=click.FloatRange(1.0), help="Of those references.  [default: all]")
@click.option("--duration", type=click.FloatRange(1.0), default=DURATION, show_default=True, help="Of a flight [s].")
@click.option("--name", default="table71", show_default=True, help="Of the files in results/ and docs/img/.")
def table71(
    run: Path,
    td3_runs: tuple[Path, ...],
    cases: str,
    references: int,
    population_references: int,
    population_seconds: float | None,
    duration: float,
    name: str,
) -> None:
    """Fly the population in RUN through the ten cases. A stopped command goes on where it was."""
    began = time.perf_counter()
    chosen = choose(cases)
    trials = Trials(references, duration)
    few = trials._replace(first=population_references, until=population_seconds)
    if few.total < population_references:
        raise UserError(f"--population-references: expected at most {trials.total}, {references} of each seed")
    contest = Contest(run, load_run(run), {str(path): load_run(path) for path in td3_runs})
    if not td3_runs and TD3 not in names(contest.population):
        raise UserError(f"{run}: no member '{TD3}'; name a run of TD3 alone with --td3")
    with flights_progress(flights(chosen, trials, few, contest)) as progress:
        scores = fly_contest(contest, chosen, trials, few, progress)
        rivals = rivals_scores(contest, trials, progress)
    tables = [
        nmae_table(scores),
        significance_table(scores),
        safety_table(scores),
        *([jammed_rudder(scores["F6"])] if "F6" in scores else []),
        td3_table(rivals),
    ]
    arguments = "".join(f" --td3 {path}" for path in td3_runs) + f" --references {references}"
    arguments += f" --population-references {population_references} --name {name}"
    if population_seconds:
        arguments += f" --population-seconds {population_seconds:g}"
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
            notes=_notes(contest, scores, trials, few),
        ),
    )
    with picture(name) as figure:
        draw(figure, scores, run.name)
    show(tables)
