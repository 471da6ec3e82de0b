"""Figures 8 and 9: return against smoothness, with and without CAPS and smooth fitness; spread over a population."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from matplotlib.figure import Figure

from export.population import Population, load_run
from export.study import short_runs
from export.study.campaign import ABREAST, SEEDS, STORE, Progress, Trials, fly_once, join
from export.study.cases import CASES, CaseFleet
from export.study.pictures import picture
from export.study.short import RUNS, counted, train
from export.study.show import flights_progress, show
from export.study.thesis import RETURN_CHAMPION, RETURN_TD3, SM_SERL50, SM_TD3
from export.training.evaluate import Scores
from task import results
from task.results import Claim, Table

RETURNS = Trials(3, 20.0, "published")
"""What the champion's return is counted on: one reference of each seed, of the published family and length."""
QUIET = Trials(1, 30.0)
"""What smoothness is measured on: an evaluation reference, the one that an exported population is screened with."""
TICKS = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
SEED = 1


class Smooth(NamedTuple):
    """One run, flown."""

    name: str
    short: bool
    caps: bool
    smooth_fitness: bool
    population: Population
    champion_return: np.ndarray
    """(E,) on RETURNS."""
    scores: Scores
    """(P, E) of every member on QUIET."""

    @property
    def member_smoothness(self) -> np.ndarray:
        """Return Sm of each member (P,) [rad Hz]."""
        return self.scores.smoothness.mean(axis=1)


def fly_run(folder: Path, short: bool, fleet: CaseFleet, progress: Progress) -> Smooth:
    """Fly a run's champion on RETURNS and all of its members on QUIET."""
    population = load_run(folder)
    parameters = population.parameters
    blocks = [parameters[i : i + ABREAST] for i in range(0, len(parameters), ABREAST)]
    store, network = folder / STORE, population.network
    flown = [fly_once(store, fleet, CASES[0], network, b, QUIET, progress) for b in blocks]
    champion = parameters[population.champion : population.champion + 1]
    returns = fly_once(store, fleet, CASES[0], network, champion, RETURNS, progress).returns[0]
    made = population.description.training.get("config", {})
    caps = made.get("td3", {}).get("lambda_s", 0.0) > 0.0
    fitness = bool(made.get("genetic", {}).get("smooth_fitness"))
    return Smooth(folder.name, short, caps, fitness, population, returns, join(flown, axis=0))


def smoothness_table(runs: list[Smooth]) -> Table:
    """Return the points of figure 8."""
    champion = f"{RETURN_CHAMPION[0]:g} to {RETURN_CHAMPION[1]:g}"
    serl50, td3 = (f"{sm.mean:g} ± {sm.sd:g}" for sm in (SM_SERL50, SM_TD3))
    rows: list[list[object]] = [
        ["thesis: SERL(50)", None, None, champion, None, serl50, None],
        ["thesis: TD3", "no", "no", f"{RETURN_TD3.mean} ± {RETURN_TD3.sd}", None, td3, None],
    ]
    for run in runs:
        frames = run.population.description.training.get("frames")
        rows.append(
            [
                run.name,
                "yes" if run.caps else "no",
                "yes" if run.smooth_fitness else "no",
                f"{run.champion_return.mean():.1f} ± {run.champion_return.std(ddof=1):.1f}",
                round(float(run.member_smoothness[run.population.champion]), 1),
                f"{run.member_smoothness.mean():.1f} (median {np.median(run.member_smoothness):.1f})",
                frames,
            ]
        )
    columns = ["run", "CAPS", "Sm in the fitness", "champion's return", "champion's Sm [rad Hz]"]
    return Table(
        title="Return and smoothness", columns=[*columns, "Sm, average of the population", "frames"], rows=rows
    )


def draw(figure: Figure, runs: list[Smooth]) -> None:
    """Draw figure 8: a point for each run; stars are the thesis's, open marks are short runs."""
    figure.set_size_inches(7.5, 4.4)
    axis = figure.subplots()
    for i, run in enumerate(runs):
        axis.scatter(
            run.member_smoothness.mean(),
            run.champion_return.mean(),
            marker="s" if run.smooth_fitness else "o",
            facecolors="none" if run.short else f"C{i % 10}",
            edgecolors=f"C{i % 10}",
            s=70,
            label=f"{run.name}{'' if run.caps else ', no CAPS'}",
        )
    for x, y, label in (
        (SM_SERL50.mean, float(np.mean(RETURN_CHAMPION)), "thesis: SERL(50)"),
        (SM_TD3.mean, RETURN_TD3.mean, "thesis: TD3"),
    ):
        axis.scatter(x, y, marker="*", s=140, color="C3" if "SERL" in label else "black", label=label)
    axis.set_xscale("symlog", linthresh=1.0)
    axis.set_yscale("symlog", linthresh=50.0)
    axis.set_xlabel("Sm, average of the population [rad Hz] (right is smoother)")
    axis.set_ylabel("champion's return of 20 s")
    axis.grid(alpha=0.3)
    axis.legend(fontsize="x-small", ncols=2, loc="upper left")


def draw_spread(figure: Figure, run: Smooth) -> None:
    """Draw figure 9: how Sm and nMAE are spread over a population, the champion marked."""
    figure.set_size_inches(8.5, 3.2)
    axes = figure.subplots(1, 2)
    champion = run.population.champion
    error = run.scores.nmae.mean(axis=1)
    for axis, values, label in (
        (axes[0], -run.member_smoothness, "-Sm [rad Hz] (left is smoother)"),
        (axes[1], error, "nMAE [%]"),
    ):
        axis.hist(values, bins=np.geomspace(values.min() * 0.95, values.max() * 1.05, 20), color="C0", alpha=0.7)
        axis.axvline(values[champion], color="C2", lw=2.0, label="champion")
        axis.set_xscale("log")
        ticks = [t for t in TICKS if values.min() * 0.9 < t < values.max() * 1.1]
        axis.set_xticks(ticks, [f"{t:g}" for t in ticks])
        axis.minorticks_off()
        axis.set_xlabel(label)
        axis.set_ylabel("members")
        axis.grid(alpha=0.3)
    axes[0].legend(loc="upper right")


@click.command()
@click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--short-runs",
    "shorts",
    type=click.Path(path_type=Path),
    default=RUNS,
    show_default=True,
    help="Of short runs.",
)
@click.option("--name", default="smoothness", show_default=True, help="Of the files in results/ and docs/img/.")
def smoothness(runs: tuple[Path, ...], shorts: Path, name: str) -> None:
    """Fly RUNS and short runs with and without CAPS and smooth fitness; the spread is of the first of RUNS."""
    began = time.perf_counter()
    configs = [
        short_runs.operator("safe", SEED),
        short_runs.without_caps(SEED),
        short_runs.smooth_fitness(SEED),
        short_runs.td3(True, SEED),
        short_runs.td3(False, SEED),
    ]
    with flights_progress(sum(config.frames for config in configs), "frames") as advance:
        trained = [train(config, counted(advance, config.frames), shorts).folder for config in configs]
    fleet = CaseFleet()
    folders = [(run, False) for run in runs] + [(folder, True) for folder in trained]
    members = sum(len(load_run(folder).parameters) for folder, _ in folders)
    with flights_progress(QUIET.total * members + RETURNS.total * len(folders)) as progress:
        flown = [fly_run(folder, short, fleet, progress) for folder, short in folders]
    first = flown[0]
    rank = np.argsort(np.argsort(-first.member_smoothness))
    table = smoothness_table(flown)
    results.write(
        name,
        results.Result(
            title="Figures 8 and 9: return and smoothness",
            command=f"python -m export.study smoothness {' '.join(map(str, runs))}",
            seconds=round(time.perf_counter() - began, 1),
            runs=RETURNS.total,
            seeds=list(SEEDS),
            claims=[
                Claim(
                    claim=f"{first.name}: place of the champion among its population by smoothness",
                    value=int(rank[first.population.champion]) + 1,
                    unit=f"of {len(rank)}",
                    target="among the least noisy, as in figure 9",
                    holds=bool(rank[first.population.champion] < len(rank) / 4),
                ),
                Claim(
                    claim=f"{first.name}: median of the members' Sm",
                    value=round(float(np.median(first.member_smoothness)), 1),
                    unit="rad Hz",
                    target=f"{SM_SERL50.mean:g} ± {SM_SERL50.sd:g}, the thesis's SERL(50)",
                ),
            ],
            tables=[table],
            notes=[
                "Return of the champion on one published reference of 20 s from each of three seeds; Sm of the members "
                "on one evaluation reference of 30 s. The thesis has 30 of each.",
                "Short runs (serl10-*, td3-*): the configurations in export/study/configs, "
                f"{configs[0].frames:,} and {configs[-1].frames:,} frames, seed {SEED}. A TD3 actor has hardly begun "
                "to learn by then, and has no say in a short SERL run: what CAPS does to a finished TD3 is not shown.",
                "Sm depends on the flight: a short one with steep references reads lower than one of 80 s (table 7.1).",
            ],
        ),
    )
    with picture(name) as figure:
        draw(figure, flown)
    with picture(f"{name}_spread") as figure:
        draw_spread(figure, first)
    show([table])
