"""The generation loop of SERL(N): N genetic actors and one TD3 actor, learning from one memory."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch

from export.training import checkpoint
from export.training.config import TrainingConfig
from export.training.curve import Row
from export.training.flights import Flights
from export.training.memory import Replay
from export.training.networks import actor_network
from export.training.population import Population
from export.training.rollouts import CitationRollouts, Rollouts
from export.training.td3 import TD3
from export.training.worker import FlightWorker, Order
from task.errors import UserError

CHECKPOINT = "checkpoint.npz"
ORDERED = Order._fields[1:]
"""What a checkpoint keeps of flights under way: they are flown again."""


class Trainer:
    """Everything that learns, and the streams of chance that it draws from."""

    def __init__(
        self, config: TrainingConfig, device: torch.device, rollouts: Rollouts | None = None, workers: int = 0
    ) -> None:
        """Start a run from its configuration and seed alone, in the Citation's world unless given another.

        With ``workers`` another process flies the Citation while this one learns, where the configuration lets
        flights overlap; the result is the same.
        """
        self.config = config
        self.rollouts = rollouts or CitationRollouts(config.task, config.td3.discount_penalty)
        self.network = actor_network(config.actor, self.rollouts.observation, self.rollouts.action_scale)
        self.input_scale = np.array(self.network.input_scale, dtype=np.float32)
        start = torch.Generator().manual_seed(config.seed)
        self.population = Population(self.network, config.genetic, start, device)
        self.learner = TD3(self.network, config.td3, start, device)
        self.replay = Replay(config.td3.buffer, self.network.observation, self.network.action, device)
        self.rng = np.random.default_rng(config.seed)
        self.generator = torch.Generator(device).manual_seed(config.seed)
        self.curve: list[Row] = []
        self._ordered: list[Order] | None = None
        apart = workers > 0 and config.overlap and rollouts is None
        self._worker = FlightWorker(config.task, config.td3.discount_penalty) if apart else None

    @property
    def frames(self) -> int:
        """Frames stored so far."""
        return self.curve[-1].frames if self.curve else 0

    def members(self) -> np.ndarray:
        """Return all policies (N + 1, K) float32; the TD3 actor is the last."""
        return torch.cat([self.population.parameters, self.learner.actor.parameters()]).cpu().numpy()

    def generation(self) -> Row:
        """Fly everyone, breed, learn, inject: one generation of thesis figure 2.

        With ``overlap`` the TD3 actor is injected before it learns, and the next generation is already flying.
        """
        began = time.perf_counter()
        flights, *explored = self._fly()
        flown = time.perf_counter()
        frames = self._remember(flights) + sum(self._share(more, 0, more.length.shape[1]) for more in explored)
        fitness = self._fitness(flights)
        slot = self._evolve(fitness[:-1])
        if self.config.overlap:
            self._inject(slot)
            self._depart(self._order())
        bred = time.perf_counter()
        losses = self._learn(frames)
        self._check_finite(losses)
        if not self.config.overlap:
            self._inject(slot)
        times = (flown - began, bred - flown, time.perf_counter() - bred)
        simulated = sum(int(each.length.sum()) for each in (flights, *explored))
        self.curve.append(self._row(flights, (frames, simulated), fitness, losses, times))
        return self.curve[-1]

    def _order(self) -> list[Order]:
        """Draw the next flights: tasks common to all; the TD3 actor explores where transitions are stored."""
        genetic, members = self.config.genetic, self.members()
        order = Order(self.network, members, *self._tasks(genetic.evaluations, genetic.stored_evaluations))
        more = self.config.td3.exploring_flights
        return [order, *([Order(self.network, members[-1:], *self._tasks(more, more))] if more else [])]

    def _tasks(self, count: int, explored: int) -> tuple[np.ndarray, np.ndarray]:
        """Draw ``count`` tasks and the noise of the TD3 actor in the last ``explored`` of them."""
        td3 = self.config.td3
        tasks = self.rollouts.draw(self.rng, count)
        noise = np.zeros((self.rollouts.ticks, count, self.network.action), dtype=np.float32)
        part = noise[:, count - explored :]
        part[:] = np.clip(td3.sigma * self.rng.standard_normal(part.shape), -td3.noise_clip, td3.noise_clip)
        return tasks, noise

    def _depart(self, orders: list[Order]) -> None:
        """Let the next generation take off, in the worker where there is one."""
        self._ordered = orders
        if self._worker is not None:
            self._worker.start(orders)

    def _fly(self) -> list[Flights]:
        """Return the flights under way, or new ones: those of everyone, then the TD3 actor's further ones."""
        orders, self._ordered = self._ordered, None
        if orders is not None and self._worker is not None:
            return self._worker.result()
        return [self.rollouts.fly(*order) for order in orders or self._order()]

    def _inject(self, slot: int | None) -> None:
        if slot is not None:
            self.population.inject(slot, self.learner.actor.parameters())

    def _fitness(self, flights: Flights) -> np.ndarray:
        """Return each policy's mean return (eq. 4), with Sm (eq. 16) where asked; shape (N + 1,).

        The TD3 actor's flights with noise do not count for it, unless it has no others.
        """
        score = flights.returns()
        if self.config.genetic.smooth_fitness:
            score += flights.smoothness(np.array(self.network.action_scale))
        fitness = score.mean(axis=1)
        quiet = self.config.genetic.evaluations - self.config.genetic.stored_evaluations
        if quiet:
            fitness[-1] = score[-1, :quiet].mean()
        return fitness

    def _remember(self, flights: Flights) -> int:
        """Store the last flights of everyone in the shared and the own memories; return how many frames."""
        stored = self.config.genetic.stored_evaluations
        self.population.remember(flights, stored, self.input_scale)
        return sum(self._share(flights, int(p), stored) for p in self._shared(len(flights.length) - 1))

    def _share(self, flights: Flights, p: int, stored: int) -> int:
        """Store the last ``stored`` flights of actor ``p`` in the shared memory; return how many frames."""
        learnt = self.rollouts.learnt_reward(flights, self.config.td3.gamma)
        frames = 0
        for e in range(flights.length.shape[1] - stored, flights.length.shape[1]):
            n = int(flights.length[p, e])
            s = flights.observation[: n + 1, p, e] * self.input_scale
            continues = np.ones((n, 1), dtype=np.float32)
            if flights.lost[p, e]:
                continues[-1] = 0.0
            rows = np.concatenate([s[:-1], flights.u[:n, p, e], learnt[:n, p, e, None], s[1:], continues], axis=1)
            self.replay.add(torch.from_numpy(rows))
            frames += n
        return frames

    def _shared(self, actors: int) -> list[int]:
        """Return whose flights enter the shared memory: the TD3 actor's and a share of the genetic actors'."""
        share = self.config.genetic.stored_share
        if share == 1.0:
            return list(range(actors + 1))
        return [*sorted(self.rng.permutation(actors)[: round(share * actors)].tolist()), actors]

    def _evolve(self, fitness: np.ndarray) -> int | None:
        """Breed the genetic actors; return the slot that the TD3 actor is to take in this generation."""
        if not len(fitness):
            return None
        genetic = self.config.genetic
        synchronising = (len(self.curve) + 1) % genetic.synchronisation == 0
        progress = min(self.frames / self.config.frames, 1.0)
        magnitude = genetic.mutation_magnitude * (1.0 + (genetic.mutation_end - 1.0) * progress)
        return self.population.evolve(fitness, synchronising, self.learner.q, self.rng, self.generator, magnitude)

    def _learn(self, frames: int) -> dict[str, float]:
        """Let TD3 take its updates for the frames gathered, once there are enough to learn from."""
        if self.replay.filled <= self.config.td3.learning_starts:
            return {"td_loss": 0.0, "q": 0.0}
        return self.learner.learn(self.replay, round(frames * self.config.td3.updates_per_frame), self.generator)

    def _check_finite(self, losses: dict[str, float]) -> None:
        """Raise UserError when learning or breeding has diverged: what would be saved is of no use."""
        learner = np.isfinite(list(losses.values())).all() and bool(self.learner.actor.packed.isfinite().all())
        if learner and bool(self.population.parameters.isfinite().all()):
            return
        what, settings = (
            ("genetic actors", "genetic.crossover_learning_rate or genetic.mutation_magnitude")
            if learner
            else ("TD3 learner", "td3.learning_rate or td3.reward_scale")
        )
        raise UserError(
            f"generation {len(self.curve) + 1}: the {what} diverged, numbers are not finite; lower {settings} "
            "and train into another --out; the last checkpoint is kept"
        )

    def _row(
        self,
        flights: Flights,
        frames: tuple[int, int],
        fitness: np.ndarray,
        losses: dict[str, float],
        seconds: tuple[float, float, float],
    ) -> Row:
        before = self.curve[-1] if self.curve else None
        genetic = fitness[:-1] if len(fitness) > 1 else fitness
        best = int(genetic.argmax())
        smooth = flights.smoothness(np.array(self.network.action_scale)).mean(axis=1)
        return Row(
            generation=len(self.curve) + 1,
            frames=self.frames + frames[0],
            simulated=(before.simulated if before else 0) + frames[1],
            updates=self.learner.updates,
            champion=float(genetic[best]),
            average=float(genetic.mean()),
            worst=float(genetic.min()),
            td3=float(fitness[-1]),
            champion_smoothness=float(smooth[best]),
            td3_smoothness=float(smooth[-1]),
            lost=int(flights.lost.sum()),
            unsafe=int((flights.unsafe & flights.flown()).sum()),
            td_loss=losses["td_loss"],
            q=losses["q"],
            seconds_flying=seconds[0],
            seconds_breeding=seconds[1],
            seconds_learning=seconds[2],
        )

    def save(self, path: Path) -> None:
        """Write everything that the next generation depends on."""
        tensors = {f"population.{k}": v for k, v in self.population.state().items()}
        tensors |= {f"learner.{k}": v for k, v in self.learner.state().items()}
        tensors |= {f"replay.{k}": v for k, v in self.replay.state().items()}
        tensors["generator"] = self.generator.get_state()
        meta: dict[str, Any] = {
            "config": msgspec.to_builtins(self.config),
            "curve": msgspec.to_builtins(self.curve),
            "rng": checkpoint.stream_state(self.rng),
        }
        for i, (_, *arrays) in enumerate(self._ordered or []):
            tensors |= {f"ordered{i}.{k}": torch.from_numpy(v) for k, v in zip(ORDERED, arrays, strict=True)}
        checkpoint.save(path, tensors, meta)

    def close(self) -> None:
        """End the process that flies, if there is one."""
        if self._worker is not None:
            self._worker.close()

    @classmethod
    def resume(
        cls,
        path: Path,
        config: TrainingConfig,
        device: torch.device,
        rollouts: Rollouts | None = None,
        workers: int = 0,
    ) -> Trainer:
        """Continue a run; raise UserError when the checkpoint is of another configuration."""
        tensors, meta = checkpoint.load(path)
        checkpoint.require_same(path, meta["config"], config)
        trainer = cls(config, device, rollouts, workers)
        try:
            orders = trainer._restore(tensors, meta)
        except (KeyError, TypeError, ValueError, RuntimeError, msgspec.ValidationError) as error:
            trainer.close()
            raise UserError(
                f"{path}: does not fit this program, or --device {device.type}: {checkpoint.said(error)}; give the "
                "device that it was made on, or start afresh with --fresh"
            ) from None
        if orders:
            trainer._depart(orders)
        return trainer

    def _restore(self, tensors: dict[str, torch.Tensor], meta: dict[str, Any]) -> list[Order]:
        """Take up a checkpoint; return the flights that were under way."""
        self.population.restore(checkpoint.part(tensors, "population"))
        self.learner.restore(checkpoint.part(tensors, "learner"))
        self.replay.restore(checkpoint.part(tensors, "replay"))
        self.generator.set_state(tensors["generator"])
        checkpoint.restore_stream(self.rng, meta["rng"])
        self.curve = msgspec.convert(meta["curve"], list[Row])
        orders: list[Order] = []
        while ordered := checkpoint.part(tensors, f"ordered{len(orders)}"):
            orders.append(Order(self.network, *(ordered[name].numpy() for name in ORDERED)))
        return orders


def train(
    trainer: Trainer, folder: Path, report: Callable[[Row], None], stop: Callable[[], bool] = lambda: False
) -> bool:
    """Run generations until the configured frames are reached or ``stop`` says so; return whether it ended.

    Whatever happens, the folder holds a checkpoint from which the run goes on bit for bit.
    """
    saved = time.monotonic()
    while trainer.frames < trainer.config.frames and not stop():
        report(trainer.generation())
        if time.monotonic() - saved >= trainer.config.checkpoint_seconds:
            trainer.save(folder / CHECKPOINT)
            saved = time.monotonic()
    trainer.save(folder / CHECKPOINT)
    return trainer.frames >= trainer.config.frames
