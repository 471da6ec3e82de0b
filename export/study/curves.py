"""Figure 3: what champion, average and TD3 actor earn while they train, and what they earn when it is over."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from matplotlib.figure import Figure

from export.population import Population, load_run
from export.study.campaign import SEEDS, STORE, Progress, Trials, fly_once
from export.study.cases import CASES, CaseFleet
from export.study.contest import TD3, names
from export.study.pictures import picture
from export.study.short import read_curve
from export.study.show import flights_progress, show
from export.study.thesis import RETURN_CHAMPION, RETURN_TD3
from export.training.curve import Row
from export.training.evaluate import Scores
from task import results
from task.errors import UserError
from task.results import Claim, Table

WINDOW = 9
"""Generations of a running mean: each generation flies other references."""
MILESTONES = (-400.0, -200.0, -100.0)
"""Returns of a flight that a champion passes on its way."""
PUBLISHED = Trials(30, 20.0, "published")
"""The references and the length of flight by which the thesis's returns are counted."""


class Learnt(NamedTuple):
    """A run: how it went, and its champion and TD3 actor (2, E) when it was over."""

    population: Population
    curve: list[Row]
    final: Scores


def smoothed(curve: list[Row], field: str) -> np.ndarray:
    """Return a column's running mean over the last WINDOW generations, shape (generations,)."""
    values = np.array([getattr(row, field) for row in curve])
    return np.array([values[max(0, i + 1 - WINDOW) : i + 1].mean() for i in range(len(values))])


def learnt(run: Path, fleet: CaseFleet, progress: Progress) -> Learnt:
    """Read a run and fly its champion and its TD3 actor on the published references."""
    population = load_run(run)
    if TD3 not in names(population):
        raise UserError(f"{run}: no member '{TD3}'; expected a run of 'understudy train', with every actor")
    rows = [population.champion, names(population).index(TD3)]
    parameters = population.parameters[rows]
    final = fly_once(run / STORE, fleet, CASES[0], population.network, parameters, PUBLISHED, progress)
    return Learnt(population, read_curve(run), final)


def _final(scores: Scores, actor: int) -> str:
    returns, lost = scores.returns[actor], int(scores.lost[actor].sum())
    return f"{returns.mean():.1f} ± {returns.std(ddof=1):.1f}" + (f" ({lost} lost)" if lost else "")


def final_table(runs: Mapping[str, Learnt]) -> Table:
    """Return what each run cost and what its champion and TD3 actor earn."""
    rows: list[list[object]] = [
        ["thesis: SERL(50)", "5,100,000", None, f"{RETURN_CHAMPION[0]:g} to {RETURN_CHAMPION[1]:g}", None],
        ["thesis: TD3", "0.8 to 1.2 million", None, None, f"{RETURN_TD3.mean} ± {RETURN_TD3.sd}"],
    ]
    for name, run in runs.items():
        last = run.curve[-1]
        rows.append([name, f"{last.frames:,}", f"{last.updates:,}", _final(run.final, 0), _final(run.final, 1)])
    columns = ["run", "frames", "critic updates", "champion's return", "TD3 actor's return"]
    return Table(title="Return of 20 s on the published references, trained", columns=columns, rows=rows)


def milestone_table(runs: Mapping[str, Learnt]) -> Table:
    """Return after how many frames the champion's running mean passes each milestone, and how unsafe it was."""
    rows = []
    for name, run in runs.items():
        mean = smoothed(run.curve, "champion")
        passed = [
            next((row.frames for row, m in zip(run.curve, mean, strict=True) if m > mark), None) for mark in MILESTONES
        ]
        unsafe, lost = sum(row.unsafe for row in run.curve), sum(row.lost for row in run.curve)
        rows.append([name, *(f"{frames:,}" if frames else None for frames in passed), f"{unsafe:,}", f"{lost:,}"])
    columns = ["run", *(f"frames to {mark:g}" for mark in MILESTONES), "unsafe samples", "flights lost"]
    return Table(
        title=f"On the way: champion's return, mean of {WINDOW} generations, on the training references",
        columns=columns,
        rows=rows,
    )


def draw(figure: Figure, runs: Mapping[str, Learnt]) -> None:
    """Draw each run's running means against frames, the thesis's final levels as bands."""
    figure.set_size_inches(4.0 * len(runs) + 0.5, 3.8)
    axes = figure.subplots(1, len(runs), sharey=True, squeeze=False)[0]
    for axis, (name, run) in zip(axes, runs.items(), strict=True):
        frames = [row.frames / 1e6 for row in run.curve]
        series = (("td3", "TD3 actor", "C0"), ("average", "population average", "C1"), ("champion", "champion", "C2"))
        for field, label, colour in series if len(run.population.parameters) > 1 else series[:1]:
            axis.plot(frames, [getattr(row, field) for row in run.curve], color=colour, lw=0.5, alpha=0.35)
            axis.plot(frames, smoothed(run.curve, field), color=colour, lw=1.5, label=label)
        axis.axhspan(*RETURN_CHAMPION, color="C3", alpha=0.35, lw=0, label="thesis: SERL(50) at the end")
        axis.axhline(RETURN_TD3.mean, color="C4", ls="--", lw=1.0, label="thesis: TD3 at the end")
        axis.set_title(name, fontsize="medium")
        axis.set_xlabel("frames [million]")
        axis.grid(alpha=0.3)
        axis.set_yscale("symlog", linthresh=100.0)
        axis.set_ylim(top=0.0)
    axes[0].set_ylabel("return of a 20 s flight")
    axes[0].legend(fontsize="x-small", loc="lower right")


@click.command()
@click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--name", default="curves", show_default=True, help="Of the files in results/ and docs/img/.")
def curves(runs: tuple[Path, ...], name: str) -> None:
    """Draw the learning curves of RUNS and fly what came of them on the published references."""
    began = time.perf_counter()
    fleet = CaseFleet()
    with flights_progress(2 * PUBLISHED.total * len(runs)) as progress:
        found = {run.name: learnt(run, fleet, progress) for run in runs}
    tables = [final_table(found), milestone_table(found)]
    results.write(
        name,
        results.Result(
            title="Figure 3: learning curves",
            command=f"python -m export.study curves {' '.join(map(str, runs))}",
            seconds=round(time.perf_counter() - began, 1),
            runs=PUBLISHED.total,
            seeds=list(SEEDS),
            claims=[
                Claim(
                    claim=f"champion's return, {run}",
                    value=round(float(one.final.returns[0].mean()), 1),
                    target=f">= {RETURN_CHAMPION[0]:g}, the thesis's SERL(50)",
                    holds=bool(one.final.returns[0].mean() >= RETURN_CHAMPION[0]),
                )
                for run, one in found.items()
                if len(one.population.parameters) > 1
            ],
            tables=tables,
            notes=[
                "Trained actors fly 30 references of the published family (theta to 30 deg, phi to 20 deg); the "
                "curves are of those trained on, mostly the text's (25 and 45 deg), which cost more; no two "
                "generations share one.",
                "A curve's champion is the fittest of each generation; the thesis shows 5 evaluations from one seed.",
            ],
        ),
    )
    with picture(name) as figure:
        draw(figure, found)
    show(tables)
