"""``understudy train``."""

from __future__ import annotations

import signal
from pathlib import Path
from types import FrameType

import click
import msgspec
import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from export.training import gymnasium_run
from export.training.config import TrainingConfig, load
from export.training.curve import Row
from export.training.evaluate import Scores
from export.training.run import run, start
from export.training.train import Trainer
from task.config import LARGEST_INTEGER
from task.errors import UserError
from understudy import INTERRUPTED, stopping


class _Interrupt:
    """The first Ctrl-C ends the run after this generation; the second at once."""

    def __init__(self) -> None:
        self.asked = False
        signal.signal(signal.SIGINT, self._handle)
        signal.signal(signal.SIGTERM, self._handle)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        click.echo("train: stopping after this generation; once more to stop at once", err=True)

    def __call__(self) -> bool:
        return self.asked


class _Progress:
    """One line a generation: where the run stands and when it will be done."""

    def __init__(self, config: TrainingConfig, console: Console, frames: int) -> None:
        self.config = config
        self.console = console
        self.began_at = frames
        self.seconds = 0.0

    def __call__(self, row: Row) -> None:
        self.seconds += row.seconds
        left = max(self.config.frames - row.frames, 0)
        eta = left * self.seconds / max(row.frames - self.began_at, 1)
        self.console.print(
            f"[bold]{min(100.0 * row.frames / self.config.frames, 100.0):5.1f} %[/] generation {row.generation:3d}  "
            f"frames {row.frames:>9,}  champion {row.champion:8.1f}  average {row.average:8.1f}  "
            f"TD3 {row.td3:8.1f}  lost {row.lost:2d}  ETA {int(eta // 60):3d}:{int(eta % 60):02d}",
            highlight=False,
        )


def _show(console: Console, trainer: Trainer, scores: Scores, folder: Path) -> None:
    table = Table(title=f"{trainer.config.name}: nominal, {scores.nmae.shape[1]} validation references of 80 s")
    for column in ("actor", "nMAE mean [%]", "worst [%]", "Sm [rad Hz]", "return", "lost"):
        table.add_column(column, justify="right")
    ranking = scores.ranking()
    for i in np.argsort(ranking):
        table.add_row(
            "td3" if i == len(ranking) - 1 else f"actor_{i}",
            f"{scores.nmae[i].mean():.2f}",
            f"{scores.nmae[i].max():.2f}",
            f"{scores.smoothness[i].mean():.1f}",
            f"{scores.returns[i].mean():.1f}",
            str(int(scores.lost[i].sum())),
        )
    console.print(table)
    console.print(f"Population in {folder}; export it with: understudy export {folder} populations/{folder.name}")


def _show_returns(console: Console, config: TrainingConfig, returns: np.ndarray, folder: Path) -> None:
    table = Table(title=f"{config.name}: returns of {returns.shape[1]} validation episodes")
    for column in ("actor", "mean", "standard deviation", "worst"):
        table.add_column(column, justify="right")
    for i in np.argsort(-returns.mean(axis=1)):
        name = "td3" if i == len(returns) - 1 else f"actor_{i}"
        table.add_row(name, *(f"{value:.1f}" for value in (returns[i].mean(), returns[i].std(), returns[i].min())))
    console.print(table)
    console.print(f"Agents in {folder}")


GO_ON = "the same command goes on"


@click.command()
@click.argument("config")
@click.option("--out", type=click.Path(path_type=Path), help="Folder of the run.  [default: runs/NAME]")
@click.option("--seed", type=click.IntRange(0, LARGEST_INTEGER), help="Replaces the configuration's seed.")
@click.option(
    "--frames",
    type=click.IntRange(1, LARGEST_INTEGER),
    help="Replaces the configuration's frames; may grow on resuming.",
)
@click.option("--resume/--fresh", default=True, show_default=True, help="Continue a checkpoint in --out, or overwrite.")
@click.option("--threads", type=click.IntRange(1), default=1, show_default=True, help="Threads of the tensor library.")
@click.option(
    "--workers",
    type=click.IntRange(0, 1),
    default=1,
    show_default=True,
    help="Processes that fly while this one learns, where the configuration lets them overlap; changes no result.",
)
@click.option(
    "--device", default="cpu", show_default=True, help="Where to learn: cpu or cuda; flights stay on the CPU."
)
@stopping(f"{GO_ON} from the last checkpoint")
def train(
    config: str,
    out: Path | None,
    seed: int | None,
    frames: int | None,
    resume: bool,
    threads: int,
    workers: int,
    device: str,
) -> None:
    """Train a population with SERL. CONFIG: a name in export/training/configs (serl10, ...), or a path to a TOML file.

    A configuration with an [environment] trains on that Gymnasium environment.
    """
    settings = load(config)
    changes = {k: v for k, v in (("seed", seed), ("frames", frames)) if v is not None}
    settings = msgspec.structs.replace(settings, **changes)
    folder = out or Path("runs") / settings.name
    torch.set_num_threads(threads)
    console = Console(soft_wrap=True)
    rollouts = gymnasium_run.Watched(settings.environment) if settings.environment else None
    trainer = start(settings, folder, _device(device), resume, rollouts, workers)
    if trainer.curve:
        console.print(f"resumed at generation {trainer.curve[-1].generation}, frame {trainer.frames:,}")
    progress, stop = _Progress(settings, console, trainer.frames), _Interrupt()
    try:
        returns = gymnasium_run.run(trainer, folder, progress, stop) if rollouts else None
        scores = None if rollouts else run(trainer, folder, progress, stop)
    finally:
        trainer.close()
    if returns is not None:
        _show_returns(console, settings, returns, folder)
    elif scores is not None:
        _show(console, trainer, scores, folder)
    else:
        click.echo(f"understudy: stopped at frame {trainer.frames:,} of {settings.frames:,}; {GO_ON}", err=True)
        raise SystemExit(INTERRUPTED)


def _device(name: str) -> torch.device:
    try:
        device = torch.device(name)
        if device.type not in ("cpu", "cuda"):
            raise RuntimeError(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError):
        raise UserError(f"--device {name}: no such device here; expected cpu, or cuda on a machine with one") from None
    return device
