"""One generation of mutation (section 6.2): what each operator makes of the same parents."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np
import torch
from matplotlib.figure import Figure

from export.network import Network
from export.population import load_run
from export.study.campaign import Trials, fly_once
from export.study.cases import CASES, CaseFleet
from export.study.short import Short, memories
from export.study.short_runs import OPERATORS
from export.study.show import flights_progress
from export.study.statistics import paired_interval, t_test
from export.study.thesis import MUTATION, MUTATION_MAGNITUDE
from export.training.evaluate import Scores
from export.training.genetic import act
from export.training.memory import Recollections
from export.training.population import Population
from task.limits import DEFLECTION_LIMIT
from task.results import Table

MAGNITUDES = (0.8e-2, MUTATION_MAGNITUDE, 7.4e-2)
"""sigma_mut; the middle one is the thesis's of SERL(10), the others a third and three times of it."""
SHARED = "safe, shared"
"""Safety-informed, each parent given the critical states of all: most have none of their own."""
VARIANTS = (*OPERATORS, SHARED)
DURATION = 20.0
"""Of a flight [s], as in training."""
STREAM = 7
"""Seed of the mutations."""


class Litter(NamedTuple):
    """The children of all parents by one operator at one magnitude; flights (N, E)."""

    operator: str
    magnitude: float
    return_change: np.ndarray
    """(N, E) eq. 6.1."""
    unsafe_change: np.ndarray
    """(N, E) unsafe samples of the child less the parent's, over the mean of all parents."""
    command_change: np.ndarray
    """(N,) RMS change of the commands on the parent's memory [rad]."""
    lost: int
    informed: int
    """Parents whose mutation knew critical states."""


def mutated(short: Short, network: Network, operator: str, magnitude: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the children (N, K) of a run's genetic actors, their RMS command change (N,) [rad] and the informed."""
    changes = {"mutation": "safe" if operator == SHARED else operator, "mutation_magnitude": magnitude}
    settings = msgspec.structs.replace(short.config.genetic, **changes)
    population = Population(network, settings, torch.Generator().manual_seed(STREAM), torch.device("cpu"))
    population.restore(memories(short))
    slots = list(range(settings.population))
    if operator == SHARED:
        _share(population.critical)
    generator = torch.Generator().manual_seed(STREAM)
    states = population.memory.sample(slots, settings.pairing_batch, generator)
    before = act(network, population.parameters, states)
    population.mutate_slots(slots, generator)
    step = act(network, population.parameters, states) - before
    rms = DEFLECTION_LIMIT * step.square().mean(dim=(1, 2)).sqrt().numpy()
    known = population.critical.filled[slots] > settings.mutation_batch
    informed = int(known.sum()) if settings.mutation == "safe" else 0
    return population.parameters.numpy(), rms, informed


def _share(critical: Recollections) -> None:
    """Give every actor the critical states of all."""
    pool = torch.cat([critical.latest(i, int(critical.filled[i])) for i in range(len(critical.filled))])
    for i in range(len(critical.filled)):
        critical.clear(i)
        critical.add(i, pool)


def one_generation(short: Short, references: int) -> list[Litter]:
    """Fly a run's genetic actors and their children by every operator at every magnitude."""
    network = load_run(short.folder).network
    parents = memories(short)["parameters"].numpy()
    trials = Trials(references, DURATION, "training")
    fleet, store = CaseFleet(), short.folder / "study"
    litters = []
    sets = 1 + len(VARIANTS) * len(MAGNITUDES)
    with flights_progress(sets * len(parents) * trials.total) as progress:

        def flown(parameters: np.ndarray) -> Scores:
            return fly_once(store, fleet, CASES[0], network, parameters, trials, progress)

        before = flown(parents)
        for magnitude in MAGNITUDES:
            for operator in VARIANTS:
                children, step, informed = mutated(short, network, operator, magnitude)
                after = flown(children)
                litters.append(
                    Litter(
                        operator,
                        magnitude,
                        (after.returns - before.returns) / np.abs(before.returns),
                        (after.unsafe - before.unsafe) / max(float(before.unsafe.mean()), 1.0),
                        step,
                        int(after.lost.sum()) - int(before.lost.sum()),
                        informed,
                    )
                )
    return litters


def litter_tables(litters: list[Litter]) -> list[Table]:
    """Return the children's figures, and the tests between operators of one magnitude."""
    rows = [
        [
            litter.operator,
            litter.magnitude,
            round(float(np.rad2deg(litter.command_change.mean())), 3),
            f"{litter.return_change.mean():+.3f}",
            f"{np.median(litter.return_change):+.3f}",
            f"{litter.return_change.min():+.1f}",
            f"{litter.unsafe_change.mean():+.3f}",
            f"{litter.lost:+d}",
            litter.informed or None,
        ]
        for litter in litters
    ]
    columns = ["operator", "sigma_mut", "RMS change of command [deg]", "change of return, mean", "median", "worst"]
    columns += ["change of unsafe samples, mean", "flights lost, change", "parents with critical states"]
    tests = []
    for magnitude in MAGNITUDES:
        of = {litter.operator: litter for litter in litters if litter.magnitude == magnitude}
        for first, second in (*MUTATION, (SHARED, "gaussian"), (SHARED, "proximal")):
            row: list[object] = [magnitude, f"{first} less {second}"]
            for field in ("return_change", "unsafe_change"):
                a, b = (getattr(of[o], field).ravel() for o in (first, second))
                difference, low, high = paired_interval(a, b)
                row += [f"{difference:+.3f} [{low:+.3f}, {high:+.3f}]", f"{t_test(a, b):.1e}"]
            tests.append([*row, MUTATION.get((first, second)) if magnitude == MUTATION_MAGNITUDE else None])
    return [
        Table(title="Over one generation", columns=columns, rows=rows),
        Table(
            title="Operators compared over one generation, paired [95 % interval]",
            columns=["sigma_mut", "pair", "change of return", "p", "change of unsafe samples", "p ", "thesis: return"],
            rows=tests,
        ),
    ]


def draw_litters(figure: Figure, litters: list[Litter]) -> None:
    """Draw the distributions of figures 6.3 and 6.4, at every magnitude."""
    figure.set_size_inches(11.0, 4.0)
    axes = figure.subplots(1, 3)
    at = np.arange(len(MAGNITUDES))
    for i, operator in enumerate(VARIANTS):
        of = [litter for litter in litters if litter.operator == operator]
        place = at + 0.2 * (i - 1.5)
        for axis, field in ((axes[0], "return_change"), (axes[1], "unsafe_change")):
            boxes = axis.boxplot(
                [getattr(litter, field).ravel() for litter in of],
                positions=place,
                widths=0.17,
                patch_artist=True,
                showmeans=True,
                flierprops={"markersize": 2.5},
                meanprops={"marker": "D", "markersize": 3.5, "markerfacecolor": "black", "markeredgecolor": "black"},
            )
            for box in boxes["boxes"]:
                box.set(facecolor=f"C{i}", alpha=0.6)
        axes[2].plot(
            at, [np.rad2deg(litter.command_change.mean()) for litter in of], "o-", color=f"C{i}", label=operator
        )
    for axis, title in zip(
        axes,
        ("relative change of return", "relative change of unsafe samples", "RMS change of command [deg]"),
        strict=True,
    ):
        axis.set_title(title, fontsize="medium")
        axis.set_xticks(at, [f"{m:g}" for m in MAGNITUDES])
        axis.set_xlabel("sigma_mut")
        axis.grid(axis="y", alpha=0.3)
    for axis in axes[:2]:
        axis.set_yscale("symlog", linthresh=0.1)
        axis.axhline(0.0, color="black", lw=0.6)
    axes[2].set_yscale("log")
    axes[2].legend(loc="upper left")
