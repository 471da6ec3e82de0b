"""Short training runs that a study compares: common seeds, a stated budget, kept so that a stopped study goes on."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import torch

from export.population import DESCRIPTION, load_run
from export.training import checkpoint
from export.training.config import TrainingConfig, load
from export.training.curve import Row
from export.training.run import CURVE, run, start
from export.training.train import CHECKPOINT
from task.errors import UserError

RUNS = Path("runs/study")
"""Where short runs are kept."""
CONFIGS = Path(__file__).parent / "configs"
"""The short runs' own configurations."""


class Short(NamedTuple):
    """A finished short run."""

    folder: Path
    config: TrainingConfig
    curve: list[Row]


def varied(base: str, name: str, seed: int, **changes: dict[str, Any]) -> TrainingConfig:
    """Return the study's configuration ``base`` with another name and seed; ``changes``: settings by table.

    ``varied("serl10", "gaussian", 1, genetic={"mutation": "gaussian"})``
    """
    config = load(str(CONFIGS / f"{base}.toml"))
    tables = {table: msgspec.structs.replace(getattr(config, table), **change) for table, change in changes.items()}
    return msgspec.structs.replace(config, name=name, seed=seed, **tables)


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
    """Train, go on with, or only read the run of this name and seed.

    Raises UserError when the run is stopped, or when one of that name was made with other settings.
    """
    folder = runs / f"{config.name}-{config.seed}"
    if not (folder / DESCRIPTION).exists():
        torch.set_num_threads(1)
        if run(start(config, folder, torch.device("cpu"), resume=True), folder, report) is None:
            raise UserError(f"{folder}: stopped; the same command goes on")
    made = load_run(folder).description.training["config"]
    if (other := _difference(made, msgspec.to_builtins(config))) is not None:
        raise UserError(f"{folder}: made with another {other} than the study has now; remove it and measure again")
    curve = read_curve(folder)
    report(curve[-1])
    return Short(folder, config, curve)


def read_curve(folder: Path) -> list[Row]:
    """Return the learning curve of a run; raise UserError when there is none."""
    try:
        with (folder / CURVE).open(newline="") as file:
            return [msgspec.convert(row, Row, strict=False) for row in csv.DictReader(file)]
    except (OSError, msgspec.ValidationError) as error:
        raise UserError(
            f"{folder / CURVE}: no learning curve of a training run: {str(error).splitlines()[0]}"
        ) from None


def _difference(made: dict[str, Any], wanted: dict[str, Any]) -> str | None:
    """Return the first setting of a run that is not what is wanted; settings it did not know do not count."""
    for key, value in made.items():
        if isinstance(value, dict):
            if (inner := _difference(value, wanted.get(key) or {})) is not None:
                return f"{key}.{inner}"
        elif msgspec.json.encode(value) != msgspec.json.encode(wanted.get(key)):
            return key
    return None


def memories(short: Short) -> dict[str, torch.Tensor]:
    """Return what the genetic actors of a run remember: ``memory.states`` and so on, as their checkpoint has it."""
    tensors, _ = checkpoint.load(short.folder / CHECKPOINT)
    return checkpoint.part(tensors, "population")
