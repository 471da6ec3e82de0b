"""How well the rate model knows the healthy aircraft on flights that it has not seen, and what its terms are worth.

``python -m bench.rate_model --population populations/citation`` flies a law after references of both families, at trims
beside those of the fit, and takes from the recorded accelerations what the model explains, whitened as for the fit:
what is left from sample to sample is what the filters take for a change of the aircraft. Beside the population's model
stand models fitted anew without some of its terms. It writes ``results/rate_model.json``.

Predicted: without damping that varies with speed three times as much is left of roll and yaw; without the bends twice
as much of pitch near the stall, where alarms in healthy flight came from.
"""

from __future__ import annotations

import time
from pathlib import Path

import click
import numpy as np

from export.prior import COMMAND_LAG
from export.rates import RateSettings, fit, fitting_flights, regression, whitened
from runtime.laws.catalogue import load_solo
from runtime.population import load_population
from sim_bridge.conditions import FlightCondition
from sim_bridge.plant import Plant
from task.errors import UserError
from task.rates import BENDS, N_EFFECT, N_FEATURES, RATES, RateModel
from task.reference import FamilyName, random_reference
from task.results import Claim, Result, Table, write
from task.reward import terminated
from task.state import N_ACTION, N_IDENTIFIED, STATE
from understudy import run

TRIMS = (
    FlightCondition(altitude=2500.0, speed=92.0),
    FlightCondition(altitude=3500.0, speed=135.0),
    FlightCondition(altitude=5000.0, speed=105.0),
    FlightCondition(altitude=8000.0, speed=95.0),
)
FAMILIES: tuple[FamilyName, ...] = ("evaluation", "aggressive")
DURATION = 40.0
"""Of a flight [s]."""
LAW = "indi-rls-signfree"
ALPHA = ((-15.0, -3.0), (-3.0, 6.0), (6.0, 8.0), (8.0, 9.5), (9.5, 15.0))
"""Ranges of the angle of attack [deg]."""
SPEED_DAMPING = (19, 20, 21)
"""Places among the regressors, as in :func:`task.rates.features`; those of the next two as well."""
BEND_TERMS = tuple(range(N_FEATURES - len(BENDS), N_FEATURES))
KNEE_EFFECT = tuple(N_FEATURES + N_EFFECT * (surface + 1) - 1 for surface in range(N_ACTION))
WITHOUT = {
    "without damping that varies with speed": SPEED_DAMPING,
    "without bends but the knee": BEND_TERMS,
    "without effect beyond the knee": KNEE_EFFECT,
    "without all three": (*SPEED_DAMPING, *BEND_TERMS, *KNEE_EFFECT),
}
"""Models beside the population's, and the terms that they lack."""


def fly(plant: Plant, trim: FlightCondition, family: FamilyName, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Fly one reference; return states (T + 1, 10) and commands (T, 3) [rad]."""
    law = load_solo(LAW).law
    law.reset()
    x = plant.reset(trim)
    states, commands = [x[:N_IDENTIFIED].copy()], []
    for target in random_reference(np.random.default_rng(seed), DURATION, float(x[STATE.theta]), family):
        command = law.steer(x, target).copy()
        law.sent(command)
        commands.append(command)
        x = plant.step(command)
        states.append(x[:N_IDENTIFIED].copy())
        if terminated(x):
            raise RuntimeError(f"{LAW} lost the healthy aircraft at {trim}")
    return np.array(states), np.array(commands)


def theta(model: RateModel) -> np.ndarray:
    """Return the coefficients in the order of the regressors, (45, 3)."""
    return np.concatenate([model.drift, model.effect.reshape(-1, RATES)])


def lacking(z: np.ndarray, terms: tuple[int, ...]) -> np.ndarray:
    """Return the regressors (N, 45) without some terms, whose coefficients are then zero."""
    z = z.copy()
    z[:, terms] = 0.0
    return z


@click.command()
@click.option("--population", type=click.Path(path_type=Path), default=Path("populations/citation"), show_default=True)
def main(population: Path) -> None:
    """Measure and write results/rate_model.json."""
    began = time.perf_counter()
    rates = load_population(population).rates
    if rates is None:
        raise UserError(f"{population}: has no rate model; export it again")
    plant, settings = Plant(), RateSettings()
    fitted = [regression(*flight) for flight in fitting_flights(plant, settings)]
    models = {population.name: theta(rates)}
    for name, terms in WITHOUT.items():
        models[name] = theta(fit([(lacking(z, terms), y) for z, y in fitted], settings.whitening))

    seeds = list(range(100, 100 + len(TRIMS) * len(FAMILIES)))
    cases = [(trim, family) for trim in TRIMS for family in FAMILIES]
    flown = [fly(plant, *case, seed) for case, seed in zip(cases, seeds, strict=True)]
    z, y = whitened([regression(*flight) for flight in flown], settings.whitening)
    alpha = np.degrees(np.concatenate([states[COMMAND_LAG + 1 : -1, STATE.alpha] for states, _ in flown]))
    left = {name: 1e3 * (y - z @ coefficients) for name, coefficients in models.items()}
    moved = 1e3 * np.sqrt((y**2).mean(axis=0))
    rows: list[list[object]] = [["all of it", *moved.round(2).tolist(), "", "", ""]]
    for name, error in left.items():
        rms, worst = np.sqrt((error**2).mean(axis=0)), np.abs(error).max(axis=0)
        rows.append([name, *rms.round(3).tolist(), *worst.round(1).tolist()])
    by_alpha: list[list[object]] = []
    for low, high in ALPHA:
        within = (alpha >= low) & (alpha < high)
        both = [np.sqrt((left[name][within] ** 2).mean(axis=0)) for name in (population.name, "without all three")]
        by_alpha.append([f"{low:g} to {high:g}", int(within.sum()), *np.concatenate(both).round(2).tolist()])
    for row in rows:
        click.echo("  ".join(str(cell) for cell in row))
    ours, bare = (np.sqrt((left[name] ** 2).mean(axis=0)) for name in (population.name, "without all three"))
    axes = ("roll", "pitch", "yaw")
    result = Result(
        title="The rate model on flights that it has not seen",
        command=f"python -m bench.rate_model --population {population}",
        seconds=round(time.perf_counter() - began, 1),
        runs=len(flown),
        seeds=seeds,
        claims=[
            Claim(claim=f"{axis}: left of the acceleration without all three, over what the model leaves",
                  value=round(float(b / o), 2))
            for axis, o, b in zip(axes, ours, bare, strict=True)
        ],
        tables=[
            Table(title="Whitened acceleration [mrad/s2]: all, and what each model leaves; root mean square and worst",
                  columns=["model", *axes, *(f"worst {axis}" for axis in axes)], rows=rows),
            Table(title="The same by angle of attack [deg], root mean square",
                  columns=["angle", "samples", *axes, *(f"{axis}, without all three" for axis in axes)], rows=by_alpha),
        ],
        notes=[
            f"Flown by {LAW}, ideal sensors, still air, {DURATION:g} s each, at trims beside those of the fit.",
            "Predicted: three times as much left of roll and yaw, twice as much of pitch near the stall.",
        ],
    )  # fmt: skip
    click.echo(f"{write('rate_model', result)}: {result.seconds:.0f} s")


if __name__ == "__main__":
    run(main)
