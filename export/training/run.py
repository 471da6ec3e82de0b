"""A run's folder: what it leaves behind while it trains and when it is done."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch

from export.population import DESCRIPTION, TRAINING_RECORDS, Description, Member, Population, save_run
from export.training import curve
from export.training.config import TrainingConfig, as_toml
from export.training.curve import Row
from export.training.evaluate import Scores, evaluate, evaluation_references
from export.training.flights import Fleet
from export.training.rollouts import Rollouts
from export.training.train import CHECKPOINT, Trainer, train
from sim_bridge.conditions import FlightCondition
from task.errors import UserError
from task.files import atomic, make_folder

CONFIG, CURVE, PICTURE = TRAINING_RECORDS
VALIDATION_STREAM = 1_000_003
"""Added to the run's seed: references of the validation are of another stream than those of the training."""


def start(
    config: TrainingConfig,
    folder: Path,
    device: torch.device,
    resume: bool,
    rollouts: Rollouts | None = None,
    workers: int = 0,
) -> Trainer:
    """Make the folder and return a trainer: the checkpoint's when there is one and ``resume``, or a new one.

    It learns in the Citation's world unless given other ``rollouts``.
    Raises UserError when the checkpoint is of another configuration, when there is a population without one that only
    ``resume=False`` may overwrite, or when the folder cannot be written.
    """
    make_folder(folder, "--out")
    checkpoint = folder / CHECKPOINT
    found = resume and checkpoint.exists()
    if resume and not found and (folder / DESCRIPTION).exists():
        raise UserError(
            f"{folder}: holds a population, but no {CHECKPOINT} to go on from; give another --out, or "
            "overwrite it with --fresh"
        )
    world = config, device, rollouts, workers
    trainer = Trainer.resume(checkpoint, *world) if found else Trainer(*world)
    if not found:
        (folder / DESCRIPTION).unlink(missing_ok=True)  # of the run that is overwritten: the curve is no longer its own
    with atomic(folder / CONFIG) as file:
        file.write(as_toml(config).encode())
    return trainer


def run(
    trainer: Trainer, folder: Path, report: Callable[[Row], None], stop: Callable[[], bool] = lambda: False
) -> Scores | None:
    """Train to the end and write the population; return the validation scores, None when stopped before."""

    def record(row: Row) -> None:
        curve.write_csv(folder / CURVE, trainer.curve)
        report(row)

    ended = train(trainer, folder, record, stop)
    curve.write_csv(folder / CURVE, trainer.curve)
    curve.draw(folder / PICTURE, trainer.curve, f"{trainer.config.name}, seed {trainer.config.seed}")
    return write_population(trainer, folder) if ended else None


def write_population(trainer: Trainer, folder: Path) -> Scores:
    """Score every policy on validation references, pick the champion, write parameters and description."""
    config, parameters = trainer.config, trainer.members()
    fleet = Fleet(FlightCondition(altitude=config.task.altitude, speed=config.task.speed))
    references = evaluation_references(fleet, config.seed + VALIDATION_STREAM, config.validation_references)
    scores = evaluate(fleet, trainer.network, parameters, references)
    names = [f"actor_{i}" for i in range(len(parameters) - 1)] + ["td3"]
    members = tuple(
        Member(
            name=name,
            scores={
                "validation_nmae": float(scores.nmae[i].mean()),
                "validation_smoothness": float(scores.smoothness[i].mean()),
                "validation_return": float(scores.returns[i].mean()),
                "validation_lost": float(scores.lost[i].sum()),
            },
        )
        for i, name in enumerate(names)
    )
    description = Description(
        network=trainer.network,
        members=members,
        champion=names[int(np.lexsort((scores.nmae.mean(axis=1), scores.lost.any(axis=1)))[0])],
        training=provenance(trainer),
    )
    save_run(Population(description, parameters), folder)
    return scores


def provenance(trainer: Trainer) -> dict[str, Any]:
    """Return what made this population: configuration, seed, cost, versions."""
    last = trainer.curve[-1] if trainer.curve else None
    world = "gymnasium" if trainer.config.environment else "jsbsim"
    return {
        "algorithm": f"SERL({trainer.config.genetic.population})" if trainer.config.genetic.population else "TD3",
        "config": msgspec.to_builtins(trainer.config),
        "seed": trainer.config.seed,
        "teachers": [],
        "generations": len(trainer.curve),
        "frames": trainer.frames,
        "simulated_frames": last.simulated if last else 0,
        "updates": trainer.learner.updates,
        "seconds": sum(row.seconds for row in trainer.curve),
        "device": str(trainer.replay.rows.device),
        "threads": torch.get_num_threads(),
        "cores": os.cpu_count(),
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in ("numpy", "torch", world)},
        },
    }
