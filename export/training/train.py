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

CHECKPOINT = "checkpoint.npz"


class Trainer:
    """Everything that learns, and the streams of chance that it draws from."""

    def __init__(self, config: TrainingConfig, device: torch.device, rollouts: Rollouts | None = None) -> None:
        """Start a run from its configuration and seed alone, in the Citation's world unless given another."""
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

    @property
    def frames(self) -> int:
        """Frames stored so far."""
        return self.curve[-1].frames if self.curve else 0

    def members(self) -> np.ndarray:
        """Return all policies (N + 1, K) float32; the TD3 actor is the last."""
        return torch.cat([self.population.parameters, self.learner.actor.parameters()]).cpu().numpy()

    def generation(self) -> Row:
        """Fly everyone, breed, learn, inject: one generation of thesis figure 2."""
        began = time.perf_counter()
        flights = self._fly()
        frames = self._remember(flights)
        flown = time.perf_counter()
        fitness = self._fitness(flights)
        slot = self._evolve(fitness[:-1])
        bred = time.perf_counter()
        losses = self._learn(frames)
        if slot is not None:
            self.population.inject(slot, self.learner.actor.parameters())
        times = (flown - began, bred - flown, time.perf_counter() - bred)
        self.curve.append(self._row(flights, frames, fitness, losses, times))
        return self.curve[-1]

    def _fly(self) -> Flights:
        """Fly every policy on tasks common to all; the TD3 actor explores where transitions are stored."""
        genetic, td3 = self.config.genetic, self.config.td3
        tasks = self.rollouts.draw(self.rng, genetic.evaluations)
        noise = np.zeros((self.rollouts.ticks, genetic.evaluations, self.network.action), dtype=np.float32)
        explored = noise[:, -genetic.stored_evaluations :]
        explored[:] = np.clip(td3.sigma * self.rng.standard_normal(explored.shape), -td3.noise_clip, td3.noise_clip)
        return self.rollouts.fly(self.network, self.members(), tasks, noise)

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
        learnt = self.rollouts.learnt_reward(flights, self.config.td3.gamma)
        frames = 0
        for p, e in np.ndindex(flights.length.shape):
            if e < flights.length.shape[1] - stored:
                continue
            n = int(flights.length[p, e])
            s = flights.observation[: n + 1, p, e] * self.input_scale
            continues = np.ones((n, 1), dtype=np.float32)
            if flights.lost[p, e]:
                continues[-1] = 0.0
            rows = np.concatenate([s[:-1], flights.u[:n, p, e], learnt[:n, p, e, None], s[1:], continues], axis=1)
            self.replay.add(torch.from_numpy(rows))
            frames += n
        return frames

    def _evolve(self, fitness: np.ndarray) -> int | None:
        """Breed the genetic actors; return the slot that the TD3 actor is to take in this generation."""
        if not len(fitness):
            return None
        synchronising = (len(self.curve) + 1) % self.config.genetic.synchronisation == 0
        return self.population.evolve(fitness, synchronising, self.learner.q, self.rng, self.generator)

    def _learn(self, frames: int) -> dict[str, float]:
        """Let TD3 take its updates for the frames gathered, once there are enough to learn from."""
        if self.replay.filled <= self.config.td3.learning_starts:
            return {"td_loss": 0.0, "q": 0.0}
        return self.learner.learn(self.replay, round(frames * self.config.td3.updates_per_frame), self.generator)

    def _row(
        self,
        flights: Flights,
        frames: int,
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
            frames=self.frames + frames,
            simulated=(before.simulated if before else 0) + int(flights.length.sum()),
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
        checkpoint.save(path, tensors, meta)

    @classmethod
    def resume(
        cls, path: Path, config: TrainingConfig, device: torch.device, rollouts: Rollouts | None = None
    ) -> Trainer:
        """Continue a run; raise UserError when the checkpoint is of another configuration."""
        tensors, meta = checkpoint.load(path)
        checkpoint.require_same(path, meta["config"], config)
        trainer = cls(config, device, rollouts)
        trainer.population.restore(checkpoint.part(tensors, "population"))
        trainer.learner.restore(checkpoint.part(tensors, "learner"))
        trainer.replay.restore(checkpoint.part(tensors, "replay"))
        trainer.generator.set_state(tensors["generator"])
        checkpoint.restore_stream(trainer.rng, meta["rng"])
        trainer.curve = msgspec.convert(meta["curve"], list[Row])
        return trainer


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
