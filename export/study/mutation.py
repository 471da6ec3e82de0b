"""Chapter 6: the three mutation operators, over training and over one generation."""

from __future__ import annotations

import time
from pathlib import Path

import click
import numpy as np
from matplotlib.figure import Figure

from export.study import short_runs
from export.study.generation import Litter, draw_litters, litter_tables, one_generation
from export.study.pictures import picture
from export.study.short import RUNS, Short, counted, train
from export.study.show import flights_progress, show
from export.study.thesis import MUTATION_MAGNITUDE
from task import results
from task.results import Claim, Table

RETURNS = (-4000.0, -2000.0, -1000.0, -500.0, -200.0, -100.0)
"""Marks on the axes of the learning curves."""
LAST = 4
"""Generations at the end of a run over which a level is averaged: each flies another reference."""


def levels(short: Short, field: str) -> float:
    """Return the mean of a column of the learning curve over its last generations."""
    return float(np.mean([getattr(row, field) for row in short.curve[-LAST:]]))


def training_table(runs: dict[str, list[Short]]) -> Table:
    """Return what each operator's runs ended with; one figure a seed."""

    def each(shorts: list[Short], field: str) -> str:
        return ", ".join(f"{levels(short, field):.0f}" for short in shorts)

    rows = [
        [
            operator,
            each(shorts, "average"),
            each(shorts, "champion"),
            ", ".join(f"{sum(row.unsafe for row in s.curve)}" for s in shorts),
            ", ".join(f"{sum(row.lost for row in s.curve)}" for s in shorts),
        ]
        for operator, shorts in runs.items()
    ]
    columns = ["operator", f"average return, last {LAST} generations", "champion's", "unsafe samples in training"]
    return Table(title="Over training, by seed", columns=[*columns, "flights lost in training"], rows=rows)


def draw_training(figure: Figure, runs: dict[str, list[Short]]) -> None:
    """Draw the average (figure 6.1), the champion (6.2) and the unsafe samples against frames."""
    figure.set_size_inches(11.0, 3.6)
    axes = figure.subplots(1, 3)
    for i, (operator, shorts) in enumerate(runs.items()):
        for field, axis in (("average", axes[0]), ("champion", axes[1])):
            for n, short in enumerate(shorts):
                frames = [row.frames / 1e3 for row in short.curve]
                label = operator if n == 0 else None
                axis.plot(frames, [getattr(row, field) for row in short.curve], color=f"C{i}", lw=1.1, label=label)
        for n, short in enumerate(shorts):
            total = np.cumsum([row.unsafe for row in short.curve])
            frames = [row.frames / 1e3 for row in short.curve]
            axes[2].plot(frames, total, color=f"C{i}", lw=1.1, label=operator if n == 0 else None)
    for axis, title in zip(axes, ("population average", "champion", "unsafe samples so far (eq. 14)"), strict=True):
        axis.set_title(title, fontsize="medium")
        axis.set_xlabel("frames [thousand]")
        axis.grid(alpha=0.3)
    for axis in axes[:2]:
        axis.set_yscale("symlog", linthresh=100.0)
        axis.set_yticks(RETURNS, [f"{r:g}" for r in RETURNS])
        axis.set_ylim(RETURNS[0], RETURNS[-1])
    axes[0].set_ylabel("return of a flight")
    axes[0].legend(loc="upper right")


def claims(runs: dict[str, list[Short]], litters: list[Litter]) -> list[Claim]:
    """Return the thesis's two statements, and whether they repeat."""
    ends = {operator: [levels(short, "average") for short in shorts] for operator, shorts in runs.items()}
    in_order = all(
        safe > proximal > gaussian
        for gaussian, proximal, safe in zip(ends["gaussian"], ends["proximal"], ends["safe"], strict=True)
    )
    published = {litter.operator: litter for litter in litters if litter.magnitude == MUTATION_MAGNITUDE}
    change = {operator: float(litter.unsafe_change.mean()) for operator, litter in published.items()}
    return [
        Claim(
            claim="average return over training: safe above proximal above Gaussian, on every seed",
            value=", ".join(f"{o} {np.mean(v):.0f}" for o, v in ends.items()),
            target="as in figure 6.1",
            holds=in_order,
        ),
        Claim(
            claim="over one generation, change of unsafe samples over the parents' mean: safe the lowest",
            value=", ".join(f"{o} {v:+.2f}" for o, v in change.items()),
            target="as in figure 6.4",
            holds=change["safe"] < min(change["gaussian"], change["proximal"]),
        ),
    ]


@click.command()
@click.option("--runs", type=click.Path(path_type=Path), default=RUNS, show_default=True, help="Of short runs.")
@click.option("--seeds", type=click.IntRange(1), default=2, show_default=True, help="Training runs of each operator.")
@click.option("--references", type=click.IntRange(1), default=12, show_default=True, help="In all, one generation.")
@click.option("--name", default="mutation", show_default=True, help="Of the files in results/ and docs/img/.")
def mutation(runs: Path, seeds: int, references: int, name: str) -> None:
    """Compare Gaussian, proximal and safety-informed mutation. A stopped command goes on where it was."""
    began = time.perf_counter()
    frames = short_runs.operator("safe", 1).frames
    budget = frames * len(short_runs.OPERATORS) * seeds
    finished: dict[str, list[Short]] = {}
    with flights_progress(budget, "frames") as advance:
        for operator in short_runs.OPERATORS:
            finished[operator] = []
            for seed in range(1, seeds + 1):
                config = short_runs.operator(operator, seed)
                finished[operator].append(train(config, counted(advance, config.frames), runs))
    litters = one_generation(finished["safe"][0], references)
    tables = [training_table(finished), *litter_tables(litters)]
    results.write(
        name,
        results.Result(
            title="Chapter 6: mutation operators",
            command=f"python -m export.study mutation --seeds {seeds} --references {references}",
            seconds=round(time.perf_counter() - began, 1),
            runs=seeds,
            seeds=list(range(1, seeds + 1)),
            claims=claims(finished, litters),
            tables=tables,
            notes=[
                f"Over training: SERL(10) of export/study/configs, {frames} frames a run, 0.01 "
                "critic updates per frame, same seeds for all operators. The thesis has 1.02 million frames, one "
                f"update per frame and one seed. {seeds} seed(s) of training show no significance.",
                "One generation: every actor of the run with safe mutation, seed 1, mutates once with each operator; "
                "parents and children fly the same "
                f"{litters[0].return_change.shape[1]} training references of 20 s; the run's own memories.",
                "Change of return: eq. 6.1, (child - parent) / |parent|. Change of unsafe samples: (child - parent) "
                "over the mean of all parents, since most flights of most parents have none to divide by.",
                "Safe, shared: every parent is given the critical states of the whole population, which asks what the "
                "operator does once it knows any.",
                "The same magnitude is not the same step: eq. 8 divides it by the sensitivity. The RMS change of the "
                "command on the parent's memory says how large a step it was.",
            ],
        ),
    )
    with picture(f"{name}_training") as figure:
        draw_training(figure, finished)
    with picture(f"{name}_generation") as figure:
        draw_litters(figure, litters)
    show(tables)
