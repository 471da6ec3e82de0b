"""What it is worth to know the delay of the commands, in closed loop: imagined, and made up for.

``python -m bench.decision`` flies a cast of three linear laws of falling gain, the strongest first, whose commands come
late from 5 s on, with noisy gyros: alone; with the preset ``structured`` as it is, in which whoever flies answers the
foretold state; the same with the delay only imagined; and not looked for. It writes ``results/decision.json``.

Predicted: an estimator that knows the delay does nothing by itself; imagined with it, the strong law loses against a
slower one, and without it the imagination keeps, or goes back to, what oscillates. Foretold, the strong law flies on,
about as closely as with commands in time.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from export.folder import write_population
from export.network import Layer, Network, flatten
from export.population import Description, Member, Population
from export.prior import model_prior
from export.rates import rate_model
from runtime.link import LOST, OVER, Sample
from runtime.population import Population as Loaded
from runtime.population import load_population
from runtime.presets import resolve
from runtime.reference import RecordedReference
from runtime.session import Session
from sim_bridge.plant import Plant
from task.limits import DT
from task.metrics import nmae, smoothness
from task.observation import tracking_error
from task.reference import random_reference
from task.results import Claim, Result, Table, write
from task.reward import terminated
from task.state import ACTION, N_ACTION, N_IDENTIFIED, N_OBSERVATION, OBSERVATION, STATE
from understudy import run

GYRO = 6.3e-4
"""Standard deviation of the gyros' noise in the thesis's case R3 [rad/s]."""
FAULT_AT = 5.0
"""From when on commands are late [s]."""
DURATION = 20.0
"""Length of a flight [s]."""
DELAYS = (0, 5, 10, 15)
"""How late [samples]."""
GAINS = {"strong": 6.0, "good": 1.5, "lazy": 0.3}
"""Members, and what their gains are multiplied by; the first is the champion."""
METHODS = {
    "alone": ("understudy", ("switch=none",)),
    "state foretold": ("structured", ()),
    "delay imagined": ("structured", ("foretell=false",)),
    "delay not looked for": ("structured", ("delays=[]",)),
}
"""Preset and what is set over it, by name."""
TRIM_ELEVATOR = -0.02477
"""Of the nominal flight [rad]."""


class Flight(NamedTuple):
    """What came of one flight, from the fault on."""

    survived: bool
    nmae: float
    """[%]."""
    smoothness: float
    switches: int


def cast() -> Population:
    """Return the laws: elevator on pitch, aileron on bank, rudder on sideslip."""
    network = Network(layers=(Layer(units=N_ACTION, activation="linear"),), action_scale=(1.0,) * N_ACTION)
    weights = np.zeros((len(GAINS), N_ACTION, N_OBSERVATION))
    for weight, gain in zip(weights, GAINS.values(), strict=True):
        weight[ACTION.de, OBSERVATION.theta_e], weight[ACTION.de, OBSERVATION.q] = -0.8 * gain, 0.4 * gain
        weight[ACTION.da, OBSERVATION.phi_e], weight[ACTION.da, OBSERVATION.p] = -0.6 * gain, 0.2 * gain
        weight[ACTION.dr, OBSERVATION.beta_e] = 0.3
    bias = np.tile([TRIM_ELEVATOR, 0.0, 0.0], (len(GAINS), 1))
    members = tuple(Member(name=name, scores={}) for name in GAINS)
    description = Description(network=network, members=members, champion=next(iter(GAINS)), training={})
    return Population(description, flatten(network, {"layers.0.weight": weights, "layers.0.bias": bias}))


class LateLink:
    """The plant as a link in lockstep, with noisy gyros and commands that come late."""

    skipped = repeated = 0

    def __init__(self, plant: Plant, delay: int, seed: int) -> None:
        self.ended = ""
        self._plant, self._delay = plant, delay
        self._rng = np.random.default_rng([seed, 1])
        self._tick = 0
        plant.reset(seed=seed)
        self.x = [plant.x[:N_IDENTIFIED].copy()]
        self.sent: list[np.ndarray] = []

    def read(self, timeout: float) -> Sample | None:
        """Return the measured state."""
        if self._tick >= round(DURATION / DT):
            self.ended = OVER
        elif terminated(self._plant.x):
            self.ended = LOST
        if self.ended:
            return None
        x = self._plant.x.copy()
        x[: STATE.V] += GYRO * self._rng.standard_normal(3)
        return Sample(round(1e6 * DT) * self._tick, 1, x)

    def write(self, action: np.ndarray, time_usec: int) -> None:
        """Step the plant with what was commanded a while ago."""
        self.sent.append(np.array(action, dtype=float))
        late = self._delay if self._tick * DT >= FAULT_AT else 0
        self._plant.step(self.sent[max(self._tick - late, 0)])
        self._tick += 1
        self.x.append(self._plant.x[:N_IDENTIFIED].copy())

    def say(self, text: str, severity: int) -> None:
        """Say nothing."""

    def diagnosis(self) -> str:
        """Return what is at the other end."""
        return "the plant"


def fly(population: Loaded, plant: Plant, delay: int, seed: int, method: str, log: Path) -> Flight:
    """Fly one random reference."""
    link = LateLink(plant, delay, seed)
    rows = random_reference(np.random.default_rng(seed), DURATION, float(link.x[0][STATE.theta]), "evaluation")
    preset, over = METHODS[method]
    configuration = resolve(preset, None, over)
    with Session(link, population, RecordedReference(rows), configuration, log, overwrite=True) as session:
        (flown,) = session.fly()
    begin = round(FAULT_AT / DT)
    x = np.array(link.x[:-1])
    error = tracking_error(x, rows[: len(x)])[begin:]
    return Flight(flown.outcome == OVER, nmae(error), smoothness(np.array(link.sent)[begin:]), flown.summary.switches)


@click.command()
@click.option(
    "--references",
    type=click.IntRange(1),
    default=6,
    show_default=True,
    help="Random references for each delay and method.",
)
def main(references: int) -> None:
    """Measure and write results/decision.json."""
    began = time.perf_counter()
    rows: list[list[object]] = []
    better: dict[str, list[float]] = {"state foretold": [], "delay imagined": []}
    with tempfile.TemporaryDirectory() as folder:
        write_population(cast(), model_prior(), Path(folder) / "cast", rates=rate_model())
        population, plant = load_population(Path(folder) / "cast"), Plant()
        for delay in DELAYS:
            flown = {
                method: [
                    fly(population, plant, delay, seed, method, Path(folder) / "f.ulg") for seed in range(references)
                ]
                for method in METHODS
            }
            for method, flights in flown.items():
                rows.append([
                    f"{1e3 * delay * DT:g} ms", method, f"{sum(f.survived for f in flights)} of {references}",
                    round(float(np.mean([f.nmae for f in flights])), 2), round(max(f.nmae for f in flights), 2),
                    round(float(np.median([f.smoothness for f in flights])), 1), sum(f.switches for f in flights),
                ])  # fmt: skip
                click.echo("  ".join(str(cell) for cell in rows[-1]))
            if delay:
                for method, gained in better.items():
                    pairs = zip(flown[method], flown["delay not looked for"], strict=True)
                    gained += [ours.nmae - theirs.nmae for ours, theirs in pairs]
    changes = {method: float(np.mean(gained)) for method, gained in better.items()}
    result = Result(
        title="Late commands: foretold, imagined or not looked for",
        command=f"python -m bench.decision --references {references}",
        seconds=round(time.perf_counter() - began, 1),
        runs=references * len(METHODS) * len(DELAYS),
        seeds=list(range(references)),
        claims=[
            Claim(claim=f"nMAE with the {method} less nMAE without looking for the delay, late commands",
                  value=round(change, 2), unit="points of nMAE", target="< 0", holds=change < 0.0)
            for method, change in changes.items()
        ],
        tables=[
            Table(title="Commands late from 5 s on, gyro noise, evaluation references of 20 s", rows=rows,
                  columns=["late by", "method", "survive", "nMAE %: mean", "worst", "Sm, median", "switches"])
        ],
        notes=[
            f"The cast: linear laws whose gains stand as {', '.join(f'{n} {g:g}' for n, g in GAINS.items())}.",
            "The first is the champion.",
            "nMAE and smoothness from 5 s to the end of the flight.",
        ],
    )  # fmt: skip
    click.echo(f"{write('decision', result)}: {result.seconds:.0f} s")


if __name__ == "__main__":
    run(main)
