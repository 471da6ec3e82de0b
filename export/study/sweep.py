"""Chapter 5: search of the hyperparameters by Gaussian-process optimisation, with short trials."""

from __future__ import annotations

import time
import warnings
from pathlib import Path
from typing import Any

import click
import numpy as np
import optuna
import torch
from optuna.storages.journal import JournalFileBackend
from scipy.stats import spearmanr

from export.study.pictures import picture
from export.study.ranges import RANGES, Range, configure
from export.study.show import flights_progress, show
from export.study.sweep_picture import draw
from export.training.train import Trainer
from task import results
from task.errors import UserError
from task.results import Claim, Table

FOLDER = Path("runs/sweep")
LAST = 4
"""Generations at a trial's end whose average return is the objective; each flies another reference."""
STARTUP = 6
"""Trials at random before the Gaussian process and the pruner have something to go by."""
SEED = 1


def storage(folder: Path, kind: str) -> optuna.storages.BaseStorage:
    """Return the file that keeps a sweep's trials; a stopped sweep goes on from it."""
    folder.mkdir(parents=True, exist_ok=True)
    return optuna.storages.JournalStorage(JournalFileBackend(str(folder / f"{kind}.log")))


def objective(trial: optuna.Trial, kind: str, frames: int) -> float:
    """Train with a trial's settings; return the population's average return at the end, or prune."""
    values = {r.name: _suggest(trial, r) for r in RANGES[kind]}
    config = configure(kind, values, frames, SEED)
    trainer = Trainer(config, torch.device("cpu"))
    while trainer.frames < frames:
        row = trainer.generation()
        recent = [r.average for r in trainer.curve[-LAST:]]
        trial.report(float(np.mean(recent)), row.generation)
        if trainer.frames < frames and trial.should_prune():
            raise optuna.TrialPruned
    trial.set_user_attr("champion", float(np.mean([r.champion for r in trainer.curve[-LAST:]])))
    trial.set_user_attr("frames", trainer.frames)
    return float(np.mean(recent))


def _suggest(trial: optuna.Trial, r: Range) -> float | int | str:
    if r.choices:
        return trial.suggest_categorical(r.name, r.choices)
    return trial.suggest_float(r.name, r.low, r.high, log=r.log)


def search(kind: str, trials: int, frames: int, folder: Path) -> optuna.Study:
    """Bring a sweep to ``trials`` finished trials; return it."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    store = storage(folder, kind)
    name = f"{kind}-{frames}"
    known = {study.study_name for study in optuna.get_all_study_summaries(store)}
    done = len(_finished(optuna.load_study(study_name=name, storage=store))) if name in known else 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        # A sweep that goes on must not draw what its first start drew.
        sampler = optuna.samplers.GPSampler(seed=SEED + done, n_startup_trials=STARTUP)
    study = optuna.create_study(
        study_name=name,
        storage=store,
        sampler=sampler,
        pruner=optuna.pruners.MedianPruner(n_startup_trials=STARTUP, n_warmup_steps=5),
        direction="maximize",
        load_if_exists=True,
    )
    if not done:
        study.enqueue_trial({r.name: r.thesis for r in RANGES[kind]})
    with flights_progress(trials, "trials") as advance:
        advance(done)
        while (done := len(_finished(study))) < trials:
            study.optimize(lambda trial: objective(trial, kind, frames), n_trials=1)
            advance(len(_finished(study)) - done)
    return study


def _finished(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    ended = (optuna.trial.TrialState.COMPLETE, optuna.trial.TrialState.PRUNED)
    return study.get_trials(states=ended)


def level(trial: optuna.trial.FrozenTrial) -> float:
    """Return a trial's objective; of a pruned one the last that it reported."""
    if trial.state == optuna.trial.TrialState.PRUNED:
        return trial.intermediate_values[max(trial.intermediate_values)]
    return float(trial.value or 0.0)


def tables(study: optuna.Study, kind: str) -> list[Table]:
    """Return the trials, best first, and how much each setting seems to matter."""
    names = [r.name for r in RANGES[kind]]
    finished = sorted(_finished(study), key=lambda t: (t.state == optuna.trial.TrialState.PRUNED, -level(t)))
    rows = [
        [
            t.number,
            "pruned" if t.state == optuna.trial.TrialState.PRUNED else "",
            round(level(t), 1),
            *(float(f"{v:.3g}") if isinstance(v := t.params[n], float) else v for n in names),
        ]
        for t in finished
    ]
    complete = study.get_trials(states=(optuna.trial.TrialState.COMPLETE,))
    importance = _importance(study) if len(complete) > STARTUP else {}
    effects = []
    for r in RANGES[kind]:
        x = [float(r.choices.index(t.params[r.name])) if r.choices else t.params[r.name] for t in complete]
        varies = len(complete) > 2 and len(set(x)) > 1
        rank = float(spearmanr(x, [level(t) for t in complete]).statistic) if varies else None
        effects.append([r.name, r.text, r.thesis, None if rank is None else round(rank, 2), importance.get(r.name)])
    return [
        Table(title="Trials, best first", columns=["trial", "", "average return", *names], rows=rows),
        Table(
            title="Settings",
            columns=["setting", "range", "thesis", "rank correlation with the return", "importance (PED-ANOVA)"],
            rows=effects,
        ),
    ]


def _importance(study: optuna.Study) -> dict[str, Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        evaluator = optuna.importance.PedAnovaImportanceEvaluator()
        found = optuna.importance.get_param_importances(study, evaluator=evaluator)
    return {name: round(float(value), 2) for name, value in found.items()}


@click.command()
@click.option(
    "--trials", type=click.IntRange(2), default=14, show_default=True, help="In all; a stopped sweep goes on."
)
@click.option("--frames", type=click.IntRange(1), default=150_000, show_default=True, help="Of one trial.")
@click.option("--kind", type=click.Choice(sorted(RANGES)), default="serl10", show_default=True)
@click.option("--folder", type=click.Path(path_type=Path), default=FOLDER, show_default=True, help="Of the trials.")
@click.option("--name", default="sweep", show_default=True, help="Of the files in results/ and docs/img/.")
def sweep(trials: int, frames: int, kind: str, folder: Path, name: str) -> None:
    """Search the hyperparameters of SERL(10), SERL(50) or TD3 with short trials; a stopped sweep goes on."""
    began = time.perf_counter()
    torch.set_num_threads(1)
    study = search(kind, trials, frames, folder)
    complete = study.get_trials(states=(optuna.trial.TrialState.COMPLETE,))
    if not complete:
        raise UserError(f"{folder}: every trial was pruned; raise --trials")
    first = next((t for t in complete if t.number == 0), None)
    best = study.best_trial
    ended = _finished(study)
    spent = sum(t.duration.total_seconds() for t in ended if t.duration)
    rows = tables(study, kind)
    results.write(
        name,
        results.Result(
            title=f"Chapter 5: hyperparameters of {kind}",
            command=f"python -m export.study sweep --trials {trials} --frames {frames} --kind {kind} --name {name}",
            seconds=round(max(spent, time.perf_counter() - began), 1),
            runs=len(ended),
            seeds=[SEED],
            claims=[
                Claim(
                    claim="best average return of a flight", value=round(level(best), 1), unit=f"trial {best.number}"
                ),
                Claim(claim="with the thesis's settings", value=round(level(first), 1) if first else None),
                Claim(
                    claim="trials pruned",
                    value=len(_finished(study)) - len(complete),
                    unit=f"of {len(_finished(study))}",
                ),
            ],
            tables=rows,
            notes=[
                f"A trial is {frames} stored frames with one seed, 0.01 critic updates per frame and one crossover "
                f"pass; its objective is the population's average return over the last {LAST} generations. The "
                "thesis trained each of its 10 configurations for 0.8 to 2 million frames.",
                "Gaussian-process search as in the thesis (there Weights & Biases, here Optuna), with a median pruner.",
                "The thesis gives its ranges only as the axes of pictures; these enclose the values of its table 1.",
                "So few trials of one seed rank settings loosely: no more than directions.",
            ],
        ),
    )
    with picture(name) as figure:
        draw(figure, [(t.params, level(t), t.state.name == "PRUNED") for t in ended], RANGES[kind])
    show(rows)
