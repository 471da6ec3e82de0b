"""CMA-ME: an archive of linear landers that land in many ways (thesis sections 3.3.2, 4.2 and 4.3), by pyribs.

``python -m export.verification.archive --iterations 400`` fills it and goes on where it was stopped.
"""

from __future__ import annotations

import pickle
import time
import zipfile
from pathlib import Path
from typing import NamedTuple

import click
import msgspec
import numpy as np
from ribs.archives import GridArchive
from ribs.emitters import EvolutionStrategyEmitter
from ribs.schedulers import Scheduler
from rich.console import Console

from export.network import Layer, Network
from export.training.checkpoint import said
from export.training.config import EnvironmentSettings
from export.training.gymnasium_rollouts import GymnasiumRollouts
from export.verification.lander import ID
from task.config import Settings
from task.errors import UserError
from task.files import atomic, make_folder
from understudy import run, stopping

CHECKPOINT, ELITES = "scheduler.pickle", "elites.npz"
N_SEEN, N_ACTED = 8, 2
LINEAR = Network(
    layers=(Layer(units=N_ACTED, activation="linear"),),
    observation=N_SEEN,
    action=N_ACTED,
    input_scale=(1.0,) * N_SEEN,
    action_scale=(1.0,) * N_ACTED,
    action_offset=(0.0,) * N_ACTED,
)
"""a = W s (thesis eq. 4.3), cut to the action's bounds; the layer's bias stays zero."""


class ArchiveSettings(Settings, frozen=True):
    """What decides the archive; the thesis's settings, which are those of pyribs' own example."""

    cells: tuple[int, int] = (50, 50)
    """Of x and vertical velocity at touchdown: 2500 in all."""
    x_range: tuple[float, float] = (-1.0, 1.0)
    """In half widths of the screen; the pad reaches from -0.2 to 0.2."""
    velocity_range: tuple[float, float] = (-3.0, 0.0)
    """In the observation's units."""
    emitters: int = 5
    """Improvement emitters, each a CMA-ES of its own."""
    batch: int = 25
    """Policies that each emitter tries in an iteration."""
    sigma: float = 1.0
    """Initial standard deviation of the emitters."""
    episode: int = 52
    """Seed of the one episode that a policy is judged by: terrain, first push and the engines' dispersion."""
    seed: int = 1
    """Of the emitters."""


class Progress(NamedTuple):
    """How far the archive is."""

    iterations: int
    episodes: int
    frames: int
    seconds: float
    """Wall time [s]."""


class Elites(NamedTuple):
    """The archive's elites."""

    weights: np.ndarray
    """(M, 2, 8) float32 W."""
    returns: np.ndarray
    """(M,) of the one episode."""
    behaviour: np.ndarray
    """(M, 2) x and vertical velocity at touchdown (thesis eq. 4.2)."""
    progress: Progress

    def parameters(self) -> np.ndarray:
        """Return the policies as parameters (M, K) float32 of :data:`LINEAR`."""
        return linear(self.weights)


def linear(weights: np.ndarray) -> np.ndarray:
    """Return weights (M, 2, 8) as parameters (M, 18) float32 of :data:`LINEAR`."""
    flat = weights.reshape(len(weights), -1)
    return np.concatenate([flat, np.zeros((len(flat), N_ACTED))], axis=1).astype(np.float32)


def new_scheduler(settings: ArchiveSettings) -> Scheduler:
    """Return CMA-ME at its start: an empty grid and its emitters."""
    archive = GridArchive(
        solution_dim=N_SEEN * N_ACTED,
        dims=settings.cells,
        ranges=[settings.x_range, settings.velocity_range],
        seed=settings.seed,
    )
    emitters = [
        EvolutionStrategyEmitter(
            archive,
            x0=np.zeros(N_SEEN * N_ACTED),
            sigma0=settings.sigma,
            ranker="2imp",
            batch_size=settings.batch,
            seed=settings.seed + 1 + i,
        )
        for i in range(settings.emitters)
    ]
    return Scheduler(archive, emitters)


class Search:
    """CMA-ME on the lander; resumed from its own checkpoint it goes on bit for bit."""

    def __init__(self, settings: ArchiveSettings) -> None:
        """Start with an empty archive."""
        self.settings = settings
        self.scheduler = new_scheduler(settings)
        self.progress = Progress(0, 0, 0, 0.0)
        self.rollouts = GymnasiumRollouts(EnvironmentSettings(id=ID))

    def iterate(self) -> None:
        """Ask the emitters for policies, land each, and tell returns and behaviours."""
        began = time.perf_counter()
        solutions = self.scheduler.ask()
        weights = solutions.reshape(-1, N_ACTED, N_SEEN)
        flights = self.rollouts.fly(LINEAR, linear(weights), np.array([self.settings.episode]))
        behaviour = self.rollouts.attribute("impact", flights.length.shape)
        self.scheduler.tell(flights.returns()[:, 0], behaviour[:, 0])
        done = self.progress
        self.progress = Progress(
            done.iterations + 1,
            done.episodes + len(solutions),
            done.frames + int(flights.length.sum()),
            done.seconds + time.perf_counter() - began,
        )

    def elites(self) -> Elites:
        """Return what the archive holds."""
        data = self.scheduler.archive.data()
        weights = np.asarray(data["solution"], dtype=np.float32).reshape(-1, N_ACTED, N_SEEN)
        return Elites(weights, np.asarray(data["objective"]), np.asarray(data["measures"]), self.progress)

    def save(self, folder: Path) -> None:
        """Write the elites, and the checkpoint; the latter is for this command alone (pyribs pickles its state)."""
        elites = self.elites()
        with atomic(folder / ELITES) as file:
            np.savez(
                file,
                weights=elites.weights,
                returns=elites.returns,
                behaviour=elites.behaviour,
                progress=np.array(elites.progress),
            )
        with atomic(folder / CHECKPOINT) as file:
            pickle.dump((msgspec.to_builtins(self.settings), tuple(self.progress), self.scheduler), file)

    @classmethod
    def resume(cls, folder: Path, settings: ArchiveSettings) -> Search:
        """Go on from a checkpoint; raise UserError when it is of other settings."""
        try:
            with (folder / CHECKPOINT).open("rb") as file:
                saved, progress, scheduler = pickle.load(file)
        except Exception as error:  # what is unpickled may raise anything
            raise UserError(
                f"{folder / CHECKPOINT}: not a checkpoint of this search: {said(error)}; use --fresh"
            ) from None
        if saved != msgspec.to_builtins(settings):
            raise UserError(f"{folder}: made with {saved}, now {settings}; give another --out, or --fresh")
        search = cls(settings)
        search.progress, search.scheduler = Progress(*progress), scheduler
        return search


def load_elites(folder: Path) -> Elites:
    """Read the elites of an archive; raise UserError when there are none."""
    try:
        with (folder / ELITES).open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            iterations, episodes, frames, seconds = file["progress"]
            progress = Progress(int(iterations), int(episodes), int(frames), float(seconds))
            return Elites(file["weights"], file["returns"], file["behaviour"], progress)
    except (OSError, KeyError, ValueError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise UserError(
            f"{folder}: no archive of landers ({said(error)}); make one with python -m export.verification.archive"
        ) from None


@click.command()
@click.option("--iterations", type=click.IntRange(1), default=400, show_default=True, help="In all, resumed included.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs/lunar_archive"), show_default=True)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Of the emitters.")
@click.option("--resume/--fresh", default=True, show_default=True, help="Go on from a checkpoint in --out.")
@stopping("the same command goes on")
def main(iterations: int, out: Path, seed: int, resume: bool) -> None:
    """Fill an archive of linear landers by CMA-ME; Ctrl-C at any time, the same command goes on."""
    make_folder(out, "--out")
    settings = ArchiveSettings(seed=seed)
    search = Search.resume(out, settings) if resume and (out / CHECKPOINT).exists() else Search(settings)
    console = Console(soft_wrap=True)
    while search.progress.iterations < iterations:
        search.iterate()
        search.save(out)
        done, stats = search.progress, search.scheduler.archive.stats
        left = (iterations - done.iterations) * done.seconds / done.iterations
        console.print(
            f"[bold]{100.0 * done.iterations / iterations:5.1f} %[/] iteration {done.iterations:3d}  "
            f"episodes {done.episodes:6,}  frames {done.frames:>9,}  elites {stats.num_elites:4d}  "
            f"best {stats.obj_max:6.1f}  ETA {int(left // 60):3d}:{int(left % 60):02d}",
            highlight=False,
        )
    console.print(f"Archive in {out}")


if __name__ == "__main__":
    run("export.verification.archive:main")
