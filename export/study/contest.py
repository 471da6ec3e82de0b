"""Who flies for table 7.1, a run's members and TD3 actors beside them, and their scores in each case."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from export.population import Population, load_run
from export.study.campaign import ABREAST, STORE, Progress, Trials, fly_once, join
from export.study.cases import CASES, Case, CaseFleet
from export.training.evaluate import Scores
from task.errors import UserError

PART = 10
"""References whose flights are kept together."""
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


class Pilot(NamedTuple):
    """One member of a run."""

    run: Path
    population: Population
    row: int

    def fly(self, fleet: CaseFleet, case: Case, trials: Trials, progress: Progress) -> Scores:
        """Return the member's scores (1, E) in a case."""
        network, parameters = self.population.network, self.population.parameters[self.row : self.row + 1]
        parts = trials.parts(PART)
        return join([fly_once(self.run / STORE, fleet, case, network, parameters, p, progress) for p in parts], axis=1)

    @property
    def validation(self) -> float:
        """Return the nMAE [%] by which the run judged it, infinite where it lost a flight or was not judged."""
        scores = self.population.description.members[self.row].scores
        return float("inf") if scores.get("validation_lost") else scores.get("validation_nmae", float("inf"))


class Contest(NamedTuple):
    """Who flies."""

    run: Path
    population: Population
    rivals: dict[str, Pilot]
    """TD3 actors: of the runs given, then the one within the population."""
    alone: bool
    """Runs of TD3 alone were given."""

    @property
    def td3(self) -> Pilot:
        """Return the TD3 actor of the table: of the given runs the best by its own validation, else the one within."""
        given = [pilot for pilot in self.rivals.values() if pilot.run != self.run or not self.alone]
        return min(given, key=lambda pilot: pilot.validation)

    @property
    def genetic(self) -> list[int]:
        """Return the rows of the genetic actors."""
        return [i for i, name in enumerate(names(self.population)) if name != TD3]


def names(population: Population) -> list[str]:
    """Return the members' names."""
    return [member.name for member in population.description.members]


def contest(run: Path, td3_runs: tuple[Path, ...]) -> Contest:
    """Read the runs; raise UserError when there is no population, or no TD3 actor among them."""
    population = load_run(run)
    if all(name == TD3 for name in names(population)):
        raise UserError(f"{run}: no genetic actors; expected a population, and runs of TD3 alone with --td3")
    if run in td3_runs:
        raise UserError(f"--td3 {run}: is the population itself, whose TD3 actor flies anyway; name a run of TD3 alone")
    rivals = {}
    for path in td3_runs:
        rival = load_run(path)
        rivals[str(path)] = Pilot(path, rival, rival.champion)
    if TD3 in names(population):
        rivals[f"within {run.name}"] = Pilot(run, population, names(population).index(TD3))
    if not rivals:
        raise UserError(f"{run}: no member '{TD3}'; name a run of TD3 alone with --td3")
    return Contest(run, population, rivals, bool(td3_runs))


def flights(who: Contest, cases: tuple[Case, ...], trials: Trials, few: Trials) -> int:
    """Return how many flights the table takes when everything is flown."""
    return len(cases) * (3 * trials.total + len(who.population.parameters) * few.total) + len(who.rivals) * trials.total


def fly_contest(
    who: Contest, cases: tuple[Case, ...], trials: Trials, few: Trials, progress: Progress
) -> tuple[dict[str, CaseScores], dict[str, Scores]]:
    """Fly champion, TD3 actor and re-picked members on ``trials``, the population on ``few`` of them.

    Return their scores by case, and the nominal scores of every TD3 actor.
    """
    fleet, population = CaseFleet(), who.population
    champion = Pilot(who.run, population, population.champion)
    # Blocks of all members, as the screening has them: what it flew is not flown again.
    blocks = [population.parameters[i : i + ABREAST] for i in range(0, len(population.parameters), ABREAST)]
    scores = {}
    for case in cases:
        everyone = join(
            [fly_once(who.run / STORE, fleet, case, population.network, b, few, progress) for b in blocks], axis=0
        )
        flown = Scores(*(field[who.genetic] for field in everyone))
        ranking = flown.ranking()
        survivors = np.isfinite(ranking).any()
        repicked = who.genetic[int(np.argmin(ranking if survivors else flown.nmae.mean(axis=1)))]
        scores[case.name] = CaseScores(
            champion=champion.fly(fleet, case, trials, progress),
            repicked=champion._replace(row=repicked).fly(fleet, case, trials, progress),
            repicked_name=names(population)[repicked],
            td3=who.td3.fly(fleet, case, trials, progress),
            population=flown,
            unseen=list(range(few.total if few.duration == trials.duration else 0, trials.total)),
        )
    rivals = {name: pilot.fly(fleet, CASES[0], trials, progress) for name, pilot in who.rivals.items()}
    return scores, rivals
