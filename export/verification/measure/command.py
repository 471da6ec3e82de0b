"""LunarLander as in the thesis's chapter 4, measured: learning curves, faults, behaviours, picks from a repertoire.

``python -m export.verification.measure`` flies what ``understudy train lunar_pderl``, ``understudy train lunar_ddpg``
and ``python -m export.verification.archive`` have left, and writes ``results/lunar_lander.json`` and
``docs/img/lunar_*.png``.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from rich.console import Console

from export.training.gymnasium_run import BANDS, load_agents, read_bands
from export.training.run import CONFIG, CURVE
from export.verification.archive import LINEAR, ArchiveSettings, load_elites
from export.verification.findings import Found, Picked, result
from export.verification.lander import FAULTS, Fault
from export.verification.pictures import BLUE, ORANGE, Behaviours, Curve, learning, maps, robustness, shifts
from export.verification.trials import Cast, Grounds, choose, seeds
from task import results
from task.errors import UserError

TEST_STREAM, VALIDATION_STREAM, TRIAL_STREAM = 4_000, 5_000, 6_000
"""Seeds of episodes: for the test of everybody, for the archive's champion, for picks with a fault."""
CANDIDATES = 40
"""Elites with the best returns: they compete for the archive's champion, and picks choose among them."""
VALIDATION_EPISODES = 8
"""Of each candidate."""
SHOWN = 60
"""Elites with the best returns whose behaviour with a fault is looked at."""
FIRST, KEEP, THEN = 2, 5, 8
"""A pick tries every policy on FIRST episodes, and the best KEEP of them on THEN more."""


class Run(NamedTuple):
    """A trained run of landers."""

    cast: Cast
    champion: int
    training: dict[str, Any]
    folder: Path


def load_run(folder: Path) -> Run:
    """Read a run; raise UserError when it is not there."""
    population = load_agents(folder)
    cast = Cast(population.network, population.parameters)
    return Run(cast, population.champion, population.description.training, folder)


def curve(run: Run, name: str, colour: str) -> Curve:
    """Return a run's learning curve, with the population's average where there is one."""
    average = None
    if len(run.cast.parameters) > 1:
        rows = np.atleast_1d(np.genfromtxt(run.folder / CURVE, delimiter=",", names=True))
        average = np.stack([rows["frames"], rows["average"]], axis=1)
    return Curve(name, colour, read_bands(run.folder / BANDS), average)


def champion_of(grounds: Grounds, cast: Cast) -> int:
    """Return the policy that lands best, nominal, on episodes that nobody has seen."""
    landed = grounds.land(cast, "none", seeds(VALIDATION_STREAM, VALIDATION_EPISODES))
    return int(landed.returns.mean(axis=1).argmax())


def behaviours(grounds: Grounds, cast: Cast, episode: int) -> dict[str, Behaviours]:
    """Return where policies touch down in the episode of the archive, nominal and with each fault."""
    found = {}
    for fault in FAULTS:
        landed = grounds.land(cast, fault, np.array([episode]))
        found[str(fault)] = Behaviours(landed.behaviour[:, 0], landed.returns[:, 0])
    return found


def pick(
    grounds: Grounds, cast: Cast, champion: int, fault: Fault, tests: np.ndarray, name: str, before: np.ndarray
) -> Picked:
    """Pick a policy for a fault by trial and test it beside the nominal champion, whose returns are ``before`` (E,)."""
    choice = choose(grounds, cast, fault, TRIAL_STREAM, FIRST, THEN, KEEP)
    same = choice.member == champion
    after = before if same else grounds.land(cast.pick([choice.member]), fault, tests).returns[0]
    return Picked(name, fault, len(cast.parameters), choice.episodes, before, after, same)


@click.command()
@click.option("--pderl", type=click.Path(path_type=Path), default=Path("runs/lunar_pderl"), show_default=True)
@click.option("--ddpg", type=click.Path(path_type=Path), default=Path("runs/lunar_ddpg"), show_default=True)
@click.option("--archive", type=click.Path(path_type=Path), default=Path("runs/lunar_archive"), show_default=True)
@click.option(
    "--memory",
    type=click.Path(path_type=Path),
    default=Path("runs/lunar_trials"),
    show_default=True,
    help="What was flown, so that a measurement that was stopped goes on.",
)
@click.option(
    "--episodes", type=click.IntRange(2), default=40, show_default=True, help="Of each test; the thesis has 100."
)
@click.option("--pictures", type=click.Path(path_type=Path), default=Path("docs/img"), show_default=True)
@click.option("--name", default="lunar_lander", show_default=True, help="Of the file in results/.")
def main(pderl: Path, ddpg: Path, archive: Path, memory: Path, episodes: int, pictures: Path, name: str) -> None:
    """Measure the landers, nominal and with both faults, and draw figures 4.2 to 4.5."""
    began = time.perf_counter()
    console = Console(soft_wrap=True)
    population, learner, elites = load_run(pderl), load_run(ddpg), load_elites(archive)
    if len(population.cast.parameters) < 2:
        raise UserError(f"{pderl}: expected a population, got a single agent; see {CONFIG} there")
    grounds, settings = Grounds(memory), ArchiveSettings()
    repertoire = Cast(LINEAR, elites.parameters())
    ranking = np.argsort(-elites.returns)
    candidates = repertoire.pick(ranking[:CANDIDATES])

    console.print("the archive's champion")
    best = champion_of(grounds, candidates)
    tests = seeds(TEST_STREAM, episodes)
    flown: dict[str, dict[str, np.ndarray]] = {}
    for who, cast in {
        "PDERL champion": population.cast.pick([population.champion]),
        "DDPG": learner.cast.pick([learner.champion]),
        "CMA-ME champion": candidates.pick([best]),
    }.items():
        console.print(f"{who}: {episodes} episodes in each of {len(FAULTS)} cases")
        flown[who] = {str(fault): grounds.land(cast, fault, tests).returns[0] for fault in FAULTS}

    console.print("behaviours of all actors and elites")
    genetic = population.cast.pick(list(range(len(population.cast.parameters) - 1)))
    touchdowns = {
        "PDERL": behaviours(grounds, genetic, settings.episode),
        "CMA-ME": behaviours(grounds, repertoire.pick(ranking[:SHOWN]), settings.episode),
    }
    console.print("picks with a fault")
    picks = [
        pick(grounds, cast, champion, fault, tests, who, flown[f"{who} champion"][fault])
        for fault in FAULTS
        if fault != "none"
        for who, cast, champion in (
            ("CMA-ME", candidates, best),
            ("PDERL", population.cast, population.champion),
        )
    ]

    learning(
        [curve(population, "PDERL", BLUE), curve(learner, "DDPG", ORANGE)],
        population.training["config"]["environment"]["validation_episodes"],
        pictures / "lunar_learning.png",
    )
    archived = Behaviours(elites.behaviour, elites.returns)
    maps(archived, touchdowns["PDERL"]["none"], settings, pictures / "lunar_archive.png")
    robustness(flown, pictures / "lunar_faults.png")
    shifts(touchdowns, settings, pictures / "lunar_behaviour.png")
    found = Found(
        flown, archived, touchdowns, picks, elites.progress, settings, (population.training, learner.training)
    )
    measured = result(found, grounds.episodes, grounds.recalled, time.perf_counter() - began)
    for claim in measured.claims:
        console.print(f"{claim.claim}: {claim.value} {claim.unit}", highlight=False)
    console.print(f"wrote {results.write(name, measured)}")
