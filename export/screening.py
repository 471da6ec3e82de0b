"""Every member before it is shipped: flown in all cases, held against safety constraints (thesis chapters 8.5 and 11).

Nobody is removed unless it is asked for: a member that loses every nominal flight may be the one that a broken
aircraft needs. What it does is said, in the manifest and in the model card. A population trained on the healthy
aircraft alone has no such specialists, and there who keeps the constraints in no case is of no use (:func:`fit`).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from export.population import Member, Population
from export.study.campaign import ABREAST, SEEDS, Trials, fly_once, join
from export.study.cases import CASES, NOMINAL_CASE, REVERSED, CaseFleet
from export.training.evaluate import Scores, attitude_nmae
from task.config import Settings
from task.errors import UserError

SCREENED = (*CASES, *REVERSED)
"""The thesis's cases, and each surface reversed: what a specialist may be for."""
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]


class ScreeningSettings(Settings, frozen=True):
    """What is flown, and what a member may do."""

    references: Annotated[int, Meta(ge=1)] = 1
    """Evaluation references of each case; one is a glance, for a verdict to rely on give more."""
    duration: Annotated[float, Meta(ge=1.0, le=600.0)] = 30.0
    """Length of a flight [s]; the gust of R3 lasts from 20 to 23 s."""
    unsafe: Fraction = 0.01
    """Largest part of a case's samples beyond the bounds of eq. 14: alpha 11 deg, bank 60 deg."""
    saturated: Fraction = 0.05
    """Largest part of a case's samples with a command at its bound."""
    error: Annotated[float, Meta(gt=0.0)] = 10.0
    """Largest nMAE of theta and phi [%]; sideslip is left out, whose own nMAE has a floor in F6."""

    @property
    def trials(self) -> Trials:
        """Return the references, from each seed in turn."""
        return Trials(self.references, self.duration)


class Screening(NamedTuple):
    """What the screening saw; scores (P, E) by case."""

    settings: ScreeningSettings
    scores: dict[str, Scores]

    def breaches(self, member: int, case: str) -> list[str]:
        """Return which constraints a member breaks in a case, in words."""
        s = self.scores[case]
        lost, flown = int(s.lost[member].sum()), s.length[member].sum()
        unsafe = float(s.unsafe[member].sum() / flown)
        saturated = float((s.saturated[member] * s.length[member]).sum() / flown)
        found = [f"loses {lost} of {s.lost.shape[1]}"] if lost else []
        error = attitude_nmae(s)[member].mean()
        if error > self.settings.error and not lost:
            found.append(f"tracks with {error:.0f} %")
        if unsafe > self.settings.unsafe:
            found.append(f"unsafe {100.0 * unsafe:.0f} %")
        if saturated > self.settings.saturated:
            found.append(f"saturated {100.0 * saturated:.0f} %")
        return found

    def verdict(self, member: int) -> str:
        """Return what a member is good for, in one line."""
        broken = {case: found for case in self.scores if (found := self.breaches(member, case))}
        if not broken:
            return "passes in every case"
        if len(broken) == len(self.scores):
            return "fails in every case: a specialist for what is not screened, or of no use"
        detail = "; ".join(f"{case}: {', '.join(found)}" for case, found in broken.items())
        return (
            f"{'fails the nominal case' if NOMINAL_CASE in broken else 'passes the nominal case'}; breaks in {detail}"
        )

    def passed(self, member: int) -> int:
        """Return in how many cases a member keeps every constraint."""
        return sum(not self.breaches(member, case) for case in self.scores)

    def average(self, case: str) -> tuple[float, int]:
        """Return the mean nMAE [%] of the members that lose no flight of a case, and how many they are."""
        scores = self.scores[case]
        whole = ~scores.lost.any(axis=1)
        return (float(np.mean(scores.nmae[whole])) if whole.any() else float("nan")), int(whole.sum())

    def figures(self, member: int) -> dict[str, float]:
        """Return a member's scores for the manifest: nMAE [%] of each case, flights lost, and the rest over all."""
        scores = {f"screening_{case}_nmae": _rounded(s.nmae[member].mean()) for case, s in self.scores.items()}
        return scores | {
            "screening_lost": float(sum(s.lost[member].sum() for s in self.scores.values())),
            "screening_cases_passed": float(self.passed(member)),
            "screening_nominal_smoothness": _rounded(self.scores[NOMINAL_CASE].smoothness[member].mean()),
        }


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def screen(
    population: Population, settings: ScreeningSettings, store: Path, progress: Callable[[int], None]
) -> Screening:
    """Fly every member in every case; ``progress`` is told how many flights have ended.

    Flights are kept in ``store``: a screening that was stopped goes on where it was.
    """
    fleet, parameters = CaseFleet(), population.parameters
    blocks = [parameters[i : i + ABREAST] for i in range(0, len(parameters), ABREAST)]
    scores = {
        case.name: join(
            [fly_once(store, fleet, case, population.network, block, settings.trials, progress) for block in blocks],
            axis=0,
        )
        for case in SCREENED
    }
    return Screening(settings, scores)


def flights(population: Population, settings: ScreeningSettings) -> int:
    """Return how many flights :func:`screen` takes."""
    return len(SCREENED) * len(population.parameters) * settings.references


def fit(population: Population, screening: Screening) -> tuple[Population, Screening, dict[str, str]]:
    """Return population and screening of the members that keep every constraint in one case at least.

    And, by name, the verdicts on the others: potentially unsafe ones, which the thesis would remove (chapter 8.5).
    Raises UserError when the champion is one of them.
    """
    members = population.description.members
    kept = [i for i in range(len(members)) if screening.passed(i)]
    left_out = {member.name: screening.verdict(i) for i, member in enumerate(members) if i not in kept}
    if population.description.champion in left_out:
        raise UserError(
            f"champion {population.description.champion}: keeps the safety constraints in no case, and would be left "
            "out; train it further, or export with all members"
        )
    description = msgspec.structs.replace(population.description, members=tuple(members[i] for i in kept))
    scores = {case: Scores(*(column[kept] for column in each)) for case, each in screening.scores.items()}
    return Population(description, population.parameters[kept]), screening._replace(scores=scores), left_out


def annotated(population: Population, screening: Screening, left_out: dict[str, str] | None = None) -> Population:
    """Return the population with what the screening found in its members' scores and in its provenance.

    left_out: members that :func:`fit` has left out, and why.
    """
    description = population.description
    members = tuple(
        Member(name=member.name, scores=member.scores | screening.figures(i))
        for i, member in enumerate(description.members)
    )
    said: dict[str, Any] = {
        "settings": msgspec.to_builtins(screening.settings),
        "seeds": list(SEEDS),
        "verdicts": {member.name: screening.verdict(i) for i, member in enumerate(members)},
    } | ({"left_out": left_out} if left_out else {})
    training = description.training | {"screening": said}
    return Population(msgspec.structs.replace(description, members=members, training=training), population.parameters)
