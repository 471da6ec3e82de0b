"""Short training runs that a study compares: common seeds, a stated budget, kept so that a stopped study goes on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import torch

from export.population import DESCRIPTION
from export.training import checkpoint
from export.training.config import TrainingConfig, load
from export.training.curve import Row
from export.training.run import run, start
from export.training.train import CHECKPOINT
from task.errors import UserError

RUNS = Path("runs/study")
"""Where short runs are kept."""


class Short(NamedTuple):
    """A finished short run."""

    folder: Path
    config: TrainingConfig
    curve: list[Row]


def varied(base: str, name: str, frames: int, seed: int, **changes: dict[str, Any]) -> TrainingConfig:
    """Return configuration ``base`` with another name, budget and seed; ``changes``: settings by table.

    ``varied("serl10", "gaussian", 400_000, 1, genetic={"mutation": "gaussian"})``
    """
    config = load(base)
    tables = {table: msgspec.structs.replace(getattr(config, table), **change) for table, change in changes.items()}
    return msgspec.structs.replace(config, name=name, frames=frames, seed=seed, validation_references=1, **tables)


def counted(advance: Callable[[int], None], budget: int) -> Callable[[Row], None]:
    """Return a report of a run's generations that tells ``advance`` of the frames, up to ``budget``."""
    told = 0

    def report(row: Row) -> None:
        nonlocal told
        frames = min(row.frames, budget)
        advance(frames - told)
        told = frames

    return report


def train(config: TrainingConfig, report: Callable[[Row], None], runs: Path = RUNS) -> Short:
    """Train, go on with, or only read the run of this name and seed; raise UserError when it was stopped.

    A run of that name with other settings is refused, as ``understudy train`` refuses it.
    """
    folder = runs / f"{config.name}-{config.seed}"
    torch.set_num_threads(1)
    trainer = start(config, folder, torch.device("cpu"), resume=True)
    if trainer.frames < config.frames or not (folder / DESCRIPTION).exists():
        if run(trainer, folder, report) is None:
            raise UserError(f"{folder}: stopped; the same command goes on")
    else:
        report(trainer.curve[-1])
    return Short(folder, config, trainer.curve)


def memories(short: Short) -> dict[str, torch.Tensor]:
    """Return what the genetic actors of a run remember: ``memory.states`` and so on, as their checkpoint has it."""
    tensors, _ = checkpoint.load(short.folder / CHECKPOINT)
    return checkpoint.part(tensors, "population")
