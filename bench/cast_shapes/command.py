"""Which shape should a member have? The same search, with the same frames, on shapes with and without a hidden layer.

``python -m bench.cast_shapes`` writes ``results/cast_shapes.json``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import click
import msgspec
import numpy as np

from bench.cast import Folder
from export.cast.cases import EASY, Case
from export.cast.config import CastSettings, SearchSettings
from export.cast.flights import Stage, Trial
from export.cast.search import Judge, search
from export.cast.trials import Drawer
from export.cast.variants import symmetric
from export.network import Layer, Network, flatten, n_parameters, unflatten
from task.config import convert
from task.reference import random_reference
from task.results import Claim, Result, Table, write

SEED = 30_000_001
START = 0.1
"""Standard deviation of random parameters."""
LINEAR = 0.05
"""Scale at which a hidden tanh unit passes a signal on nearly unchanged."""
REFERENCES, DURATION = 3, 80.0
"""Evaluation references, and their length [s]."""


def embedded(row: np.ndarray, one: Network, wide: Network, rng: np.random.Generator) -> np.ndarray:
    """Return parameters of a network with one hidden layer that commands nearly what a one-layer policy does.

    Three hidden units carry its three outputs; the others see random directions and are not listened to yet.
    """
    tensors = unflatten(one, row[None])
    units = wide.layers[0].units
    hidden = START * rng.standard_normal((1, units, one.observation))
    hidden[:, :3] = LINEAR * tensors["layers.0.weight"]
    bias = np.zeros((1, units))
    bias[:, :3] = LINEAR * tensors["layers.0.bias"]
    out = np.zeros((1, 3, units))
    out[0, :, :3] = np.eye(3) / LINEAR
    return flatten(
        wide,
        {"layers.0.weight": hidden, "layers.0.bias": bias, "layers.1.weight": out, "layers.1.bias": np.zeros((1, 3))},
    )[0].astype(float)


class Study:
    """Searches of equal length on one stage."""

    def __init__(self, cast: Folder, frames: int) -> None:
        self.settings = convert(cast.training["config"], CastSettings, "the population's training.config")
        self.cast, self.frames = cast, frames
        self.stage = Stage()
        self.drawer = Drawer(self.settings.trial, self.stage.plant)

    def run(
        self, network: Network, start: np.ndarray, free: np.ndarray, case: Case, sigma: float, floor: float
    ) -> tuple[np.ndarray, float, float]:
        """Search for a case that holds from the start of a flight; return what was found, and both tuning costs."""
        population = 4 + round(3.0 * np.log(free.sum()))
        trial_frames = round(self.settings.trial.duration * 100.0)
        search_settings = SearchSettings(
            population=population, sigma=sigma, floor=floor, references=2, tuning=6,
            iterations=max(1, self.frames // (population * 2 * trial_frames)),
        )  # fmt: skip
        judge = Judge(self.stage, network, self.settings.trial)

        def draw(rng: np.random.Generator, count: int) -> list[Trial]:
            return self.drawer.trials(rng, case, count, sudden=False)

        found = search(judge, draw, start, free, search_settings, np.random.SeedSequence(SEED))
        return found.parameters, found.start_cost, found.cost

    def nominal(self, network: Network, row: np.ndarray) -> str:
        """Return the nMAE on evaluation references of 80 s."""
        rng = np.random.default_rng(SEED)
        theta = self.drawer.theta_trim(EASY[0].condition)
        trials = [Trial(EASY[0], random_reference(rng, DURATION, theta)) for _ in range(REFERENCES)]
        flown = self.stage.fly(network, row[None], trials)
        if flown.lost.any():
            return f"{int(flown.lost.sum())} of {REFERENCES} lost"
        return f"{flown.nmae(np.zeros(REFERENCES, dtype=int)).mean():.2f}"


def from_scratch(study: Study, say: Callable[[str], None]) -> list[list[object]]:
    """Return one row for each shape that begins from random parameters on the nominal aircraft."""
    scale = study.settings.input_scale
    one = Network(layers=(Layer(units=3),), input_scale=scale)
    shapes = {
        "7-3, left and right alike": (one, symmetric(one)),
        "7-3": (one, np.ones(n_parameters(one), dtype=bool)),
    }
    for hidden in (8, 16):
        wide = Network(layers=(Layer(units=hidden), Layer(units=3)), input_scale=scale)
        shapes[f"7-{hidden}-3"] = (wide, np.ones(n_parameters(wide), dtype=bool))
    rows: list[list[object]] = []
    for name, (network, free) in shapes.items():
        start = np.where(free, START * np.random.default_rng(SEED).standard_normal(len(free)), 0.0)
        found, _, cost = study.run(network, start, free, EASY[0], 0.5, 1.0)
        rows.append([name, int(free.sum()), round(cost, 2), study.nominal(network, found)])
        say(str(rows[-1]))
    return rows


def further(study: Study, cases: tuple[str, ...], say: Callable[[str], None]) -> list[list[object]]:
    """Return one row for each case: the main member searched on, as it is and with a hidden layer around it."""
    one = study.cast.network
    wide = Network(layers=(Layer(units=16), Layer(units=3)), input_scale=one.input_scale)
    main = study.cast.parameters[study.cast.champion].astype(float)
    inside = embedded(main, one, wide, np.random.default_rng(SEED))
    known = {case.name: case for case in (*EASY, *study.settings.cases)}
    rows: list[list[object]] = []
    for name in cases:
        case = known[name]
        narrow = study.run(one, main, np.ones(len(main), dtype=bool), case, 0.2, 0.3)
        broad = study.run(wide, inside, np.ones(len(inside), dtype=bool), case, 0.05, 0.3)
        rows.append([name, round(narrow[1], 2), round(narrow[2], 2), round(broad[1], 2), round(broad[2], 2)])
        say(str(rows[-1]))
    return rows


@click.command()
@click.option("--population", type=click.Path(path_type=Path), default="populations/citation", show_default=True)
@click.option("--frames", type=click.IntRange(1), default=1_000_000, show_default=True, help="Of one search.")
def main(population: Path, frames: int) -> None:
    """Search with each shape and write results/cast_shapes.json."""
    began = time.monotonic()
    study = Study(Folder(population), frames)
    scratch = from_scratch(study, click.echo)
    cases = ("nominal", "R2", "latency 100 ms", "elevator x 0.1")
    on = further(study, cases, click.echo)
    better = [row for row in on if float(str(row[4])) < 0.9 * float(str(row[2]))]
    result = Result(
        title="Shape of a member of the default cast",
        command=f"python -m bench.cast_shapes --frames {frames}",
        seconds=round(time.monotonic() - began, 1),
        runs=len(scratch) + 2 * len(on),
        seeds=[SEED],
        claims=[
            Claim(claim="cases in which a hidden layer of 16 lowers the cost by 10 % or more", value=len(better),
                  unit=f"of {len(on)}"),
        ],
        tables=[
            Table(title=f"From random parameters, nominal, {frames} frames each",
                  columns=["shape", "parameters searched", "cost on tuning flights [% nMAE]",
                           "nMAE % on references of 80 s"], rows=scratch),
            Table(title=f"From the main member, {frames} frames each: cost on tuning flights [% nMAE]",
                  columns=["case", "7-3 before", "7-3 after", "7-16-3 before", "7-16-3 after"], rows=on),
        ],
        notes=[
            "CMA-ES with 4 + 3 ln(n) policies; one seed: what a shape gains by chance is not told apart.",
            "7-16-3 begins as the main member itself, three of its hidden units passing the three outputs on.",
        ],
    )  # fmt: skip
    click.echo(f"wrote {write('cast_shapes', result)}: {msgspec.to_builtins(result.claims[0])['value']} better")
