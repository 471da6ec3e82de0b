"""A run on a Gymnasium environment: a learning curve with bands over episodes, and the agents that it leaves."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from export.network import Network, n_parameters
from export.population import DESCRIPTION, PARAMETERS, Description, Member, Population, load_array, write_run
from export.training import curve
from export.training.config import EnvironmentSettings
from export.training.curve import Row
from export.training.flights import Flights
from export.training.gymnasium_rollouts import SEEDS, GymnasiumRollouts
from export.training.run import CURVE, PICTURE, VALIDATION_STREAM, provenance
from export.training.train import Trainer, train
from task.config import Settings, load_json
from task.errors import UserError
from task.files import atomic

BANDS = "validation_curve.csv"


class Point(Settings, frozen=True):
    """Returns over the validation episodes at one time of the training."""

    frames: int
    """Frames stored so far."""
    champion: float
    """Mean return of the generation's fittest genetic actor; of the gradient learner's where it is alone."""
    champion_sd: float
    learner: float
    """Mean return of the gradient learner's actor, without its exploration."""
    learner_sd: float


class Watched(GymnasiumRollouts):
    """Environments in which the fittest policy of the last generation is remembered, for the curve."""

    def __init__(self, settings: EnvironmentSettings) -> None:
        """See :class:`GymnasiumRollouts`."""
        super().__init__(settings)
        self.fittest = np.zeros((1, 0), dtype=np.float32)
        """(1, K) the genetic actor that flew best on the tasks of the last generation, before breeding."""

    def fly(
        self, network: Network, parameters: np.ndarray, tasks: np.ndarray, noise: np.ndarray | None = None
    ) -> Flights:
        """See :meth:`GymnasiumRollouts.fly`; flights with noise are the trainer's, those of one its learner's alone."""
        flights = super().fly(network, parameters, tasks, noise)
        if noise is not None and len(parameters) > 1:
            genetic = flights.returns().mean(axis=1)[:-1]
            self.fittest = parameters[[int(genetic.argmax())]].copy()
        return flights


def episodes(settings: EnvironmentSettings, seed: int, count: int = 0) -> np.ndarray:
    """Return the seeds of ``count`` validation episodes (as many as configured when 0) of a run with ``seed``."""
    rng = np.random.default_rng(seed + VALIDATION_STREAM)
    return rng.integers(SEEDS, size=count or settings.validation_episodes)


class Bands:
    """The curve of the validation episodes, a point each ``validation_frames``."""

    def __init__(self, trainer: Trainer, rollouts: Watched, folder: Path) -> None:
        """Take up the points of an interrupted run, as far as its checkpoint goes."""
        self.trainer, self.rollouts, self.path = trainer, rollouts, folder / BANDS
        self.tasks = episodes(rollouts.settings, trainer.config.seed)
        self.points = [p for p in read_bands(self.path) if p.frames <= trainer.frames] if self.path.exists() else []
        self.before = trainer.frames

    def __call__(self, row: Row) -> bool:
        """Validate when enough frames have passed since the last point, and write the curve; return whether so."""
        every = self.rollouts.settings.validation_frames
        due = row.frames // every > self.before // every
        self.before = row.frames
        if not due:
            return False
        learner = self.trainer.learner.actor.parameters().cpu().numpy()
        champion = self.rollouts.fittest if self.trainer.config.genetic.population else learner
        flights = self.rollouts.fly(self.trainer.network, np.concatenate([champion, learner]), self.tasks)
        mean, sd = flights.returns().mean(axis=1), flights.returns().std(axis=1)
        self.points.append(
            Point(frames=row.frames, champion=mean[0], champion_sd=sd[0], learner=mean[1], learner_sd=sd[1])
        )
        with atomic(self.path) as file:
            rows = [",".join(Point.__struct_fields__)]
            rows += [",".join(f"{getattr(p, name):.6g}" for name in Point.__struct_fields__) for p in self.points]
            file.write(("\n".join(rows) + "\n").encode())
        return True


def read_bands(path: Path) -> list[Point]:
    """Read the curve of the validation episodes; raise UserError when it is not one."""
    try:
        with path.open(newline="") as file:
            return [
                Point(frames=int(float(row["frames"])), **{k: float(v) for k, v in row.items() if k != "frames"})
                for row in csv.DictReader(file)
            ]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path}: not a curve of validation episodes: {error}; train again") from None


def run(
    trainer: Trainer, folder: Path, report: Callable[[Row], None], stop: Callable[[], bool] = lambda: False
) -> np.ndarray | None:
    """Train to the end and write the agents; return their validation returns (P, E), None when stopped before."""
    rollouts = trainer.rollouts
    assert isinstance(rollouts, Watched), "a trainer of an environment flies Watched rollouts"
    bands = Bands(trainer, rollouts, folder)

    def record(row: Row) -> None:
        if bands(row):  # a learner alone has a generation each episode: too many to write a file for
            curve.write_csv(folder / CURVE, trainer.curve)
        report(row)

    ended = train(trainer, folder, record, stop)
    curve.write_csv(folder / CURVE, trainer.curve)
    curve.draw(folder / PICTURE, trainer.curve, f"{trainer.config.name}, seed {trainer.config.seed}")
    return write_agents(trainer, rollouts, folder) if ended else None


def write_agents(trainer: Trainer, rollouts: GymnasiumRollouts, folder: Path) -> np.ndarray:
    """Score every policy on the validation episodes, pick the champion, write parameters and description."""
    parameters = trainer.members()
    tasks = episodes(rollouts.settings, trainer.config.seed)
    returns = rollouts.fly(trainer.network, parameters, tasks).returns()
    names = [f"actor_{i}" for i in range(len(parameters) - 1)] + ["td3"]
    scores = [{"validation_return": float(r.mean()), "validation_sd": float(r.std())} for r in returns]
    description = Description(
        network=trainer.network,
        members=tuple(Member(name=name, scores=score) for name, score in zip(names, scores, strict=True)),
        champion=names[int(returns.mean(axis=1).argmax())],
        training=provenance(trainer),
    )
    write_run(Population(description, parameters), folder)
    return returns


def load_agents(folder: Path) -> Population:
    """Read what :func:`write_agents` wrote; raise UserError when it is missing or does not fit together.

    Agents of another environment than the Citation are no population that the runtime could fly.
    """
    if not (folder / DESCRIPTION).exists():
        raise UserError(f"{folder}: no finished run; train it with 'understudy train {folder.name}'")
    description = load_json(folder / DESCRIPTION, Description, "description of trained agents")
    parameters = load_array(folder / PARAMETERS, "parameters of trained agents")
    expected = (len(description.members), n_parameters(description.network))
    if parameters.shape != expected:
        raise UserError(f"{folder / PARAMETERS}: expected the shape {expected}, got {parameters.shape}")
    return Population(description, parameters)
