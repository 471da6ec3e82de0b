"""How well the imagination's model foretells the healthy aircraft where it flies, beside the prior of one trim.

``python -m bench.scheduling --population populations/citation`` flies excited flights of evaluation references at trims
of the fit and between them, and foretells bank, pitch and sideslip from moments of them with the commands that were
sent: with the population's prior as it is, with that prior scheduled (:mod:`task.scheduling`), and with a model fitted
at that very trim, on a flight like those that it is judged by. It writes ``results/scheduling.json``.

Predicted: at R1 and R2 the prior errs by more than ten times as much in bank, since what its surfaces do is 2.7 times
too weak there and 2.5 times too strong; at its own trim the two are alike.
"""

from __future__ import annotations

import time
from pathlib import Path

import click
import numpy as np

from export.prior import COMMAND_LAG, PriorSettings, excited_flight, regression
from runtime.population import load_population
from sim_bridge.conditions import NOMINAL, R1, R2, FlightCondition
from sim_bridge.plant import Plant
from task.errors import UserError
from task.limits import DT
from task.model import embed_reduced, predict_increment
from task.results import Claim, Result, Table, write
from task.scheduling import scheduled
from task.state import STATE
from understudy import run

TRIMS = {
    "2000 m, 90 m/s": NOMINAL,
    "R1: 2000 m, 150 m/s": R1,
    "R2: 10000 m, 90 m/s": R2,
    "5000 m, 110 m/s": FlightCondition(altitude=5000.0, speed=110.0),
}
MODELS = ("prior of 2000 m, 90 m/s", "scheduled", "fitted at this trim")
FLIGHTS = 3
"""At each trim; another one is for the fit."""
AHEAD = (1.0, 2.0, 4.0)
"""How far is foretold [s]."""
EVERY = 1.0
"""Between two moments that are foretold from [s]."""
ANGLES = (STATE.phi, STATE.theta, STATE.beta)
SEED = 20


def foretell(states: np.ndarray, commands: np.ndarray, k: int, model: np.ndarray, samples: int) -> np.ndarray:
    """Return the error (samples, 3) of phi, theta and beta [rad] from sample k on, with the commands that were sent."""
    x, dx = states[k].copy(), states[k] - states[k - 1]
    errors = np.zeros((samples, len(ANGLES)))
    for t in range(samples):
        da = commands[k + t - COMMAND_LAG] - commands[k + t - COMMAND_LAG - 1]
        dx = predict_increment(x, dx, da, model, exact_kinematics=True)
        x = x + dx
        errors[t] = (x - states[k + t + 1])[list(ANGLES)]
    return errors


@click.command()
@click.option("--population", type=click.Path(path_type=Path), default=Path("populations/citation"), show_default=True)
def main(population: Path) -> None:
    """Measure and write results/scheduling.json."""
    began = time.perf_counter()
    cast = load_population(population)
    rates = cast.rates
    if rates is None:
        raise UserError(f"{population}: has no rate model; export it again")
    prior, learnt_at = embed_reduced(cast.theta), cast.learnt_at
    plant, settings, rng = Plant(), PriorSettings(), np.random.default_rng(SEED)
    steps = [round(ahead / DT) for ahead in AHEAD]
    samples, every = max(steps), round(EVERY / DT)
    rows: list[list[object]] = []
    bank: dict[tuple[str, str], float] = {}
    for trim, condition in TRIMS.items():
        z, y = regression(*excited_flight(plant, rng, condition, settings))
        scale = np.sqrt((z**2).mean(axis=0))
        own = embed_reduced(np.linalg.lstsq(z / scale, y, rcond=None)[0] / scale[:, None])
        errors: dict[str, list[np.ndarray]] = {name: [] for name in MODELS}
        for _ in range(FLIGHTS):
            states, commands = excited_flight(plant, rng, condition, settings)
            for k in range(2 * every, len(commands) - samples, every):
                here = scheduled(prior, learnt_at, rates, states[k], commands[k - COMMAND_LAG])
                for name, model in zip(MODELS, (prior, here, own), strict=True):
                    errors[name].append(foretell(states, commands, k, model, samples))
        for name, each in errors.items():
            square = np.square(each).mean(axis=0)
            found = np.rad2deg(np.sqrt(square[[step - 1 for step in steps]]))  # (AHEAD, angles)
            bank[trim, name] = float(found[1, 0])
            rows.append([trim, name, *found.T.reshape(-1).round(2).tolist()])
            click.echo("  ".join(str(cell) for cell in rows[-1]))
    ratios = {trim: bank[trim, MODELS[0]] / bank[trim, MODELS[1]] for trim in TRIMS}
    result = Result(
        title="The imagination's model over the envelope",
        command=f"python -m bench.scheduling --population {population}",
        seconds=round(time.perf_counter() - began, 1),
        runs=len(TRIMS) * (FLIGHTS + 1),
        seeds=[SEED],
        claims=[
            Claim(claim=f"{trim}: error of bank 2 s ahead with the prior as it is, over that with it scheduled",
                  value=round(ratio, 2))
            for trim, ratio in ratios.items()
        ],
        tables=[
            Table(title="Root mean square error of what is foretold [deg]",
                  columns=["trim", "model", *(f"{name} {ahead:g} s ahead" for name in ("bank", "pitch", "sideslip")
                                              for ahead in AHEAD)],
                  rows=rows),
        ],
        notes=[
            "Healthy aircraft, ideal sensors, still air; evaluation references with an excitation of 0.5 deg.",
            "Predicted: more than ten times as much in bank at R1 and R2, alike at the prior's own trim.",
        ],
    )  # fmt: skip
    click.echo(f"{write('scheduling', result)}: {result.seconds:.0f} s")


if __name__ == "__main__":
    run(main)
